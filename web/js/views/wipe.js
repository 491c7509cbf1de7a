// The photograph of a view, or another scene's picture, laid over the rendering up to a line that
// the reader moves; or how the two differ.
import {api} from '../api.js';
import {differenceMap} from '../difference.js';
import {decibel} from '../format.js';
import {fill, h, text} from '../dom.js';
import {colourScale} from '../outputs.js';

const MOST_SIDE = 1280;  // of a view that is rendered to be compared, pixels
// What the colours of a difference stand for (difference.js): full at a quarter of a channel's range.
const SCALES = {
  signed: () => colourScale(
      'signed-bar', 'rendered darker −64', '+64 of 255 lighter',
      'blue where the rendering is darker, red where it is lighter, white where equal'),
  error: () => colourScale(
      'error-bar', '0', '64 of 255 and more', 'black where equal, over red and yellow to white')
};

/**
 * @param {any} scene @param {HTMLCanvasElement} canvas what it is laid over
 * @param {AbortSignal} signal
 * @returns {{node: HTMLElement, show: (item: any) => Promise<void>, lay: (blob: Blob, words:
 *     string, told?: boolean, rendered?: Blob) => void, hide: () => void}} `node` covers the stage;
 *     `show` takes a dataset camera whose height fills the picture's height, `lay` a picture of the
 *     canvas's shape, whether it says at once how far the two are apart, and what it is compared with,
 *     where that is not the canvas: a photograph has a lens, and its middle seldom is the axis
 */
export function createWipe(scene, canvas, signal) {
  const own = h('img', {class: 'wipe-own', alt: '', draggable: 'false', hidden: true});
  const image = h('img', {alt: '', draggable: 'false'});
  const line = h('span', {class: 'wipe-line', 'aria-hidden': 'true', 'data-own': ''});
  const label = h('label', {'for': 'wipe'}, 'Photograph');
  const range = h(
      'input',
      {type: 'range', id: 'wipe', min: 0, max: 100, step: 0.5, value: 50, oninput: () => place()});
  const kind = h('select', {'aria-label': 'What is laid over', onchange: () => compare()}, [
    ['', 'as it is'], ['signed', 'lighter, darker'], ['error', 'error']
  ].map(([value, words]) => h('option', {value}, words)));
  const colours = h('span');
  const bar =
      h('div', {class: 'wipe-bar'}, label, range, kind,
        h('button', {
          type: 'button',
          class: 'small bare',
          'aria-label': 'Close the comparison',
          onclick: () => hide()
        },
          '×'),
        colours);
  const node =
      h('div', {class: 'wipe', hidden: true}, h('div', {class: 'wipe-picture'}, image, own, line), bar);
  for (const type of ['pointerdown', 'wheel', 'keydown'])
    bar.addEventListener(type, (event) => event.stopPropagation());
  const [red, green, blue] =
      (scene.config?.background ?? [1, 1, 1]).map((x) => Math.round(255 * x));
  image.style.background = `rgb(${red} ${green} ${blue})`;
  let laid = null;  // the picture itself: blob and words
  const addresses = new Map();  // of the pictures that are shown, by their element
  let serial = 0;
  let blinking = 0;
  line.addEventListener('pointerdown', (event) => {
    event.stopPropagation();
    line.setPointerCapture(event.pointerId);
  });
  line.addEventListener('pointermove', (event) => {
    if (!line.hasPointerCapture(event.pointerId)) return;
    const frame = image.getBoundingClientRect();
    range.value = (100 * (event.clientX - frame.left)) / frame.width;
    place();
  });
  const blink =
      h('button', {
        type: 'button',
        class: 'small',
        'aria-pressed': 'false',
        onclick: () => blinking ? stopBlink() : startBlink()
      },
        'Blink');
  function startBlink() {
    blink.setAttribute('aria-pressed', 'true');
    line.hidden = true;
    image.style.clipPath = 'none';
    blinking = setInterval(() => image.classList.toggle('away'), 700);
  }
  function stopBlink() {
    clearInterval(blinking);
    blinking = 0;
    line.hidden = false;
    image.classList.remove('away');
    blink.setAttribute('aria-pressed', 'false');
    place();
  }
  kind.after(blink);

  function place() {
    image.style.clipPath = `inset(0 ${100 - range.value}% 0 0)`;
    line.style.left = `${range.value}%`;
  }
  function hide() {
    serial++;
    if (node.hidden) return;
    if (blinking) stopBlink();
    node.hidden = true;
    laid = null;
    kind.value = '';
    fill(colours);
    put(image, null);
    put(own, null);
  }
  function put(picture, blob) {
    picture.removeAttribute('src');
    URL.revokeObjectURL(addresses.get(picture));
    addresses.delete(picture);
    if (!blob) return;
    addresses.set(picture, URL.createObjectURL(blob));
    picture.src = addresses.get(picture);
  }
  function lay(blob, words, told = false, rendered = null) {
    const before = kind.value;
    const blinked = blinking;
    hide();
    laid = {blob, words};
    put(image, blob);
    put(own, rendered);
    own.hidden = !rendered;
    text(label, words);
    place();
    node.hidden = false;
    if (blinked) startBlink();
    kind.value = before;
    if (before || told) image.decode().then(() => compare(told), () => {});
  }
  /** Puts how the picture differs from what it covers in its place, or itself; `told`: says how much. */
  async function compare(told = false) {
    const mine = laid;
    if (!mine) return;
    if (mine.awaited && kind.value) return text(label, `${mine.words} · rendering it as it was taken…`);
    fill(colours, SCALES[kind.value]?.());
    put(image, mine.blob);
    text(label, mine.words);
    if (!kind.value && !told) return;
    await Promise.all([image.decode(), own.hidden || own.decode()]);
    const map = await differenceMap(
        image, own.hidden ? canvas : own, image.style.background, kind.value || 'error');
    if (mine !== laid) return;
    if (kind.value) put(image, map.blob);
    text(label, `${mine.words} · ${map.psnr === null ? 'equal' : `${decibel(map.psnr)} between`}`);
  }
  /** The view as its photograph was taken, with its lens and colours; null where there is none. */
  const renderedAs = ({split, index, camera: {width, height}}) => {
    const share = Math.min(1, MOST_SIDE / Math.max(width, height));
    const size = {width: Math.round(share * width), height: Math.round(share * height)};
    const taken = {lens: 'as-taken', colours: 'as-taken'};
    return api.render(scene.id, {view: `${split}:${index}`, size, format: 'png', ...taken}, signal)
        .then(({blob}) => blob, () => null);
  };
  async function show(item) {
    hide();
    const mine = serial;
    const words = `Photograph ${item.split}:${item.index}`;
    const blob = await api.photo(scene.dataset, item.split, item.index, item.scale, signal);
    if (mine !== serial) return;
    lay(blob, words);
    const shown = laid;
    shown.awaited = true;  // the picture beside it has no lens, and may be coarse or of another view
    const rendered = await renderedAs(item);
    if (shown === laid) lay(blob, words, false, rendered);
  }
  signal.addEventListener('abort', hide, {once: true});
  return {node, show, lay, hide};
}

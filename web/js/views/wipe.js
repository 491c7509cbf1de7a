// The photograph of a view, or another scene's picture, laid over the rendering up to a line that
// the reader moves; or how the two differ.
import {api} from '../api.js';
import {differenceMap} from '../difference.js';
import {decibel} from '../format.js';
import {h, text} from '../dom.js';

/**
 * @param {any} scene @param {HTMLCanvasElement} canvas what it is laid over
 * @param {AbortSignal} signal
 * @returns {{node: HTMLElement, show: (item: any) => Promise<void>, lay: (blob: Blob, words:
 *     string, told?: boolean) => void, hide: () => void}} `node` covers the stage; `show` takes a
 *     dataset camera whose height fills the picture's height, `lay` a picture of the canvas's shape,
 *     and whether it says at once how far the two are apart
 */
export function createWipe(scene, canvas, signal) {
  const image = h('img', {alt: '', draggable: 'false'});
  const line = h('span', {class: 'wipe-line', 'aria-hidden': 'true', 'data-own': ''});
  const label = h('label', {'for': 'wipe'}, 'Photograph');
  const range = h(
      'input',
      {type: 'range', id: 'wipe', min: 0, max: 100, step: 0.5, value: 50, oninput: () => place()});
  const kind = h('select', {'aria-label': 'What is laid over', onchange: () => compare()}, [
    ['', 'as it is'], ['signed', 'lighter, darker'], ['error', 'error']
  ].map(([value, words]) => h('option', {value}, words)));
  const bar =
      h('div', {class: 'wipe-bar'}, label, range, kind,
        h('button', {
          type: 'button',
          class: 'small bare',
          'aria-label': 'Close the comparison',
          onclick: () => hide()
        },
          '×'));
  const node =
      h('div', {class: 'wipe', hidden: true}, h('div', {class: 'wipe-picture'}, image, line), bar);
  for (const type of ['pointerdown', 'wheel', 'keydown'])
    bar.addEventListener(type, (event) => event.stopPropagation());
  const [red, green, blue] =
      (scene.config?.background ?? [1, 1, 1]).map((x) => Math.round(255 * x));
  image.style.background = `rgb(${red} ${green} ${blue})`;
  let laid = null;  // the picture itself: blob and words
  let address = '';
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
        onclick: () => {
          if (blinking) return stopBlink();
          blink.setAttribute('aria-pressed', 'true');
          line.hidden = true;
          image.style.clipPath = 'none';
          blinking = setInterval(() => image.classList.toggle('away'), 700);
        }
      },
        'Blink');
  function stopBlink() {
    clearInterval(blinking);
    blinking = 0;
    line.hidden = false;
    image.classList.remove('away');
    blink.setAttribute('aria-pressed', 'false');
    place();
  }
  bar.insertBefore(blink, bar.lastChild);

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
    put(null);
  }
  function put(blob) {
    image.removeAttribute('src');
    URL.revokeObjectURL(address);
    address = blob ? URL.createObjectURL(blob) : '';
    if (blob) image.src = address;
  }
  function lay(blob, words, told = false) {
    const before = kind.value;
    hide();
    laid = {blob, words};
    put(blob);
    text(label, words);
    place();
    node.hidden = false;
    kind.value = before;
    if (before || told) image.decode().then(() => compare(told), () => {});
  }
  /** Puts how the picture differs from what it covers in its place, or itself; `told`: says how much. */
  async function compare(told = false) {
    const mine = laid;
    if (!mine) return;
    put(mine.blob);
    text(label, mine.words);
    if (!kind.value && !told) return;
    await image.decode();
    const map = await differenceMap(image, canvas, image.style.background, kind.value || 'error');
    if (mine !== laid) return;
    if (kind.value) put(map.blob);
    text(label, `${mine.words} · ${map.psnr === null ? 'equal' : `${decibel(map.psnr)} between`}`);
  }
  async function show(item) {
    hide();
    const mine = serial;
    const blob = await api.photo(scene.dataset, item.split, item.index, item.scale, signal);
    if (mine !== serial) return;
    lay(blob, `Photograph ${item.split}:${item.index}`);
  }
  signal.addEventListener('abort', hide, {once: true});
  return {node, show, lay, hide};
}

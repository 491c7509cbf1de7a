// The photograph of a view laid over its rendering, up to a line that the reader moves.
import {api} from '../api.js';
import {h, text} from '../dom.js';

/**
 * @param {any} scene @param {AbortSignal} signal
 * @returns {{node: HTMLElement, show: (item: any) => Promise<void>, hide: () => void}} `node`
 *     covers the
 *   stage; `show` takes a dataset camera whose height fills the picture's height
 */
export function createWipe(scene, signal) {
  const image = h('img', {alt: '', draggable: 'false'});
  const line = h('span', {class: 'wipe-line', 'aria-hidden': 'true', 'data-own': ''});
  const label = h('label', {'for': 'wipe'}, 'Photograph');
  const range = h(
      'input',
      {type: 'range', id: 'wipe', min: 0, max: 100, step: 0.5, value: 50, oninput: () => place()});
  const bar =
      h('div', {class: 'wipe-bar'}, label, range,
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
    if (blinking) stopBlink();
    node.hidden = true;
    image.removeAttribute('src');
    URL.revokeObjectURL(address);
  }
  async function show(item) {
    hide();
    const mine = serial;
    const blob = await api.photo(scene.dataset, item.split, item.index, item.scale, signal);
    if (mine !== serial) return;
    address = URL.createObjectURL(blob);
    image.src = address;
    text(label, `Photograph ${item.split}:${item.index}`);
    place();
    node.hidden = false;
  }
  signal.addEventListener('abort', hide, {once: true});
  return {node, show, hide};
}

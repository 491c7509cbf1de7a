// The box that a picture shows, set by its six faces.
import {h, text} from '../dom.js';

const AXES = ['x', 'y', 'z'];
const STEPS = 200;  // across the scene

/** "x0_y0_z0_x1_y1_z1" of an address; null where it is none. */
export function boxOfWord(word) {
  const numbers = (word ?? '').split('_').map(Number);
  if (!word || numbers.length !== 6 || !numbers.every(Number.isFinite)) return null;
  return AXES.every((_, i) => numbers[i] < numbers[i + 3]) ? numbers : null;
}

/** The twelve edges of a box, as pairs of corners. */
export function edgesOf(box) {
  const corner = (bits) => AXES.map((_, i) => box[bits & (1 << i) ? i + 3 : i]);
  const edges = [];
  for (let bits = 0; bits < 8; bits++)
    for (let i = 0; i < 3; i++)
      if (!(bits & (1 << i))) edges.push([corner(bits), corner(bits | (1 << i))]);
  return edges;
}

/**
 * @param {{centre: number[], radius: number}} bounds @param {string|null} word of the address
 * @param {() => void} changed
 */
export function createCrop({centre, radius}, word, changed) {
  const whole = [...centre.map((c) => c - radius), ...centre.map((c) => c + radius)];
  const step = (2 * radius) / STEPS;
  let box = boxOfWord(word) ?? [...whole];
  let on = boxOfWord(word) !== null;
  const words = h('output', {class: 'quiet'});
  const toggle = h('input', {
    type: 'checkbox',
    id: 'crop-on',
    checked: on,
    onchange: () => {
      on = toggle.checked;
      update();
    }
  });
  const sliders = whole.map((value, i) => h('input', {
                              type: 'range',
                              min: whole[i % 3],
                              max: whole[(i % 3) + 3],
                              step,
                              value: box[i],
                              'aria-label': `${AXES[i % 3]} ${i < 3 ? 'from' : 'to'}`,
                              oninput: () => move(i)
                            }));
  /** A face stays at least a step before the one opposite. */
  function move(i) {
    const other = box[(i + 3) % 6];
    const value = Number(sliders[i].value);
    box[i] = i < 3 ? Math.min(value, other - step) : Math.max(value, other + step);
    sliders[i].value = box[i];
    on = toggle.checked = true;
    update();
  }
  function show() {
    text(words, on ? box.map((x) => Number(x.toPrecision(3))).join(', ') : 'all of the scene');
  }
  function update() {
    show();
    changed();
  }
  show();
  const node =
      h('details', {class: 'crop', open: on}, h('summary', null, 'Crop'),
        h('div', {class: 'crop-form'},
          h('div', {class: 'row'}, toggle, h('label', {'for': 'crop-on'}, 'Show a box only'),
            h('button', {
              type: 'button',
              class: 'small',
              onclick: () => {
                box = [...whole];
                sliders.forEach((slider, i) => {
                  slider.value = box[i];
                });
                update();
              }
            },
              'Whole')),
          AXES.map(
              (axis, i) => h(
                  'div', {class: 'crop-axis'}, h('span', null, axis), sliders[i], sliders[i + 3])),
          words));
  return {
    node,
    /** Low corner, then high one; null: all. */
    box: () => (on ? [...box] : null),
    word: () => (on ? box.map((x) => Number(x.toPrecision(5))).join('_') : '')
  };
}

// The chosen key in numbers: place, direction, roll, field of view, time.
import {fill, h, text} from '../dom.js';
import {OPTICS, opticsOf} from '../optics.js';
import {anglesOfPose, poseOfAngles} from '../orbit.js';
import {action} from '../ui.js';
import {column} from '../vector.js';

const FIELDS = [
  ['time', 'Time', 's', 0.1], ['fovDeg', 'Field of view', '°', 0.5],
  ['focal', 'Focal length', 'mm', 1], ['x', 'x', '', 0.05],
  ['y', 'y', '', 0.05], ['z', 'z', '', 0.05], ['yaw', 'Heading', '°', 1], ['pitch', 'Tilt', '°', 1],
  ['roll', 'Roll', '°', 1]
];
const DEGREE = Math.PI / 180;
const FILM_MM = 24;  // the height of small picture film, which focal lengths are told for
const UNITS = {s: 'seconds', '°': 'degrees', mm: 'millimetres, of film 24 mm high'};
const focalOf = (fovDeg) => FILM_MM / 2 / Math.tan((fovDeg * DEGREE) / 2);
const fovOfFocal = (mm) => (2 * Math.atan(FILM_MM / 2 / mm)) / DEGREE;

/**
 * @param {number[]} up
 * @param {{change: (id: string, values: any) => void,
 *     depthOf: (pose: number[][], fovDeg: number) => Promise<number|null>, take: () => void,
 *     spread: () => void}} host
 *     depthOf: how far away what a camera's middle shows is; take: gives the key the camera that looks;
 *     spread: gives every key this one's field of view and effects
 * @returns {{node: HTMLElement, show: (key: any, number: number) => void}}
 */
export function createKeyFields(up, {change, depthOf, take, spread}) {
  let key = null;
  const title = h('h3', null, '');
  const inputs = Object.fromEntries(
      FIELDS.map(([name, label, unit, step]) => [name, h('input', {
                                                   type: 'number',
                                                   step: 'any',
                                                   'data-step': step,
                                                   id: `key-${name}`,
                                                   'aria-label': `${label}${
                                                       unit ? `, ${UNITS[unit]}` :
                                                              ' of the key’s place'}`,
                                                   onchange: () => read(name)
                                                 })]));
  const effects = Object.fromEntries(
      OPTICS.map(([name, label, unit,
                   step]) => [name, h('input', {
                                type: 'number',
                                step: 'any',
                                'data-step': step,
                                id: `key-${name}`,
                                'aria-label': `${label}${unit ? `, ${unit}` : ''}; 0 is none`,
                                onchange: () => readEffects()
                              })]));
  const focus = action('Focus on the middle', async () => {
    const chosen = key;
    const distance = chosen && await depthOf(chosen.pose, chosen.fovDeg);
    if (!distance) throw new Error('Nothing lies in the middle of this key’s picture.');
    const aperture = chosen.optics?.aperture || Number((distance / 20).toPrecision(2));
    change(chosen.id, {
      optics: opticsOf({...chosen.optics, aperture, focus: Number(distance.toPrecision(4))}),
      picture: undefined
    });
  }, {kind: 'small', title: 'Sharp is what the middle shows; with an aperture, if there is none'});
  const more = h(
      'details', {class: 'key-effects'}, h('summary', null, 'Effects of the camera'),
      h('p', {class: 'quiet'},
        'Off at 0, which costs nothing. An aperture or a shutter takes 64 cones a pixel, about a hundred times as long.'),
      h('div', null,
        OPTICS.map(
            ([name, label, unit]) =>
                h('label', {'for': `key-${name}`}, h('span', null, label),
                  h('span', {class: 'with-unit'}, effects[name],
                    unit ? h('span', {class: 'unit'}, unit) : null)))),
      focus);
  const node =
      h('fieldset', {class: 'key-numbers', hidden: true},
        h('legend', {class: 'unseen'}, 'The chosen key'),
        h('header', null, title,
          h('button', {
            type: 'button',
            class: 'small',
            title: 'U: the key moves to where the camera stands now',
            onclick: take
          },
            'Take this view'),
          h('button', {
            type: 'button',
            class: 'small',
            title: 'Every key gets the field of view and the effects of this one',
            onclick: spread
          },
            'Lens to all keys')),
        h('div', null,
          FIELDS.map(
              ([name, label, unit]) =>
                  h('label', {'for': `key-${name}`}, h('span', null, label),
                    h('span', {class: 'with-unit'}, inputs[name],
                      unit ? h('span', {class: 'unit'}, unit) : null)))),
        more);

  function readEffects() {
    const values = Object.fromEntries(OPTICS.map(([name]) => [name, Number(effects[name].value)]));
    if (!key || Object.values(values).some((x) => !Number.isFinite(x))) return;
    change(key.id, {optics: opticsOf(values), picture: undefined});
  }

  /** `changed` says which of the two tells how wide the picture is. */
  function read(changed) {
    const value = Object.fromEntries(FIELDS.map(([name]) => [name, Number(inputs[name].value)]));
    if (!key || Object.values(value).some((x) => !Number.isFinite(x))) return;
    const angles = {
      yaw: value.yaw * DEGREE,
      pitch: value.pitch * DEGREE,
      roll: value.roll * DEGREE
    };
    change(key.id, {
      time: value.time,
      fovDeg: changed === 'focal' ? fovOfFocal(value.focal) : value.fovDeg,
      pose: poseOfAngles(angles, [value.x, value.y, value.z], up),
      picture: undefined
    });
  }

  return {
    node,
    show(next, number) {
      key = next;
      node.hidden = !next;
      if (!next) return;
      text(title, `Key ${number}`);
      const [x, y, z] = column(next.pose, 3);
      const {yaw, pitch, roll} = anglesOfPose(next.pose, up);
      const values = {
        time: next.time,
        fovDeg: next.fovDeg,
        focal: focalOf(next.fovDeg),
        x,
        y,
        z,
        yaw: yaw / DEGREE,
        pitch: pitch / DEGREE,
        roll: roll / DEGREE
      };
      for (const [name] of FIELDS)
        if (document.activeElement !== inputs[name])
          inputs[name].value = Number(values[name].toFixed(4));
      const optics = opticsOf(next.optics);
      if (Object.keys(optics).length) more.open = true;
      for (const [name] of OPTICS)
        if (document.activeElement !== effects[name])
          effects[name].value = Number((optics[name] ?? 0).toPrecision(6));
    },
    clear: () => fill(title),
  };
}

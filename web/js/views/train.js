// The form that starts a training job.
import {api} from '../api.js';
import {fill, h} from '../dom.js';
import {bytes, decibel, seconds, whole} from '../format.js';
import {find, putJob, state} from '../store.js';
import {choice, endOf, field, panel, showFaults} from '../ui.js';
import {go, link} from '../router.js';
import {estimatePanel} from './estimate.js';

import {effectTitle} from './effects.js';

/**
 * What each is for and where it ends unless told otherwise (tests/api/test_settings.py holds it
 * against the daemon's).
 */
const PRESETS = {
  draft: {hint: 'Quickest to a picture: 15 seconds.', seconds: '15'},
  standard: {hint: 'The best in about a minute on a CPU.', seconds: '60'},
  paper: {hint: 'The published settings, 120 000 steps: for a GPU.', seconds: ''}
};

/** A name that no scene has: lego, lego-2, … */
export function freeName(name, scenes) {
  if (!find(scenes, name)) return name;
  for (let i = 2;; i++)
    if (!find(scenes, `${name}-${i}`)) return `${name}-${i}`;
}

const numeric = (label, unit, pointer, props, hint) =>
    field(label, h('input', {type: 'number', ...props}), {unit, pointer, hint});

/** How the other one went, which is what to expect; and what of its options has no field here. */
function likeWords({scene, job}, rest) {
  const r = job.result;
  const took = r ? `${whole(r.steps)} steps in ${seconds(r.train_seconds)}${
                       r.psnr ? `, ${decibel(r.psnr)}` : ''}` :
                   `it ${endOf(job)}`;
  const more = Object.entries(rest).map(([key, value]) => `${key} ${value}`).join(', ');
  return `As ${scene.name} was trained: ${took}, ${bytes(scene.memory_bytes)} of memory.${
      more ? ` Also as there: ${more}.` : ''}`;
}

/**
 * @param {any} dataset @param {{scene: any, job: any}|null} like a training whose options the form
 *     begins with
 */
export function trainPanel(dataset, like = null) {
  const was = {...like?.job.options};
  // What the form has a field for is taken out of them; the rest is asked for once more.
  const take = (key, fallback, known) => {
    const value = was[key];
    if (value === undefined || known && !known.includes(String(value))) return fallback;
    delete was[key];
    return String(value);
  };
  const name = field(
      'Scene’s name', h('input', {
        type: 'text',
        required: true,
        maxLength: 64,
        spellcheck: 'false',
        autocomplete: 'off',
        value: freeName(like?.scene.name ?? dataset.name, state.scenes)
      }),
      {pointer: '/scene'});
  const chosen = take('preset', 'standard', Object.keys(PRESETS));
  const preset = choice(
      'Preset', Object.keys(PRESETS).map((key) => [key, key]), chosen,
      {pointer: '/options/preset', hint: PRESETS[chosen].hint});
  const time = numeric(
      'Time', 's', '/options/max_time_s',
      {min: 1, step: 'any', placeholder: 'any', value: take('max_time_s', like ? '' : PRESETS.standard.seconds)});
  const steps = numeric(
      'Steps', '', '/options/max_steps', {min: 1, placeholder: 'any', value: take('max_steps', '')});
  const psnr = numeric(
      'PSNR', 'dB', '/options/until_psnr', {min: 1, max: 100, step: 'any', placeholder: 'any', value: take('until_psnr', '')});
  const plateau = h('input', {
    type: 'checkbox',
    id: 'until-plateau',
    checked: take('until_plateau', 'false') === 'true',
    onchange: () => {
      if (plateau.checked && !timeChosen) time.control.value = '';
    }
  });
  const planes = choice(
      'Planes', [['', 'preset'], ['3', '3'], ['4', '4'], ['6', '6'], ['10', '10']], take('planes', '', ['3', '4', '6', '10']),
      {pointer: '/options/planes', hint: 'More tell more directions apart, and take longer.'});
  const footprint = choice(
      'Footprint', [['', 'preset'], ['rip', 'rip'], ['mip', 'mip'], ['point', 'point']],
      take('footprint', '', ['rip', 'mip', 'point']),
      {pointer: '/options/footprint', hint: 'rip: anisotropic, mip: one level, point: none'});
  const split = choice(
      'Train on', [['train', 'train'], ['trainval', 'train and val']],
      take('train_split', 'train', ['train', 'trainval']),
      {pointer: '/options/train_split'});
  const seed = numeric('Seed', '', '/options/seed', {min: 0, placeholder: '0', value: take('seed', '')});
  const threads = numeric('Threads', '', '/options/threads', {min: 0, placeholder: 'all', value: take('threads', '')});
  const optionOf = (effect) => `effect_${effect.replaceAll('-', '_')}`;
  const effects = state.info.effects.map(
      (effect) => choice(
          effectTitle(effect), [['', 'auto'], ['on', 'on'], ['off', 'off']],
          take(optionOf(effect), '', ['on', 'off']), {pointer: `/options/${optionOf(effect)}`}));
  const fields =
      [name, preset, time, steps, psnr, planes, footprint, split, seed, threads, ...effects];
  const problem = h('div');
  const estimate = estimatePanel(
      dataset, () => values(), (error) => showFaults(fields, problem, error));
  const start = h('button', {type: 'submit', class: 'primary'}, 'Start training');
  let timeChosen = Boolean(like);
  time.control.addEventListener('input', () => {
    timeChosen = true;
  });
  preset.control.onChange(() => {
    const {hint, seconds: usual} = PRESETS[preset.control.value];
    preset.fault(null);
    fill(preset.node.querySelector('.note'), hint);
    if (!timeChosen) time.control.value = plateau.checked ? '' : usual;
  });
  async function submit() {
    start.disabled = true;
    try {
      putJob(await api.submit({
        type: 'train',
        dataset: dataset.id,
        scene: name.control.value.trim(),
        options: values()
      }));
      go(link.scene(name.control.value.trim()));
    } catch (error) {
      showFaults(fields, problem, error);
      start.disabled = false;
    }
  }
  function values() {
    const options = {...was, preset: preset.control.value, train_split: split.control.value};
    const numbers = {max_time_s: time, max_steps: steps, until_psnr: psnr, seed, threads};
    for (const [key, item] of Object.entries(numbers))
      if (item.control.value !== '') options[key] = Number(item.control.value);
    if (plateau.checked) options.until_plateau = true;
    if (planes.control.value) options.planes = Number(planes.control.value);
    if (footprint.control.value) options.footprint = footprint.control.value;
    state.info.effects.forEach((effect, i) => {
      if (effects[i].control.value) options[optionOf(effect)] = effects[i].control.value;
    });
    return options;
  }
  return panel(
      'Train a scene', {class: 'panel', id: 'train'},
      h('form', {
        onsubmit: (event) => {
          event.preventDefault();
          submit();
        }
      },
        name.node, preset.node,
        h('fieldset', {class: 'field'}, h('legend', null, 'Stop at whichever comes first'),
          h('div', {class: 'form-grid three'}, time.node, steps.node, psnr.node),
          h('div', {class: 'field check'}, plateau,
            h('label', {'for': 'until-plateau'}, 'where more time gains nothing')),
          h('span', {class: 'note'},
            'With neither time nor steps it ends where the preset does, or, where more time is to gain nothing, after ten times that at most.')),
        h('details', {open: [planes, footprint, seed, threads].some(({control}) => control.value !== '')},
          h('summary', null, 'More'),
          h('div', {class: 'form-grid'}, planes.node, footprint.node, split.node, seed.node, threads.node)),
        h('details', null, h('summary', null, 'Effects'),
          h('p', {class: 'quiet'},
            'Each is on where the photographs call for it, and costs nothing when off.'),
          h('div', {class: 'form-grid lined'}, effects.map((effect) => effect.node))),
        like ? h('p', {class: 'quiet like'}, likeWords(like, was)) : null, problem, estimate.node, h('div', {class: 'row end'}, estimate.button, start)));
}

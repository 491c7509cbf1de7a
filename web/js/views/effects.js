// What a scene's effects are, why, and what each brings and costs, where that was measured.
import {api, Problem} from '../api.js';
import {fill, h, text} from '../dom.js';
import {isActive, isOver, may, means, putJob, watch} from '../store.js';
import {fixed, plural, seconds} from '../format.js';
import {action, meter, panel, progressWords, toast} from '../ui.js';
import {jobButtons} from './jobs.js';

/** What is asked of a measurement: each effect's pairs of trainings, of so many seconds each. */
const ASKED = {seeds: 3, seconds: 10};

/** How long it takes; null where a scene of an older build does not tell what can be measured. */
function durationWords(effects) {
  if (!may('train')) return 'What they bring was not measured.';
  if (effects.some((effect) => effect.measurable === undefined)) return null;
  const count = effects.filter((effect) => effect.measurable).length;
  if (!count) return 'None of them can be left out: there is nothing to measure.';
  const time = seconds(2 * count * ASKED.seeds * ASKED.seconds);
  return `What they bring was not measured. That takes ${time} and what loading and evaluating add: ${
      plural(ASKED.seeds, 'pair')} of trainings of ${ASKED.seconds} s for ${
      count === 1 ? 'the one' : `each of ${count}`} that can be left out. Other jobs wait for it.`;
}

/** What an effect is called on the page: "scale-pyramid" is "Scale pyramid". */
export const effectTitle = (name) =>
    name[0].toUpperCase() + name.slice(1).replaceAll('-', ' ');

const signed = (x, digits) => `${x < 0 ? '−' : '+'}${fixed(Math.abs(x), digits)}`;
const share = (x) => (x === null ? '–' : `${signed(100 * x, 0)} %`);

/** What it brings beside trainings without it, in words. */
const gainWords = (gain) =>
    `${gain.gain === null ? 'No view is withheld' : `${signed(gain.gain, 2)} dB`}${
        gain.gain_spread === null ? '' : ` ± ${fixed(gain.gain_spread, 2)}`}; ${
        share(gain.cost)} time in training, ${share(gain.picture_cost)} for a picture`;

const row = (effect, gain) =>
    h('li', {class: 'effect', 'data-on': String(effect.on && effect.decided)},
      h('span', {class: 'effect-mark'}, effect.decided ? effect.on ? 'on' : 'off' : 'open'),
      h('div', null, h('strong', null, effectTitle(effect.name)),
        h('p', {class: 'quiet'}, effect.reason),
        gain ? h('p', {class: 'effect-gain'}, gainWords(gain)) : null),
      h('span', {class: 'number'}, effect.number_text ?? '–',
        effect.threshold_text ? h('small', {class: 'line'}, conditionWords(effect)) : null));

/**
 * How the number is held against the threshold, which an older build did not tell; empty where it is
 * held against none.
 */
export const conditionWords = ({below, threshold_text: threshold}) => !threshold ? '' :
    `${below === undefined ? 'threshold' : below ? 'on if at most' : 'on if over'} ${threshold}`;

/** Off, and nothing that the photographs call for. */
const isIdle = ({decided, on, number, threshold, below}) =>
    decided && !on && !(below ? number !== null && number <= threshold : number > threshold);

/**
 * @param {any} scene @param {AbortSignal} signal
 * @returns {{node: HTMLElement, show: (scene: any) => void}} `show` takes the scene as it is now
 */
export function createEffects(scene, signal) {
  const list = h('ul', {class: 'effects'});
  const rest = h('ul', {class: 'effects'});
  const count = h('summary');
  const idle = h('details', null, count, rest);
  const words = h('p', {class: 'quiet'});
  const about = h('p', {class: 'quiet'});
  const under = h('div');
  const bar = meter('Measuring');
  const buttons = jobButtons(true);
  const measure = action('Measure', async () => putJob(await api.measureEffects(scene.id, ASKED)),
    {kind: 'small', title: 'Short trainings with each effect and without it: many minutes, for which other jobs wait'});
  let now = scene;
  let measured = null;
  let known = null;

  function show(latest) {
    now = latest;
    const gains = new Map(measured?.gains.map((gain) => [gain.name, gain]));
    const rows = (effects) => effects.map((effect) => row(effect, gains.get(effect.name)));
    const off = now.effects.filter(isIdle);
    fill(list, rows(now.effects.filter((effect) => !isIdle(effect))));
    fill(rest, rows(off));
    text(count, `${off.length} that the photographs do not call for`);
    idle.hidden = !off.length;
    measure.hidden = !may('train') || Boolean(now.viewing) ||
        !now.effects.some((effect) => effect.measurable !== false);
    fill(words, now.effects.length ?
        'An effect is on if its number is as said below it and what else its reason names allows it. What is off is not computed.' :
        'Decided when training begins.');
    const told = measured ?
        `Gains: ${plural(measured.seeds, 'pair')} of trainings of ${
            measured.seconds} s with each and without, on withheld views (${measured.held_out}).` :
        now.effects.length && !now.viewing ? durationWords(now.effects) : null;
    about.hidden = !told;
    fill(about, told);
  }

  async function load() {
    try {
      measured = await api.effects(scene.id, signal);
    } catch (error) {
      if (signal.aborted) return;
      if (!(error instanceof Problem && error.status === 404)) toast(error);
    }
    show(now);
  }

  watch(({jobs}) => {
    const own = jobs.filter((job) => job.type === 'effects' && means(job.scene, scene));
    const active = own.find(isActive);
    fill(under, active ? [bar.node, buttons.node] : null);
    if (active) {
      bar.set(active.progress?.fraction ?? null, progressWords(active));
      buttons.update(active);
    }
    const over = own.filter(isOver).map((job) => job.id).join();
    if (over === known) return;
    known = over;
    load();
  }, signal);
  show(scene);
  return {node: panel('Effects', {tools: measure}, words, about, under, list, idle), show};
}

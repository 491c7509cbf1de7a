// What a picture's accuracy costs in time: the scene's curve, a budget, and what came of it.
import {api, Problem} from '../api.js';
import {fill, h, s, text} from '../dom.js';
import {decibel, expectedPsnr, milliseconds, plural} from '../format.js';
import {ticks} from '../chart.js';
import {isActive, isOver, may, means, putJob, watch} from '../store.js';
import {action, meter, panel, progressWords, toast} from '../ui.js';
import {jobButtons} from './jobs.js';

const [LEAST_MS, MOST_MS] = [5, 5000];
const MARGIN = {left: 34, right: 14, top: 12, bottom: 32};
const ANY = 1;  // the slider's right end: as long as it takes
const timeAt = (x) => LEAST_MS * (MOST_MS / LEAST_MS) ** x;
const wordsOf = (setting) =>
    Object.entries(setting ?? {}).map(([key, value]) => `${key} ${value}`).join(', ') || 'full';
const psnrOf = (point) => point.psnr ?? point.psnr_full;

/** The best accuracy that the curve promises within a time; null below its cheapest point. */
export function expectedWithin(points, ms) {
  const within = points.filter((point) => point.ms_median <= ms && psnrOf(point) !== null);
  return within.length ? Math.max(...within.map(psnrOf)) : null;
}

/** " (waited 0.2 ms, rendered in 35 ms, encoded in 1.1 ms)" */
const partsOf = ({queueMs, renderMs, encodeMs}) =>
    ` (waited ${milliseconds(queueMs)}, rendered in ${milliseconds(renderMs)}, encoded in ${milliseconds(encodeMs)})`;

export function drawCost(host, points, {budget, spent, truth, size}) {
  const [width, height] = size ? [size.width, size.height] : [Math.max(220, host.clientWidth), 150];
  const inner = {w: width - MARGIN.left - MARGIN.right, h: height - MARGIN.top - MARGIN.bottom};
  const known = points.filter((point) => psnrOf(point) !== null);
  const times = known.map((point) => point.ms_median);
  const values = known.map(psnrOf);
  const [low, high] = [Math.floor(Math.min(...values)), Math.ceil(Math.max(...values) + 0.1)];
  const [first, last] = [Math.log(Math.min(...times) / 1.4), Math.log(Math.max(...times) * 1.4)];
  const X = (ms) => MARGIN.left +
      Math.max(0, Math.min(1, (Math.log(ms) - first) / (last - first || 1))) * inner.w;
  const Y = (db) => MARGIN.top + (1 - (db - low) / (high - low || 1)) * inner.h;
  const root = s('svg', {
    viewBox: `0 0 ${width} ${height}`,
    width,
    height,
    role: 'img',
    class: 'chart',
    'aria-label': `PSNR from ${decibel(values[0])} in ${milliseconds(times[0])} to ${
        decibel(values.at(-1))} in ${milliseconds(times.at(-1))}`
  });
  for (const db of ticks(low, high, 4))
    root.append(
        s('line', {class: 'grid', x1: MARGIN.left, x2: width - MARGIN.right, y1: Y(db), y2: Y(db)}),
        s('text', {x: MARGIN.left - 7, y: Y(db) + 4, 'text-anchor': 'end'}, db));
  for (const ms of [2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000])
    if (Math.log(ms) > first && Math.log(ms) < last)
      root.append(s('text', {x: X(ms), y: height - 16, 'text-anchor': 'middle'}, ms));
  root.append(
      s('text', {x: width - MARGIN.right, y: height - 2, 'text-anchor': 'end'},
        'milliseconds a picture'),
      s('polyline', {
        class: 'line',
        points: known.map((point) => `${X(point.ms_median)},${Y(psnrOf(point))}`).join(' ')
      }));
  known.forEach((point) => root.append(
      s('circle', {class: 'dot', cx: X(point.ms_median), cy: Y(psnrOf(point)), r: 3},
        s('title', null, `${wordsOf(point.setting)}: ${milliseconds(point.ms_median)}, ${decibel(psnrOf(point))}`))));
  if (budget)
    root.append(s('line', {class: 'now', x1: X(budget), x2: X(budget), y1: MARGIN.top, y2: height - MARGIN.bottom}));
  if (spent && truth)
    root.append(s('circle', {class: 'truth', cx: X(spent), cy: Y(truth), r: 6}));
  fill(host, root);
}

/**
 * @param {any} scene
 * @param {{choose: (ms: number|null) => void, known: (curve: any) => void, besideFull: () =>
 *     Promise<void>}} host `choose` is told the budget, `known` the curve or null whenever it was
 *     read; `besideFull` compares the picture with the full one
 * @param {AbortSignal} signal
 * @returns {{node: HTMLElement, picture: (facts: any) => void}} `picture` hears of each refined one
 */
export function createCurve(scene, {choose, known: tell, besideFull}, signal) {
  const chart = h('div', {class: 'cost-chart'});
  const words = h('p', {class: 'quiet'});
  const truth = h('p', {class: 'quiet', role: 'status'});
  const bar = meter('Measuring');
  const buttons = jobButtons(true);
  const under = h('div');
  const slider = h('input', {
    type: 'range', id: 'budget', min: 0, max: ANY, step: 0.005, value: ANY
  });
  const label = h('output', {'for': 'budget'}, 'as long as it takes');
  const again = action('Measure', async () => putJob(await api.measureCurve(scene.id)),
    {kind: 'small', title: 'Renders held-out views at every setting'});
  const check = action('Beside the full picture', besideFull,
    {kind: 'small', title: 'Renders this view in full too, and says how far the two are apart'});
  let curve = null;
  let last = null;
  let known = '';
  const budget = () => (Number(slider.value) >= ANY ? null : Math.round(timeAt(Number(slider.value))));

  function show() {
    const ms = budget();
    text(label, ms ? milliseconds(ms) : 'as long as it takes');
    text(
        words,
        !curve ? 'Not measured for this scene yet; until then its preset’s curve decides.' :
            `${plural(curve.views, 'view')} of ${curve.width} × ${curve.height}, ${
                curve.photographs ? 'against photographs' : 'against the full picture'}, ${
                curve.kernels}${curve.stale ? `; measured before ${curve.stale_because || 'something'} changed` : ''}.`);
    chart.hidden = !curve;
    if (curve)
      drawCost(chart, curve.points, {
        budget: ms,
        spent: last?.spentMs,
        truth: last && Number.isFinite(last.expectedPsnr) ? last.expectedPsnr : null
      });
    check.hidden = !ms || last?.askedMs !== ms;
    const promise = curve && ms ? expectedWithin(curve.points, ms) : null;
    text(
        truth,
        !ms ? '' :
        !last || last.askedMs !== ms ?
              `within ${milliseconds(ms)}${promise ? `: about ${decibel(promise, 1)} at the curve’s size` : ''}` :
              `${curve ? '○ ' : ''}this view at ${last.width} × ${last.height}: ${
                  expectedPsnr(last.expectedPsnr, last.expectedSpread)}; took ${milliseconds(last.spentMs)} of ${milliseconds(ms)}${
                  partsOf(last)}${last.late ? ', late' : ''}; ${
                  last.setting === 'full' ? 'nothing left out' : `setting ${last.setting.replaceAll(',', ', ')}`}`);
  }

  async function load() {
    try {
      curve = await api.curve(scene.id, signal);
    } catch (error) {
      if (signal.aborted) return;
      if (!(error instanceof Problem && error.status === 404)) toast(error);
    }
    text(again, curve ? 'Measure again' : 'Measure');
    show();
    tell(curve);
  }

  slider.addEventListener('input', show);
  slider.addEventListener('change', () => choose(budget()));
  watch(({jobs}) => {
    const own = jobs.filter((job) => job.type === 'curve' && means(job.scene, scene));
    const active = own.find(isActive);
    fill(under, active ? [bar.node, buttons.node] : null);
    if (active) {
      bar.set(active.progress?.fraction ?? null, progressWords(active));
      buttons.update(active);
    }
    const key = own.filter(isOver).map((job) => job.id).join();
    if (key !== known) {
      known = key;
      load();
    }
  }, signal);
  const observer = new ResizeObserver(() => curve && show());
  observer.observe(chart);
  signal.addEventListener('abort', () => observer.disconnect(), {once: true});
  load();
  const node = panel(
      'Accuracy against time', {'data-order': 2, tools: may('render') ? again : null}, chart, words,
      under,
      may('render') ?
          [
            h('div', {class: 'tool budget'}, h('label', {'for': 'budget'}, 'Time for a picture'),
              slider, label),
            truth, check
          ] :
          null);
  return {
    node,
    picture: (facts) => {
      last = Number.isFinite(facts.askedMs) ? facts : null;
      show();
    },
  };
}

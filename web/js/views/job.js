// One job of any kind: its state and what came of it.
import {api} from '../api.js';
import {fill, h, text} from '../dom.js';
import {find, isActive, isVisit, isVisitor, may, putJob, state, watch} from '../store.js';
import {ago, decibel, expectedPsnr, fixed, milliseconds, plural, seconds} from '../format.js';
import {
  chip,
  empty,
  endOf,
  facts,
  kindOf,
  meter,
  panel,
  problemBox,
  progressWords,
  recordedProblem,
  scroller,
  setChip,
  skeleton,
  subjectOf
} from '../ui.js';
import {link} from '../router.js';
import {estimateResult} from './estimate.js';
import {exportResult} from './exports.js';
import {framesPanel} from './frames.js';
import {ladderPanel} from './ladder.js';
import {doctorReport} from './stability.js';
import {trainingPanel} from './training.js';
import {effectsOfKeys, OPTICS} from '../optics.js';
import {called, FILMS, FRAMES, OUTPUTS} from '../outputs.js';
import {jobButtons, runnerWords} from './jobs.js';

export async function jobView(root, {id, signal}) {
  const body = h('div', null, panel('Job', null, skeleton(4)));
  fill(root, body);
  const load = async () => {
    try {
      await isVisit(signal);
      const job = putJob(await api.job(id, signal));
      const scene = job.type === 'train' && await api.scene(job.scene, signal).catch(() => null);
      if (!signal.aborted) fill(root, head(job, signal), page(job, Boolean(scene), signal));
    } catch (error) {
      if (!signal.aborted)
        fill(
            body,
            h('div', {class: 'page-head'}, h('a', {class: 'back', href: link.jobs()}, 'Jobs'),
              h('h1', null, id)),
            problemBox(error, {again: load}));
    }
  };
  await load();
}

function head(job, signal) {
  const mark = chip(job.state);
  watch(() => setChip(mark, find(state.jobs, job.id)?.state ?? job.state), signal);
  return h(
      'div', {class: 'page-head'}, h('a', {class: 'back', href: link.jobs()}, 'Jobs'),
      h('h1', null, `${kindOf(job)} ${subjectOf(job)}`), mark);
}

function page(job, trained, signal) {
  if (isVisitor()) return h('div', {class: 'stack'}, framesPanel(job, signal));
  const side = [statePanel(job, signal), aboutJob(job, signal)];
  if (job.type === 'path')
    return h(
        'div', {class: 'columns wide'}, h('div', {class: 'main-column'}, framesPanel(job, signal)),
        h('div', {class: 'side-column'}, side));
  if (job.type === 'ladder')
    return h(
        'div', {class: 'columns wide'}, h('div', {class: 'main-column'}, ladderPanel(job, signal)),
        h('div', {class: 'side-column'}, side));
  if (trained)
    return h(
        'div', {class: 'columns wide'},
        h('div', {class: 'main-column'}, trainingPanel(job.scene, signal)),
        h('div', {class: 'side-column'}, aboutJob(job, signal)));
  return h(
      'div', {class: 'columns wide'}, h('div', {class: 'main-column'}, resultPanel(job, signal)),
      h('div', {class: 'side-column'}, side));
}

/** What a job was asked for, with what it takes where it was not. */
const DEFAULTS = {
  train: {preset: 'standard', train_split: 'train', seed: 0, device: 'auto', threads: 'all'},
  path: {
    output: 'colour',
    tolerance: '0, all that the scene has',
    supersample: 'as the scene calls for'
  },
  eval: {split: 'test', views: 'all', scale: 'all', tolerance: '0, all that the scene has'},
  ingest: {split: 'as in the files', max_size: 'as they are', scales: 1, alpha: 'premultiplied'}
};
const UNIT = {
  ...Object.fromEntries(OPTICS.map(([name, , unit]) => [name, ` ${unit}`])),
  max_time_s: ' s',
  until_psnr: ' dB',
  fps: ' a second',
  width: ' px',
  height: ' px'
};
const WORDS = {fps: 'frames'};
const NAMED = {output: OUTPUTS, film: FILMS, format: FRAMES};
/** Options of options are told as its own. */
const flat = (options) =>
    Object.entries(options ?? {})
        .flatMap(
            ([key, value]) => value && typeof value === 'object' && !Array.isArray(value) ?
                flat(value) :
                [[key, value]]);
/** @param {any} job @param {any} path the document of a path job, or null */
function askedFor(job, path) {
  const given =
      flat(job.options).filter(([, value]) => value !== null && value !== 0 && value !== '');
  const rows = {
    ...(DEFAULTS[job.type] ?? {}),
    ...effectsOfKeys(path?.keys ?? []),
    ...Object.fromEntries(given)
  };
  return Object.entries(rows).map(([key, value]) => {
    const words = (WORDS[key] ?? key.replace(/_s$/, '')).replaceAll('_', ' ');
    return [
      words[0].toUpperCase() + words.slice(1),
      (Array.isArray(value) ? value.join(', ') : called(NAMED[key] ?? [], value)) + (UNIT[key] ?? '')
    ];
  });
}

function statePanel(job, signal) {
  const bar = meter(kindOf(job));
  const buttons = jobButtons(false);
  const trouble = h('div');
  let shown = '';
  watch(() => {
    const now = find(state.jobs, job.id) ?? job;
    bar.node.hidden = now.state === 'failed';
    bar.set(
        isActive(now) ? now.progress?.fraction ?? (now.state === 'running' ? null : 0) :
                        now.progress?.fraction ?? 1,
        progressWords(now) || now.state);
    buttons.update(now);
    const key = JSON.stringify(now.problem ?? null);
    if (key !== shown) {
      shown = key;
      fill(trouble, now.problem ? recordedProblem(now.problem) : null);
    }
  }, signal);
  return panel('Progress', null, trouble, bar.node, buttons.node);
}

function aboutJob(job, signal) {
  const box = h('div');
  let path = null;
  const show = () => {
    const now = find(state.jobs, job.id) ?? job;
    fill(
        box, facts([
          [
            'Scene',
            now.scene ? h('a', {href: link.scene(now.scene_name ?? now.scene)},
                          now.scene_name ?? now.scene) :
                        null
          ],
          [
            'Dataset',
            !now.dataset ? null :
                find(state.datasets, now.dataset) ?
                           h('a', {href: link.dataset(now.dataset_name ?? now.dataset)},
                             now.dataset_name ?? now.dataset) :
                           now.dataset_name ?? now.dataset
          ],
          ['Submitted', ago(now.created_at)],
          ['Started', now.started_at ? ago(now.started_at) : 'not yet'],
          ['Ended', now.finished_at ? ago(now.finished_at) : null],
          [
            'Took',
            now.finished_at && now.started_at ?
                seconds((Date.parse(now.finished_at) - Date.parse(now.started_at)) / 1000) :
                null
          ],
          ['Runs', runnerWords(now) || null], ['Attempt', now.attempt > 1 ? now.attempt : null],
          [
            'A frame took',
            now.result?.render_ms_median ? milliseconds(now.result.render_ms_median) : null
          ],
          ['Its budget became', budgetWords(now.result)],
          [
            'Estimated before',
            now.result?.estimate ?
                `${decibel(now.result.estimate.psnr)} after ${seconds(now.result.estimate.seconds)}` :
                null
          ],
          ['Id', h('code', null, now.id)]
        ]),
        h('h3', null, 'Asked for'), facts(askedFor(now, path)));
  };
  watch(show, signal);
  if (job.type === 'path')
    api.pathOfJob(job.id, signal).then((document) => {
      path = document;
      show();
    }, () => {});
  return panel('About', null, box);
}

/** What a path or an evaluation by a budget was rendered with. */
function budgetWords(result) {
  if (!result?.setting) return null;
  const setting = result.setting.replaceAll(',', ', ');
  return result.expected_psnr ?
      `${setting}; ${expectedPsnr(result.expected_psnr, result.expected_spread)}` :
      setting;
}

/** What an evaluation, an import or a training job gave. */
function resultPanel(job, signal) {
  const box = h('div');
  let shown = '';
  watch(() => {
    const now = find(state.jobs, job.id) ?? job;
    const key = JSON.stringify([now.state, now.result]);
    if (key === shown) return;
    shown = key;
    fill(box, result(now));
  }, signal);
  return panel('Result', null, box);
}

function result(job) {
  if (isActive(job)) return empty('Not there yet');
  if (!job.result)
    return empty(
        `This job ${endOf(job)}`,
        h('p', null, job.problem ? 'Why is told beside it.' : 'It left no result.'));
  if (job.type === 'eval') return evaluationResult(job.result, job.scene_name ?? job.scene);
  if (job.type === 'estimate') return estimateResult(job.result);
  if (job.type === 'ingest' && job.result.scene)
    return h(
        'p', null, 'The scene is imported: ',
        h('a', {href: link.scene(job.scene_name ?? job.result.scene)},
          job.scene_name ?? job.result.scene),
        '.');
  if (job.type === 'ingest')
    return h(
        'p', null, 'The dataset is imported: ',
        h('a', {href: link.dataset(job.dataset_name ?? job.result.dataset)},
          job.dataset_name ?? job.result.dataset),
        '.');
  if (job.type === 'export') return exportResult(job);
  if (job.type === 'doctor') return doctorReport(job.result);
  if (job.type === 'effects' || job.type === 'curve')
    return h('p', null, 'What was measured is on the scene’s page.');
  return h('p', null, 'The scene that it trained is deleted.');
}

const headRow = (names) =>
    h('thead', null,
      h('tr', null,
        names.map((name, i) => h('th', {scope: 'col', class: i ? 'number' : null}, name))));

function evaluationResult(r, scene) {
  const p = r.protocol;
  const views = [...r.per_view].sort((a, b) => (a.psnr ?? Infinity) - (b.psnr ?? Infinity));
  const summary = h('p', {class: 'headline'});
  text(
      summary,
      `${decibel(r.psnr)} ± ${fixed(r.psnr_spread, 2)}, SSIM ${fixed(r.ssim, 4)}, ${
          milliseconds(r.render_ms_median)} a picture`);
  return [
    summary,
    h('p', {class: 'quiet'},
      `${plural(r.views, 'view')} of ${p.split} at step ${p.step}; background ${
          p.background.join(' ')}, ${p.downscale} scaling, rounding ${p.rounding}; trained on ${
          p.train_split} with seed ${p.seed}; ${p.version}, ${p.device} ${p.kernels}, ${
          plural(p.threads, 'thread')}.`),
    scroller(
        'By scale', null,
        h('table', {class: 'table'}, h('caption', null, 'By scale'),
          headRow(['Scale', 'PSNR', 'SSIM', 'Rendering']),
          h('tbody', null,
            r.scales.map(
                (s) =>
                    h('tr', null, h('th', {scope: 'row'}, s.scale ? `1/${2 ** s.scale}` : 'full'),
                      h('td', {class: 'number'}, decibel(s.psnr)),
                      h('td', {class: 'number'}, fixed(s.ssim, 4)),
                      h('td', {class: 'number'}, milliseconds(s.render_ms))))))),
    scroller(
        'By view', {class: 'tall'},
        h('table', {class: 'table'}, h('caption', null, 'By view, worst first'),
          headRow(['View', 'Scale', 'PSNR', 'SSIM', 'Rendering']),
          h('tbody', null,
            views.map(
                (v) => h(
                    'tr', null,
                    h('th', {scope: 'row'},
                      may('render') ?
                          h('a', {href: link.scene(scene, `?view=${p.split}:${v.index}`)}, v.name) :
                          v.name),
                    h('td', {class: 'number'}, v.scale ? `1/${2 ** v.scale}` : 'full'),
                    h('td', {class: 'number'}, decibel(v.psnr)),
                    h('td', {class: 'number'}, fixed(v.ssim, 4)),
                    h('td', {class: 'number'}, milliseconds(v.render_ms)))))))
  ];
}

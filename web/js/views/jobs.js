// All jobs, and the row of one job that other views show too.
import {api} from '../api.js';
import {fill, follow, h, text} from '../dom.js';
import {isActive, isVisitor, mayChange, putJob, watch} from '../store.js';
import {ago, decibel, fixed, milliseconds, plural, seconds, whole} from '../format.js';
import {
  action,
  chip,
  choice,
  empty,
  kindOf,
  meter,
  panel,
  progressWords,
  setChip,
  skeleton,
  subjectOf
} from '../ui.js';
import {go, link} from '../router.js';
import {exportWords} from './exports.js';
import {doctorWords} from './stability.js';
import {showVisit} from './visit.js';

const NAMES = {
  pause: 'Pause',
  resume: 'Resume',
  finish: 'Finish',
  cancel: 'Cancel'
};
const HINTS = {
  pause: 'Keeps everything; the clock stops',
  resume: 'Goes on where it was',
  finish: 'Stops training now and keeps the scene',
  cancel: 'Stops; the last checkpoint is kept'
};

/** What can be done with a job in its state. */
export function verbsOf(job) {
  const train = job.type === 'train';
  switch (job.state) {
    case 'running':
      return train ? ['pause', 'finish', 'cancel'] : ['cancel'];
    case 'queued':
      return train ? ['pause', 'cancel'] : ['cancel'];
    case 'paused':
      return ['resume', 'finish', 'cancel'];
    case 'interrupted':
      return ['cancel'];
    case 'failed':
    case 'cancelled':
      return job.type === 'path' ? ['resume'] : [];
    default:
      return [];
  }
}

/** A path that has ended is gone on with by another job, which is looked at then. */
async function order(job, verb) {
  const answer = putJob(await api.act(job.id, verb));
  if (answer.id !== job.id) go(link.job(answer.id));
}

/** Buttons for a job that follow its state. */
export function jobButtons(small) {
  const node = h('div', {class: 'row buttons'});
  let shown = '';
  return {
    node,
    update: (job) => {
      const verbs = mayChange(job) ? verbsOf(job) : [];
      const key = `${job.id} ${verbs.join()}`;
      if (key === shown) return;
      shown = key;
      fill(
          node,
          verbs.map(
              (verb) => action(
                  NAMES[verb], () => order(job, verb),
                  {kind: small ? 'small' : '', title: HINTS[verb]})));
    }
  };
}

/** Where it runs, or why it waits, when that is not on the daemon's machine. */
export function runnerWords({runner}) {
  if (!runner) return '';
  const number = runner.slurm_job ? `Slurm ${runner.slurm_job}` : '';
  return runner.reason ? [`waits: ${runner.reason}`, number].filter(Boolean).join(', ') :
                         [`on ${runner.machine ?? 'a node'}`, number].filter(Boolean).join(', ');
}

/** Where a job is best looked at: training on its scene's page. */
export const placeOf = (job) =>
    (job.type === 'train' && (job.scene_name ?? job.scene) ?
         link.scene(job.scene_name ?? job.scene) :
         link.job(job.id));

/** What each type of job came to, in a few words. */
const FIGURES = {
  train: (r) =>
      `${decibel(r.psnr)}${
          (r.psnr_step ?? r.steps) < r.steps ? ` at step ${whole(r.psnr_step)};` : ' after'} ${
          whole(r.steps)} steps in ${seconds(r.train_seconds)}`,
  path: (r) => `${plural(r.frames, 'frame')} of ${r.width} × ${r.height}`,
  eval: (r) => `${decibel(r.psnr)}, SSIM ${fixed(r.ssim, 4)} over ${plural(r.views, 'view')}`,
  ingest: () => 'checked and kept',
  curve: ({points: [first, ...rest]}) => `${plural(rest.length + 1, 'setting')}, ${
      milliseconds(first.ms_median)} to ${milliseconds((rest.at(-1) ?? first).ms_median)}`,
  estimate: (r) => [r.seconds && seconds(r.seconds), r.psnr && `about ${decibel(r.psnr)}`]
      .filter(Boolean)
      .join(', '),
  effects: (r) => r.gains
      .map(({name, gain}) =>
          `${name} ${gain === null ? 'not measured' : `${gain < 0 ? '−' : '+'}${fixed(Math.abs(gain), 2)} dB`}`)
      .join(', '),
  export: exportWords,
  ladder: (r) => `${plural(r.trainings, 'training')} of ${plural(r.arms, 'arm')}, ${
      seconds(r.train_seconds)}${r.failed ? `, ${r.failed} failed` : ''}`,
  doctor: doctorWords,
  validate: ({views: v, report}) =>
      `${v.train} to train, ${v.val} to validate, ${v.test} to test; ${
          plural(report.errors, 'error')}, ${plural(report.warnings, 'warning')}`
};

/** How a job that is over went, in one line. */
function outcomeOf({type, result, problem}) {
  if (problem) return [problem.title, problem.detail].filter(Boolean).join(': ');
  return result ? FIGURES[type](result) : '';
}

export function jobRow(first) {
  const state = chip(first.state);
  const bar = meter(`${kindOf(first)} ${subjectOf(first)}`);
  const buttons = jobButtons(true);
  const when = h('span', {class: 'quiet'});
  const outcome = h('p', {class: 'outcome quiet'});
  const node =
      h('article', {class: 'job-row'},
        h('div', {class: 'row'},
          h('a', {href: placeOf(first)}, `${kindOf(first)} `, h('strong', null, subjectOf(first))),
          state, when),
        bar.node, outcome, buttons.node);
  const update = (job) => {
    setChip(state, job.state);
    bar.node.hidden = !isActive(job);
    bar.set(
        job.state === 'queued' ? 0 : job.progress?.fraction ?? (job.state === 'running' ? null : 0),
        progressWords(job));
    text(
        when,
        `${ago(job.finished_at ?? job.started_at ?? job.created_at)}${
            job.attempt > 1 ? `, attempt ${job.attempt}` : ''}${
            runnerWords(job) && `, ${runnerWords(job)}`}`);
    text(outcome, outcomeOf(job));
    buttons.update(job);
  };
  return {node, update};
}

export function jobsView(root, {signal}) {
  const filter = choice(
      'Show',
      [
        ['', 'all'], ['train', 'training'], ['path', 'paths'], ['eval', 'evaluations'],
        ['ingest', 'imports']
      ],
      '');
  const rows = h('div', {class: 'rows'});
  const box = h('div');
  fill(
      root, h('div', {class: 'page-head'}, h('h1', null, 'Jobs')),
      panel('All jobs', {tools: filter.node}, box));
  let latest = null;
  const show = (state) => {
    latest = state;
    if (state.loaded && isVisitor()) return showVisit(root, state);
    const jobs =
        state.jobs.filter((job) => !filter.control.value || job.type === filter.control.value);
    if (!state.loaded)
      fill(box, skeleton(4));
    else if (!jobs.length)
      fill(
          box,
          empty(
              'No jobs',
              h('p', null, 'Imports, training, camera paths and evaluations show here.')));
    else {
      if (box.firstChild !== rows) fill(box, rows);
      follow(rows, jobs, (job) => job.id, jobRow);
    }
  };
  filter.control.onChange(() => show(latest));
  watch(show, signal);
}

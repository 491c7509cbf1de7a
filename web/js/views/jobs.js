// All jobs, and the row of one job that other views show too.
import {api} from '../api.js';
import {fill, follow, h, text} from '../dom.js';
import {isActive, putJob, watch} from '../store.js';
import {ago, decibel, fixed, plural, seconds, whole} from '../format.js';
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
import {link} from '../router.js';

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
    default:
      return [];
  }
}

/** Buttons for a job that follow its state. */
export function jobButtons(small) {
  const node = h('div', {class: 'row buttons'});
  let shown = '';
  return {
    node,
    update: (job) => {
      const verbs = verbsOf(job);
      const key = `${job.id} ${verbs.join()}`;
      if (key === shown) return;
      shown = key;
      fill(
          node,
          verbs.map(
              (verb) => action(
                  NAMES[verb], async () => putJob(await api.act(job.id, verb)),
                  {kind: small ? 'small' : '', title: HINTS[verb]})));
    }
  };
}

/** Where a job is best looked at: training on its scene's page. */
export const placeOf = (job) =>
    (job.type === 'train' && (job.scene_name ?? job.scene) ?
         link.scene(job.scene_name ?? job.scene) :
         link.job(job.id));

/** How a job that is over went, in one line. */
function outcomeOf(job) {
  const {result: r, problem} = job;
  if (problem) return [problem.title, problem.detail].filter(Boolean).join(': ');
  if (!r) return '';
  if (job.type === 'train')
    return `${decibel(r.psnr)} after ${whole(r.steps)} steps in ${seconds(r.train_seconds)}`;
  if (job.type === 'eval')
    return `${decibel(r.psnr)}, SSIM ${fixed(r.ssim, 4)} over ${plural(r.views, 'view')}`;
  return job.type === 'path' ? `${plural(r.frames, 'frame')} of ${r.width} × ${r.height}` :
                               'checked and kept';
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
            job.attempt > 1 ? `, attempt ${job.attempt}` : ''}`);
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

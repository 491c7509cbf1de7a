// What the page knows: lists of records kept fresh by the daemon's event stream.
import {api, hooks, Problem} from './api.js';
import {readEvents} from './events.js';
import {sleep} from './dom.js';

export const state = {
  /** status: connecting | online | offline */
  connection: {status: 'connecting', retryAt: 0, problem: null},
  loaded: false,
  info: null,
  uploads: {},  // of this page, under way: dataset's name -> {share, signal, cancel}
  /** @type {any[]} newest first */
  datasets: [],
  /** @type {any[]} */
  scenes: [],
  /** @type {any[]} */
  jobs: [],
};

const watchers = new Set();
let planned = false;

function changed() {
  if (planned) return;
  planned = true;
  queueMicrotask(() => {
    planned = false;
    for (const watcher of [...watchers]) watcher(state);
  });
}

/** Calls `watcher` now and after every change, until the signal aborts. */
export function watch(watcher, signal) {
  watchers.add(watcher);
  signal?.addEventListener('abort', () => watchers.delete(watcher), {once: true});
  watcher(state);
}

/**
 * A dataset that this page sends; null: it is over. @param {{share: number, signal: AbortSignal,
 *     cancel: () => void}|null} upload the share that is sent; aborted once its view was left
 */
export function noteUpload(name, upload) {
  if (upload === null)
    delete state.uploads[name];
  else
    state.uploads[name] = upload;
  changed();
}

const TERMINAL = new Set(['succeeded', 'failed', 'cancelled']);
export const isOver = (job) => TERMINAL.has(job.state);
export const isActive = (job) => Boolean(job) && !isOver(job);
const newestFirst = (a, b) => time(b.created_at) - time(a.created_at);
const time = (value) => (typeof value === 'number' ? value : Date.parse(value) || 0);

export const find = (items, id) => items.find((item) => item.id === id || item.name === id) ?? null;
/** Whether a job's `scene` or `dataset` field (a name or an id) means this record. */
export const means = (field, record) =>
    Boolean(record) && (field === record.id || field === record.name);

/** The training job of a scene: the one it names, else the newest that names it. */
export function trainingOf(scene) {
  return find(state.jobs, scene.job) ??
      state.jobs.find((job) => job.type === 'train' && means(job.scene, scene)) ?? null;
}

/** Takes in one job record (from an answer or an event, perhaps an old one) and returns it. */
export function putJob(job) {
  const at = state.jobs.findIndex((old) => old.id === job.id);
  const before = at < 0 ? null : state.jobs[at];
  if (before && isOver(before) && !isOver(job)) return before;
  if (at < 0)
    state.jobs = [job, ...state.jobs].sort(newestFirst);
  else
    state.jobs[at] = {...before, ...job};
  if (!before || before.state !== job.state) refreshSoon();
  changed();
  return job;
}

function putProgress(id, progress) {
  const job = find(state.jobs, id);
  if (!job) {
    refreshSoon();
    return;
  }
  job.progress = progress;
  changed();
}

/** Whether who looks has a link: one scene, or the pictures of one job, is all there is. */
export const isVisitor = () => Boolean(state.info?.you?.scene ?? state.info?.you?.job);

const SCOPES = ['read', 'render', 'train', 'admin'];  // each may what those before it may
/** Whether who looks has this scope; nothing is offered that the daemon would refuse. */
export const may = (scope) =>
    !isVisitor() && SCOPES.indexOf(state.info?.you?.scope) >= SCOPES.indexOf(scope);
/** Whether pictures are to be had: of its own scene, to who has a link. */
export const mayRender = () => isVisitor() || may('render');

/** The job that made a scene or a dataset; a job is its own. */
const makerOf = (record) => record.type ?
    record :
    state.jobs.find(
        (job) => job.id === record.job || job.type === 'ingest' && job.dataset === record.id);
/** Whether who looks may stop a job, or delete what one made: they asked for it, or may all. */
export const mayChange = (record) =>
    may('admin') || (makerOf(record)?.owner ?? '') === state.info?.you.id;

/** What a link shows, and no more: no other list would be answered. */
async function refreshVisit(info, signal) {
  const {scene, job} = info.you;
  const [scenes, jobs] = await Promise.all(
      [scene ? [await api.scene(scene, signal)] : [], job ? [await api.job(job, signal)] : []]);
  Object.assign(state, {info, scenes, jobs, datasets: [], loaded: true});
  changed();
}

/** Reads all lists again. */
export async function refresh(signal) {
  if (!state.info || isVisitor()) {
    const info = await api.info(signal);
    state.info = info;
    if (isVisitor()) return refreshVisit(info, signal);
  }
  const [info, datasets, scenes, jobs] = await Promise.all(
      [api.info(signal), api.datasets(signal), api.scenes(signal), api.jobs(signal)]);
  Object.assign(state, {info, loaded: true});
  state.datasets = datasets.sort(newestFirst);
  state.scenes = scenes.sort(newestFirst);
  const over = new Map(state.jobs.filter(isOver).map((job) => [job.id, job]));
  state.jobs = jobs.map((job) => (isOver(job) ? job : over.get(job.id) ?? job)).sort(newestFirst);
  changed();
}

let soon = 0;
export function refreshSoon() {
  clearTimeout(soon);
  soon = setTimeout(() => refresh().catch(() => {}), 120);
}

function take(type, data) {
  if (type === 'state')
    putJob(data.job && typeof data.job === 'object' ? data.job : data);
  else if (type === 'progress')
    putProgress(data.job ?? data.id, data.progress ?? data);
}

let wake = () => {};
/** Tries to reach the daemon now instead of at the end of the wait. */
export const retryNow = () => wake();

function setConnection(values) {
  Object.assign(state.connection, values);
  changed();
}

async function waitToRetry(failures) {
  const wait = [1000, 2000, 4000, 8000][Math.min(failures, 3)];
  const own = new AbortController();
  wake = () => own.abort();
  setConnection({status: 'offline', retryAt: Date.now() + wait});
  await sleep(wait, own.signal);
}

const VISIT_MS = 5000;

/** As isVisitor, once the daemon has told who looks. */
export async function isVisit(signal) {
  state.info ??= await api.info(signal);
  return isVisitor();
}

/** A visitor has no stream of events: what the link shows is read now and then. */
async function visit(signal) {
  while (!signal.aborted) {
    await refresh(signal);
    setConnection({status: 'online', problem: null});
    await sleep(VISIT_MS, signal);
  }
}

/** Follows the daemon for as long as the page lives; a hidden page lets its connection go. */
export async function startSync() {
  let failures = 0;
  let lastId = '';
  hooks.unreachable = () => {
    if (state.connection.status === 'online') current?.abort();
  };
  let current = null;
  document.addEventListener(
      'visibilitychange', () => (document.hidden ? current?.abort() : wake()));
  for (;;) {
    while (document.hidden)
      await new Promise((resolve) => {
        wake = resolve;
      });
    current = new AbortController();
    try {
      if (await isVisit(current.signal)) {
        failures = 0;
        await visit(current.signal);
        continue;
      }
      await readEvents((headers, signal) => api.stream('v1/events', headers, signal), {
        lastId,
        signal: current.signal,
        onEvent: (type, data, id) => {
          lastId = id || lastId;
          take(type, data);
        },
        onOpen: () => refresh(current.signal)
                          .then(
                              () => {
                                failures = 0;
                                setConnection({status: 'online', problem: null});
                              },
                              () => current.abort()),
      });
    } catch (error) { state.connection.problem = error instanceof Problem ? error : null; }
    if (document.hidden) continue;
    await waitToRetry(failures++);
  }
}

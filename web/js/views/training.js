// The training of a scene: state, controls, PSNR over seconds, rates and clocks.
import {api} from '../api.js';
import {drawChart} from '../chart.js';
import {fill, follow as keyed, h, text} from '../dom.js';
import {followJob} from '../follow.js';
import {isActive, may, trainingOf, find, state, watch} from '../store.js';
import {compact, decibel, fixed, seconds, whole} from '../format.js';
import {
  announce,
  chip,
  facts,
  meter,
  panel,
  progressWords,
  recordedProblem,
  setChip,
  toast
} from '../ui.js';
import {jobButtons} from './jobs.js';
import {go, link} from '../router.js';

const ANNOUNCE_MS = 15_000;

/** The figure, and its step where that is long ago: withheld photographs are trained on since. */
function heldOut(p) {
  const old = p.psnr !== null && 3 * p.psnr_step < 2 * p.step;
  return decibel(p.psnr) + (old ? ` at step ${whole(p.psnr_step)}` : '');
}

/** Not known of a scene whose training was elsewhere. */
const rate = (x) => (Number.isFinite(x) ? `${compact(x)}/s` : '–');

/** Figures worth a place of their own. */
const STATS = [
  ['PSNR, held out', heldOut],
  ['Step', (p) => whole(p.step)],
  ['Trained', (p) => seconds(p.train_seconds)],
  ['Rays', (p) => rate(p.rays_per_second)],
  ['Samples', (p) => rate(p.samples_per_second)],
  ['Loss', (p) => (p.loss === null ? '–' : Number(p.loss.toPrecision(3)).toString())],
];

/** What a finished job's record gives in place of live progress. */
function finalFigures(scene, job, last) {
  const p = job?.progress?.stage ? null : job?.progress;
  const r = job?.result;
  return {
    loss: null,
    rays_per_second: NaN,
    samples_per_second: NaN,
    ...p,
    psnr: r?.psnr ?? last?.y ?? p?.psnr ?? scene.psnr,
    psnr_step: r?.psnr_step ?? last?.step ?? p?.psnr_step,
    step: r?.steps ?? Math.max(p?.step ?? 0, scene.steps),
    train_seconds: r?.train_seconds ?? Math.max(p?.train_seconds ?? 0, scene.train_seconds)
  };
}

/**
 * @param {string} sceneId @param {AbortSignal} signal
 * @param {{seconds: number|null, show: (seconds: number) => void, changed: () => void}} [past] what
 *     is looked back at, where there is a view; `changed` is set here. Else marks lead to one
 */
export function trainingPanel(sceneId, signal, past) {
  const mark = chip('new');
  const buttons = jobButtons(false);
  const bar = meter('Training');
  const chart = h('div', {class: 'chart-box'});
  const stats = STATS.map(([label]) => ({label, value: h('dd', null, '–')}));
  const trouble = h('div');
  const again = h('a', {class: 'button', hidden: true}, 'Train again');
  const stable = h('p', {class: 'stable'});
  const clocks = h('div');
  const levels = h('div');
  const rivals = createRivals(sceneId, () => update(), signal);
  const kept = h('p', {class: 'quiet', hidden: true}, '◇ leads to the scene as it was then.');
  let points = [];
  let marks = [];
  let followed = null;
  let shownProblem = null;
  let said = 0;

  function follow(job) {
    if (!job || followed === job.id) return;
    followed = job.id;
    points = [];
    const load = curve(job.id, signal, async (figures) => {
      points = figures;
      marks = (await api.scene(sceneId, signal)).marks;
      update();
    });
    followJob(job.id, (type) => (type === 'metric' || type === 'state') && load(), signal);
  }

  function update() {
    const scene = find(state.scenes, sceneId);
    if (!scene) return;
    const job = trainingOf(scene);
    follow(job);
    const figures = finalFigures(scene, job, points.at(-1));
    const active = isActive(job);
    setChip(
        mark,
        job && (active || job.state === 'failed' || job.state === 'cancelled') ? job.state :
                                                                                 scene.state);
    if (job) {
      buttons.update(job);
      bar.set(
          active ? job.progress?.fraction ?? (job.state === 'running' ? null : 0) : 1,
          active ? underWay(job) : ended(job, figures));
    }
    STATS.forEach(([, read], i) => text(stats[i].value, read(figures)));
    drawChart(chart, chartPoints(points, figures), {
      limitX: active ? figures.max_seconds : 0,
      running: active,
      now: figures.train_seconds,
      others: rivals.shown(),
      past: {
        marks: may('render') ? marks : [],
        at: past?.seconds ?? null,
        look: (seconds) => look(scene, seconds)
      }
    });
    kept.hidden = !marks.length || !points.length || !may('render');
    const isBare = !active && !points.length && !figures.step;  // it ended before there was anything to tell
    for (const part of [chart, figuresBox, stable, details]) part.hidden = isBare;
    bar.node.hidden = job?.state === 'failed';
    rivals.offer(scene);
    showProblem(job, scene);
    offerAgain(job, scene);
    showMore(figures);
    if (active && figures.psnr && performance.now() - said > ANNOUNCE_MS) {
      said = performance.now();
      announce(`${scene.name}: ${figures.psnr.toFixed(1)} decibel after ${
          Math.round(figures.train_seconds)} seconds`);
    }
  }

  function look(scene, seconds) {
    if (past)
      past.show(seconds);
    else
      go(link.scene(scene.name, `?at=${seconds}`));
  }

  /** The form with the same settings, to be changed: a scene itself is not trained further. */
  function offerAgain(job, scene) {
    again.hidden = !may('train') || !find(state.datasets, scene.dataset) ||
        Boolean(scene.viewing) || (job ? isActive(job) : scene.state !== 'ready');
    again.setAttribute(
        'href', link.dataset(scene.dataset_name, `?like=${encodeURIComponent(scene.name)}`));
  }

  function showProblem(job, scene) {
    const problem = job?.problem ?? null;
    if (JSON.stringify(problem) === shownProblem) return;
    shownProblem = JSON.stringify(problem);
    fill(trouble, problem ? recordedProblem(problem) : null);
  }

  function showMore(p) {
    if (!p.nonfinite) return;
    const {rays, steps_rejected: steps, rollbacks} = p.nonfinite;
    stable.dataset.bad = String(rays + steps + rollbacks > 0);
    text(
        stable,
        `Non-finite: ${whole(rays)} rays, ${whole(steps)} steps rejected, ${
            whole(rollbacks)} rollbacks`);
    fill(clocks, facts([
           ['Loading', seconds(p.load_seconds)], ['Evaluating', seconds(p.evaluate_seconds)],
           ['Paused', seconds(p.paused_seconds)], ['Given to renders', seconds(p.yielded_seconds)],
           ['Samples in all', compact(p.samples)]
         ]));
    fill(levels, levelBars(p.level_samples ?? []));
  }

  const figuresBox = h(
      'dl', {class: 'stats'},
      stats.map(({label, value}) => h('div', null, h('dt', null, label), value)));
  const details = h('details', null, h('summary', null, 'Clocks and levels'), clocks, levels);
  const observer = new ResizeObserver(() => update());
  observer.observe(chart);
  signal.addEventListener('abort', () => observer.disconnect(), {once: true});
  watch(update, signal);
  if (past) past.changed = update;
  return panel(
      'Training', {tools: mark}, trouble, buttons.node, bar.node, chart, kept, rivals.node,
      figuresBox, stable, details, h('div', {class: 'row'}, again));
}

/**
 * The recorded figures of a job, read again whenever there is news: events are forgotten some day
 * and what a restart has undone is not taken back in them. @returns {() => Promise<void>}
 */
function curve(id, signal, show) {
  let loading = false;
  let again = false;
  return async () => {
    again = true;
    if (loading) return;
    loading = true;
    while (again && !signal.aborted) {
      again = false;
      try {
        const figures = await api.metrics(id, signal);
        await show(pointsOf(figures));
      } catch { /* the next event asks again */
      }
    }
    loading = false;
  };
}

const MOST_RIVALS = 4;  // as many as the chart has colours

/** Other trainings on the same photographs, whose curves are drawn behind this one's. */
function createRivals(sceneId, changed, signal) {
  const boxes = h('div', {class: 'rivals'});
  const node = h(
      'details', {hidden: true}, h('summary', null, 'Beside other trainings'), boxes);
  const chosen = new Map();  // a scene's id -> its name and points
  async function choose(other, box) {
    if (!box.checked) {
      chosen.delete(other.id);
    } else if (chosen.size === MOST_RIVALS) {
      box.checked = false;
      toast(`${MOST_RIVALS} others fit on the chart: take one of them off first.`);
      return;
    } else {
      chosen.set(other.id, {name: other.name, points: []});
      const figures = await api.metrics(other.job, signal).catch(() => []);
      const points = pointsOf(figures);
      if (chosen.has(other.id)) chosen.get(other.id).points = points;
      if (!points.length) toast(`Of ${other.name} no figures are kept that could be drawn.`);
    }
    paint();
    changed();
  }
  function paint() {
    const order = [...chosen.keys()];
    for (const row of boxes.children) {
      const at = order.indexOf(row.dataset.scene);
      row.querySelector('.swatch').className = `swatch${at < 0 ? '' : ` other-${at}`}`;
    }
  }
  const rowOf = (other) => {
    const id = `rival-of-${other.id}`;
    const box = h('input', {type: 'checkbox', id, onchange: () => choose(other, box)});
    const words = h('span', {class: 'quiet'});
    return {
      node: h('div', {'data-scene': other.id}, box, h('label', {'for': id}, other.name), words,
              h('span', {class: 'swatch', 'aria-hidden': 'true'})),
      update: (now) => text(words, `${decibel(now.psnr)} after ${seconds(now.train_seconds)}`)
    };
  };
  return {
    node,
    offer: (scene) => {
      const others = state.scenes.filter(
          (other) => other.id !== sceneId && other.dataset === scene.dataset && other.job &&
              other.steps > 0);
      node.hidden = !others.length;
      keyed(boxes, others, (other) => other.id, rowOf);
    },
    shown: () => [...chosen.values()].filter((other) => other.points.length)
  };
}

const pointsOf = (figures) => figures.filter((m) => m.psnr !== null)
                                  .map((m) => ({x: m.train_seconds, y: m.psnr, step: m.step}));

/** How far towards the limits; the figures below say the rest. */
function underWay(job) {
  const p = job.progress;
  if (!p || p.stage || p.evaluating_first || p.evaluating)
    return progressWords(job) || (job.state === 'running' ? 'loading photographs' : '');
  const limits = [
    p.max_seconds ? `${seconds(p.train_seconds)} of ${seconds(p.max_seconds)}` : '',
    p.max_steps ? `step ${whole(p.step)} of ${whole(p.max_steps)}` : ''
  ].filter(Boolean);
  const left = job.state === 'running' && p.eta_seconds ? `${seconds(p.eta_seconds)} left` : '';
  const again = job.attempt > 1 ? `attempt ${job.attempt}` : '';
  return [...(limits.length ? limits : ['until it is finished']), left, again].filter(Boolean).join(
      ' · ');
}

function ended(job, figures) {
  const why = {
    time: 'time is up',
    steps: 'steps done',
    psnr: 'PSNR reached',
    finish: 'finished by hand',
    plateau: 'no more was gained'
  }[job.result?.finished_by];
  return `${job.state}${why ? `: ${why}` : ''} · ${whole(figures.step)} steps in ${
      seconds(figures.train_seconds)}`;
}

/** The recorded points; the last known figure where none are held any more. */
function chartPoints(points, figures) {
  if (points.length || !figures.psnr || !figures.train_seconds) return points;
  return [{x: figures.train_seconds, y: figures.psnr, step: figures.step}];
}

function levelBars(samples) {
  const all = samples.reduce((sum, x) => sum + x, 0);
  if (!all) return null;
  return h(
      'div', {class: 'levels'}, h('h3', null, 'Samples by ripmap level'),
      samples.map((count, level) => {
        const bar = h('progress', {max: 1, value: count / all, 'aria-label': `level ${level}`});
        return h(
            'div', null, h('span', null, level), bar,
            h('span', {class: 'number'}, `${fixed((100 * count) / all, 1)} %`));
      }));
}

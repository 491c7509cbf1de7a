// One scene: look at it while it trains, record a path, see how it does.
import {api, Unreachable} from '../api.js';
import {every, fill, follow, h} from '../dom.js';
import {find, isActive, isVisitor, may, means, state, trainingOf, watch} from '../store.js';
import {chip, empty, panel, problemBox, setChip, skeleton} from '../ui.js';
import {link} from '../router.js';
import {createCurve} from './curve.js';
import {createKeys} from './keys.js';
import {createViewport} from './viewport.js';
import {trainingPanel} from './training.js';
import {createEffects} from './effects.js';
import {aboutPanel, differencesPanel, qualityPanel} from './record.js';
import {jobRow} from './jobs.js';
import {stabilityPanel} from './stability.js';

const RECORD_MS = 4000;  // how often the record is read again while the scene trains

export async function sceneView(root, {id, query, signal}) {
  const mark = chip('loading');
  const title = h('h1', null, id);
  const from = h('span', {class: 'quiet'});
  const body =
      h('div', null,
        h('div', {class: 'columns wide'},
          h('div', {class: 'main-column'},
            h('div', {class: 'stage'},
              h('p', {class: 'cover-note', role: 'status'},
                h('span', {class: 'spinner', 'aria-hidden': 'true'}), 'Loading the scene'))),
          h('div', {class: 'side-column'}, panel('Training', null, skeleton(4)))));
  fill(
      root,
      h('div', {class: 'page-head'}, h('a', {class: 'back', href: link.home()}, 'Scenes'),
        title, mark, from),
      body);
  let shown = new AbortController();
  signal.addEventListener('abort', () => shown.abort(), {once: true});
  const load = async () => {
    try {
      const scene = await api.scene(id, signal);
      await listed(scene.id, signal);
      const cameras =
          isVisitor() || !scene.dataset ?
          [] :
          await api.cameras(scene.dataset, signal).catch(() => []);
      if (signal.aborted) return;
      if (isVisitor()) {
        setChip(mark, scene.state);
        fill(title, scene.name);
        const start = await api.start(scene.id, signal).catch(() => null);
        if (signal.aborted) return;
        fill(body, visitedScene(scene, start, query, signal));
        return;
      }
      fill(
          from,
          scene.dataset ?
              ['from ', h('a', {href: link.dataset(scene.dataset_name)}, scene.dataset_name)] :
              'for viewing; its photographs are not here');
      const start = scene.dataset ? null : scene.viewing?.start;
      shown.abort();
      shown = new AbortController();
      fill(body, page(scene, cameras, start, mark, query, shown.signal));
      whenBarrenChanges(scene, load, shown.signal);
    } catch (error) {
      if (signal.aborted) return;
      if (!(error instanceof Unreachable)) setChip(mark, 'error');
      fill(body, problemBox(error, {again: load}));
    }
  };
  await load();
}

/**
 * What a link shows: the scene at any camera, as who shared it saw it at first, else from where a
 * photograph was taken; `start` is null where that is not known.
 */
function visitedScene(scene, start, query, signal) {
  const training = () => find(state.scenes, scene.id)?.state === 'training';
  const failed = () => find(state.scenes, scene.id)?.state === 'failed';
  const view = createViewport(
      scene, [], {
        live: training,
        failed,
        onRefined: () => {},
        start: start?.camera,
        up: start?.up,
        camera: query?.get('camera'),
        crop: query?.get('crop'),
        at: Number(query?.get('at')) || null,
        onNow: () => {
          view.at = null;
        }
      },
      signal);
  return view.node;
}

/** Its training is over and left nothing: there is no picture, and there will be none. */
function isBarren(scene) {
  const job = trainingOf(scene);
  return !scene.viewing && !scene.steps && !isActive(job) &&
      (scene.state === 'failed' || scene.state === 'new' && job?.state === 'cancelled');
}

function whenBarrenChanges(scene, load, signal) {
  const was = isBarren(scene);
  let told = false;
  watch(() => {
    const now = find(state.scenes, scene.id);
    if (told || !now || isBarren(now) === was) return;
    told = true;
    load();
  }, signal);
}

/** In the place of all that looks at a scene, where there is nothing to look at. */
const barrenPage = (scene, signal) => h(
    'div', {class: 'columns wide'},
    h('div', {class: 'main-column'},
      empty(
          'No picture',
          h('p', null, 'Training ended without a checkpoint: there is nothing to look at or to measure. '),
          may('train') ?
              h('p', null, h('strong', null, 'Train again'),
                ' opens the form with the same settings, to be changed.') :
              null)),
    h('div', {class: 'side-column'}, trainingPanel(scene.id, signal), aboutPanel(scene)));

/** Resolves once the store's lists are there and hold the scene. */
function listed(id, signal) {
  return new Promise((resolve) => {
    const stop = new AbortController();
    signal.addEventListener('abort', () => {
      stop.abort();
      resolve();
    }, {once: true});
    watch(({loaded, scenes}) => {
      if (loaded && find(scenes, id)) {
        stop.abort();
        resolve();
      }
    }, stop.signal);
  });
}

/** `start`: where to begin, of a scene whose photographs are not here; its file may not tell. */
function page(scene, cameras, start, mark, query, signal) {
  watch(() => {
    const now = find(state.scenes, scene.id);
    if (now) setChip(mark, now.state);
  }, signal);
  if (isBarren(scene)) return barrenPage(scene, signal);
  const dataset = find(state.datasets, scene.dataset);
  const training = () => isActive(trainingOf(find(state.scenes, scene.id) ?? scene));
  let keys = {};
  const past = {
    seconds: Number(query?.get('at')) || null,
    changed: () => {},
    show: (seconds) => {
      past.seconds = seconds;
      view.at = seconds;
      past.changed();
    }
  };
  const cost = createCurve(
      scene, {
        choose: (ms) => {
          view.budgetMs = ms;
        },
        known: (curve) => {
          keys.curve = curve;
        },
        besideFull: () => view.besideFull()
      },
      signal);
  const view = !may('render') ?
      unseen() :
      createViewport(
          scene, cameras, {
            live: training,
            failed: () => find(state.scenes, scene.id)?.state === 'failed',
            onKey: () => keys.record(),
            onTake: () => keys.take(),
            onMoved: () => keys.leave?.(),
            onPick: (id) => keys.choose(id),
            onRefined: (facts) => cost.picture(facts),
            camera: query?.get('camera'),
            crop: query?.get('crop'),
            at: past.seconds,
            onNow: () => past.show(null),
            start: start?.camera,
            up: dataset?.up ?? start?.up
          },
          signal);
  if (may('render'))
    keys = createKeys(
        scene, {width: dataset?.width ?? 400, height: dataset?.height ?? 400}, view, signal);
  const [split, index] = (query?.get('view') ?? '').split(':');
  if (split && may('render')) queueMicrotask(() => view.compare(split, Number(index)));
  const record = h('div', {class: 'stack', 'data-order': 4});
  const more = h('div', {class: 'stack', 'data-order': 3});
  keepRecord(scene, {record, more}, training, view, signal);
  return h(
      'div', {class: 'columns wide'}, h('div', {class: 'main-column'}, view.node, keys.node, more),
      h('div', {class: 'side-column'}, trainingPanel(scene.id, signal, past), cost.node, pathsPanel(scene, signal),
        qualityPanel(scene, view.compare, signal), stabilityPanel(scene, signal), record));
}

/** In the view's place for a token that only reads. */
const unseen = () => ({
  node: empty(
      'No pictures',
      h('p', null, 'Your token only reads. To look around and to render paths it needs the scope ',
        h('code', null, 'render'), '.')),
  refresh: () => {}
});

/** Effects, differences and facts, read again while they can change. */
function keepRecord(scene, {record, more}, training, view, signal) {
  let shown = '';
  let before = null;
  const effects = createEffects(scene, signal);
  let differences = null;  // its panel, which stays as long as they do: somebody may have unfolded it
  let told = '';
  const show = (now) => {
    if (told !== JSON.stringify(now.differences)) differences = differencesPanel(now);
    told = JSON.stringify(now.differences);
    const key = JSON.stringify(
        [now.effects, now.differences, now.checkpoints, now.config, now.loaded, now.memory_bytes]);
    if (key === shown) return;
    shown = key;
    effects.show(now);
    fill(more, effects.node, differences);
    fill(record, aboutPanel(now));
  };
  show(scene);
  const read = () => api.scene(scene.id, signal).then(show, () => {});
  every(RECORD_MS, () => {
    if (training()) read();
  }, signal);
  watch(() => {
    const now = find(state.scenes, scene.id)?.state;
    if (before && now !== before) {
      read();
      view.refresh();
    }
    before = now;
  }, signal);
}

/** Path jobs of this scene, newest first. */
function pathsPanel(scene, signal) {
  const rows = h('div', {class: 'rows'});
  const node = panel('Rendered paths', {class: 'panel', 'data-order': 2, hidden: true}, rows);
  watch(({jobs}) => {
    const own = jobs.filter((job) => job.type === 'path' && means(job.scene, scene)).slice(0, 4);
    node.hidden = !own.length;
    follow(rows, own, (job) => job.id, jobRow);
  }, signal);
  return node;
}

// Scenes, datasets, what runs, and a place to add a dataset.
import {api} from '../api.js';
import {fill, follow, h, lazyImage, sleep, text} from '../dom.js';
import {isActive, isVisitor, may, mayChange, mayRender, refreshSoon, trainingOf, watch} from '../store.js';
import {cameraOf, defaultOrbit, orbitOfCamera} from '../orbit.js';
import {ago, bytes, decibel, plural, seconds, whole} from '../format.js';
import {
  action,
  chip,
  confirmFirst,
  empty,
  meter,
  panel,
  scroller,
  setChip,
  skeleton,
  STANDS_IN_MS
} from '../ui.js';
import {link} from '../router.js';
import {jobRow} from './jobs.js';
import {uploadPanel} from './upload.js';
import {showVisit} from './visit.js';

export function homeView(root, {signal}) {
  const scenes = h('div', {class: 'cards'});
  const sceneBox = h('div');
  const tableBody = h('tbody');
  const datasetBox = h('div');
  const running = h('div', {class: 'rows'});
  const sending = h('div', {class: 'rows'});
  const runningBox = panel('Under way', {class: 'panel', hidden: true}, sending, running);
  const table = scroller(
      'Datasets', null,
      h('table', {class: 'table'},
        h('thead', null,
          h('tr', null,
            ['Dataset', 'Views', 'Size', 'Scales', 'On disk', ''].map(
                (t, i) =>
                    h('th', {
                      scope: 'col',
                      class: ['', '', 'number optional', 'number optional', 'number optional', ''][i]
                    },
                      t || h('span', {class: 'unseen'}, 'Actions'))))),
        tableBody));
  const side = h('div', {class: 'side-column'}, runningBox);
  let adding = null;  // there is one once it is known who looks
  fill(
      root, h('h1', {class: 'unseen'}, 'Scenes and datasets'),
      h('div', {class: 'columns'},
        h('div', {class: 'main-column'}, panel('Scenes', null, sceneBox),
          panel('Datasets', null, datasetBox)),
        // What is under way comes and goes: above the panel it would move what is to be pressed.
        side));

  watch((state) => {
    if (state.loaded && isVisitor()) return showVisit(root, state);
    const active = state.jobs.filter(isActive);
    // Uploads whose form was left: until then that tells of them.
    const left = Object.entries(state.uploads).filter(([, upload]) => upload.signal.aborted);
    runningBox.hidden = !active.length && !left.length;
    follow(sending, left, ([name]) => name, uploadRow);
    follow(running, active, (job) => job.id, jobRow);
    side.toggleAttribute('data-first', state.loaded && !state.datasets.length);
    if (!adding && may('train')) side.prepend(adding = uploadPanel(signal));
    if (!state.loaded) {
      fill(sceneBox, skeleton(3));
      fill(datasetBox, skeleton(2));
      return;
    }
    if (state.scenes.length) {
      if (sceneBox.firstChild !== scenes) fill(sceneBox, scenes);
      follow(scenes, state.scenes, (scene) => scene.id, (scene) => sceneCard(scene, signal));
    } else
      fill(sceneBox, noScenes(state.datasets));
    if (state.datasets.length) {
      if (datasetBox.firstChild !== table) fill(datasetBox, table);
      follow(tableBody, state.datasets, (set) => set.id, datasetRow);
    } else
      fill(datasetBox, empty('No datasets'));
  }, signal);
}

/** An upload of this page that goes on. */
function uploadRow([name, {cancel}]) {
  const bar = meter(`Upload of ${name}`);
  return {
    node: h('div', {class: 'job-row'}, h('div', {class: 'row'}, h('span', null, 'Upload ', h('strong', null, name))),
            bar.node, h('div', {class: 'row'}, action('Cancel', cancel, {kind: 'small'}))),
    update: ([, {share}]) => bar.set(share, `${Math.floor(100 * share)} % sent`)
  };
}

function noScenes(datasets) {
  if (!may('train')) return empty('No scenes yet');
  if (datasets.length) {
    return empty(
        'No scenes yet', h('p', null, 'A scene is trained from a dataset.'),
        h('a', {class: 'button primary', href: link.dataset(datasets[0].name)},
          `Train ${datasets[0].name}`));
  }
  return empty(
      'From photographs to a scene',
      h('ol', {class: 'steps'},
        h('li', null, h('strong', null, 'Add a dataset. '),
          'Choose or drop a folder of photographs.'),
        h('li', null, h('strong', null, 'Train. '),
          'A minute on a few cores is enough for a first look.'),
        h('li', null, h('strong', null, 'Look around. '),
          'Orbit the scene while it trains, record a camera path, render it.')),
      h('p', {class: 'quiet'}, 'No photographs at hand? ',
        h('code', null, 'ripnerf synth sphere FOLDER'), ' makes a small dataset.'));
}

/** Figures of a scene, from its training job while that runs. */
export function liveFigures(scene) {
  const job = trainingOf(scene);
  const p = job && isActive(job) && !job.progress?.stage ? job.progress : null;
  return {
    steps: p?.step ?? scene.steps,
    seconds: p?.train_seconds ?? scene.train_seconds,
    psnr: p?.psnr ?? scene.psnr
  };
}

function sceneCard(scene, signal) {
  const state = chip(scene.state);
  const figures = h('p', {class: 'figures'});
  const name = h('a', {class: 'card-name', href: link.scene(scene.name)}, scene.name);
  const mark = h('span', {class: 'stands-in'});
  const picture =
      lazyImage((stop, show) => sceneThumb(scene, mark, show, stop), {class: 'cover'}, signal);
  const node =
      h('article', {class: 'card'}, picture, mark,
        h('div', {class: 'card-body'}, h('div', {class: 'row'}, name, state), figures,
          h('p', {class: 'quiet'}, `${
                scene.dataset ? `from ${scene.dataset_name}` : 'for viewing'} · ${
                ago(scene.created_at)}`)));
  const update = (now) => {
    setChip(state, now.state);
    const live = liveFigures(now);
    text(
        figures,
        live.steps ? [
          live.psnr && `${decibel(live.psnr)} held out`, seconds(live.seconds),
          `${whole(live.steps)} steps`
        ].filter(Boolean)
                         .join(' · ') :
                     'not trained yet');
  };
  return {node, update};
}

/**
 * A loaded scene is rendered; for others a photograph stands in, so that a list loads no runner, and for
 * those too whose rendering takes long, until it is there; `mark` is told which it is. A view's numbers
 * have gaps where it went to another split.
 */
async function sceneThumb(scene, mark, show, signal) {
  const size = {width: 320, height: 240};
  const rendered = async (of) =>
      (await api.render(scene.id, {...of, format: 'jpeg'}, signal)).blob;
  if (!scene.dataset) {
    if (!scene.loaded || !mayRender()) throw new Error('has no photograph');
    const {bounds, viewing} = scene;
    const start = viewing?.start;
    const orbit = start ? orbitOfCamera(start.camera, start.up, bounds) : defaultOrbit(bounds);
    return rendered({camera: cameraOf(orbit, size.width, size.height)});
  }
  const views = await api.cameras(scene.dataset, signal);
  const {split, index} = views.find((item) => item.split === 'train') ?? views[0];
  const photograph = () => api.photo(scene.dataset, split, index, 0, signal);
  if (scene.loaded && scene.steps > 0 && mayRender()) {
    let there = false;
    const standIn = async () => {
      await sleep(STANDS_IN_MS, signal);
      const blob = there ? null : await photograph();
      if (there) return;
      text(mark, 'photograph');
      show(blob);
    };
    standIn().catch(() => {});
    try {
      const blob = await rendered({view: `${split}:${index}`, size});
      there = true;
      text(mark, '');
      return blob;
    } catch (error) {
      if (signal.aborted) throw error;
    }
  }
  text(mark, 'photograph');
  return photograph();
}

function datasetRow(set) {
  const node = h(
      'tr', null, h('th', {scope: 'row'}, h('a', {href: link.dataset(set.name)}, set.name)),
      h('td', null,
        ['train', 'val', 'test']
            .filter((split) => set.views[split])
            .map(
                (split, i) =>
                    [i ? ', ' : '', h('span', {class: 'whole'}, `${set.views[split]} ${split}`)])),
      h('td', {class: 'number optional'}, `${set.width} × ${set.height}`),
      h('td', {class: 'number optional'}, set.scales),
      h('td', {class: 'number optional'}, bytes(set.size_bytes)),
      h('td', {class: 'actions'},
        may('train') ? h('a', {class: 'button small', href: link.dataset(set.name)}, 'Train…') :
                       null,
        mayChange(set) ? h('button', {
          type: 'button',
          class: 'small bare',
          'aria-label': `Delete dataset ${set.name}`,
          onclick: () => confirmFirst(
              `Delete the dataset ${set.name} with its ${plural(set.frames, 'image')}?`, 'Delete',
              async () => {
                await api.removeDataset(set.id);
                refreshSoon();
              })
        },
                           'Delete') :
                         null));
  return {node};
}

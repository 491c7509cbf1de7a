// One dataset: its photographs, what the import found, its facts, and the way to train it.
import {api} from '../api.js';
import {fill, h, lazyImage} from '../dom.js';
import {find, may, mayChange, refreshSoon, state, watch} from '../store.js';
import {ago, bytes, percent, plural, seconds} from '../format.js';
import {choice, confirmFirst, facts, panel, problemBox, scroller, skeleton} from '../ui.js';
import {go, link} from '../router.js';
import {cloudPanel} from './cloud.js';
import {enlarge} from './enlarge.js';
import {trainPanel} from './train.js';

const FIRST = 24;
const FIRST_ON_PHONE = 6;  // training is to be in sight soon after them

export async function datasetView(root, {id, query, signal}) {
  const title = h('h1', null, id);
  const body = h('div', null, panel('Photographs', null, skeleton(4)));
  fill(
      root,
      h('div', {class: 'page-head'}, h('a', {class: 'back', href: link.home()}, 'Datasets'), title),
      body);
  const load = async () => {
    try {
      const dataset = await api.dataset(id, signal);
      if (!state.loaded)
        await new Promise((ready) => {
          const stop = new AbortController();
          watch((s) => {
            if (s.loaded) {
              stop.abort();
              ready();
            }
          }, stop.signal);
        });
      const [cameras, words, like] = await Promise.all([
        api.cameras(dataset.id, signal), api.formats(signal), trainingLike(query?.get('like'), signal)
      ]);
      if (signal.aborted) return;
      fill(body, page(dataset, cameras, words, like, signal));
      if (like) document.getElementById('train')?.scrollIntoView();
    } catch (error) {
      if (!signal.aborted) fill(body, problemBox(error, {again: load}));
    }
  };
  await load();
}

/** A scene and the job that trained it, whose settings are asked for once more; null: none. */
async function trainingLike(name, signal) {
  const scene = name ? find(state.scenes, name) : null;
  const job = scene?.job ? await api.job(scene.job, signal).catch(() => null) : null;
  return job?.type === 'train' ? {scene, job} : null;
}

function page(dataset, cameras, words, like, signal) {
  return h(
      'div', {class: 'columns'},
      h('div', {class: 'main-column'}, photographs(dataset, cameras, signal),
        cloudPanel(dataset, cameras, signal), report(dataset.report)),
      h('div', {class: 'side-column'}, may('train') ? trainPanel(dataset, like) : null,
        about(dataset, words), scenesOf(dataset, signal)));
}

/** The views by their numbers in the JSON: one that is unusable leaves a gap. Enlarged, they tell their names. */
function photographs(dataset, cameras, signal) {
  const viewsOf = (split) => cameras.filter((item) => item.split === split && item.scale === 0);
  const splits = ['train', 'val', 'test'].filter((split) => dataset.views[split]);
  const pick = choice(
      'Split', splits.map((split) => [split, `${split} ${dataset.views[split]}`]), splits[0]);
  const grid = h('div', {class: 'photos'});
  const more = h('div', {class: 'row'});
  const scale = Math.max(
      0,
      Math.min(
          dataset.scales - 1,
          Math.floor(Math.log2(Math.max(dataset.width, dataset.height) / 160))));
  const photo = (split, every) => ({index, name}, at) =>
      h('figure', {title: name},
        h('button', {
          type: 'button',
          class: 'photo',
          'aria-label': `Enlarge ${split} view ${index}`,
          onclick: () => enlarge({
            count: every.length,
            at,
            words: (i) => `${split}:${every[i].index} · ${every[i].name}`,
            picture: (i, stop) => api.photo(dataset.id, split, every[i].index, 0, stop)
          }, signal)
        },
          lazyImage(
              (stop) => api.photo(dataset.id, split, index, scale, stop),
              {alt: `${split} view ${index}`}, signal)),
        h('figcaption', null, `${split}:${index}`));
  const show = (all) => {
    const split = pick.control.value;
    const every = viewsOf(split);
    const few = matchMedia('(max-width: 700px)').matches ? FIRST_ON_PHONE : FIRST;
    const shown = all ? every : every.slice(0, few);
    fill(grid, shown.map(photo(split, every)));
    fill(
        more,
        shown.length < every.length ?
            h('button', {type: 'button', onclick: () => show(true)}, `Show all ${every.length}`) :
            null);
  };
  pick.control.onChange(() => show(false));
  show(false);
  return panel('Photographs', {tools: pick.node}, grid, more);
}

/** What reading a dataset found: what may be wrong with it, and below, folded or `open`, what else was measured. */
export function report(found, open = false) {
  const words = [plural(found.errors, 'error'), plural(found.warnings, 'warning')].join(', ');
  const row = (item) =>
      h('tr', {'data-severity': item.severity}, h('td', null, item.severity),
        h('td', null, h('code', null, item.where)), h('td', null, item.text));
  const clean = h('p', {class: 'good'}, 'Nothing to complain about: every image is usable.');
  const head = h('tr', null, ['Kind', 'Where', 'What'].map((t) => h('th', {scope: 'col'}, t)));
  const more = found.dropped ? `; ${found.dropped} more not listed` : '';
  const list = (label, items, caption) => scroller(
      label, null,
      h('table', {class: 'table problems'}, h('caption', null, caption), h('thead', null, head.cloneNode(true)),
        h('tbody', null, items.map(row))));
  const notes = found.problems.filter((item) => item.severity === 'info');
  const faults = ['error', 'warning'].flatMap(
      (severity) => found.problems.filter((item) => item.severity === severity));
  return panel(
      'What the import found', null, faults.length ? list('Errors and warnings', faults, words + more) : clean,
      notes.length ?
          h('details', {open}, h('summary', null, plural(notes.length, 'note')),
            list('Notes', notes, 'In brackets the limits that numbers are held against')) :
          null);
}

const three = (numbers) => numbers.map((x) => Number(x.toPrecision(4))).join(', ');
const range = ({min, max}) => [...new Set([min.toPrecision(3), max.toPrecision(3)])].join(' to ');

/** What a training with `standard` takes: by formula, and by those that have ended here. */
export function expected(formula, past) {
  const takes = (x) => [seconds(x.seconds), `${bytes(x.memory_bytes)} of memory`].join(', ');
  return [
    ...(formula ? [['Training, estimated', takes(formula)]] : []),
    ...(past ?
            [[`Training, by ${plural(past.trainings, 'training')} here`, takes(past)]] :
            [])
  ];
}

/** What the daemon calls one of its names. */
const titleOf = (items, name) => items.find((item) => item.name === name)?.title ?? name;

function about(dataset, words) {
  const {views, report: found} = dataset;
  return panel(
      'About', {
        tools: mayChange(dataset) ? h('button', {
          type: 'button',
          class: 'small bare',
          onclick: () => confirmFirst(
              `Delete the dataset ${dataset.name}?`, 'Delete',
              async () => {
                await api.removeDataset(dataset.id);
                refreshSoon();
                go(link.home());
              })
        },
                                      'Delete') :
                                    null
      },
      facts([
        ['Views', `${views.train} train, ${views.val} val, ${views.test} test`],
        ['Unusable', `${found.unusable.train + found.unusable.val + found.unusable.test}`],
        ['Largest image', `${dataset.width} × ${dataset.height} px`],
        [
          'Scales',
          `${dataset.scales}${
              dataset.scales > 1 ?
                  dataset.premultiplied ? ', premultiplied alpha' : ', as the benchmark' :
                  ''}`
        ],
        ['Alpha', dataset.has_alpha ? 'yes' : 'no'],
        [
          'Bounds',
          `radius ${Number(dataset.bounds.radius.toPrecision(4))} about (${
              three(dataset.bounds.centre)}), ${titleOf(words.bounds, dataset.bounds.source)}`
        ],
        ...(dataset.capture ? [[
          'Capture', `${titleOf(words.captures, dataset.capture)}; up is ${
            three(dataset.up.map((x) => Number(x.toFixed(3))))}`
        ]] :
                              []),
        ...(dataset.crop ? [['Crop', three(dataset.crop)]] : []),
        ['Pixel’s footprint', `${range(dataset.footprint)} of the dataset’s units`],
        ['Looking at the bounds', percent(found.looking_at_bounds)], ['Layout', found.layout],
        ...expected(found.expected, dataset.past), ['On disk', bytes(dataset.size_bytes)],
        ['Imported', ago(dataset.created_at)]
      ]));
}

function scenesOf(dataset, signal) {
  const list = h('div');
  watch(({scenes}) => {
    const own = scenes.filter((scene) => scene.dataset === dataset.id);
    fill(
        list,
        own.length ? h('ul', {class: 'links'},
                       own.map(
                           (scene) =>
                               h('li', null, h('a', {href: link.scene(scene.name)}, scene.name),
                                 ` ${scene.state}`))) :
                     h('p', {class: 'quiet'}, 'None is trained from it yet.'));
  }, signal);
  return panel('Scenes', null, list);
}

// A scene's report: one HTML file that holds all it shows, has no script and prints well.
import {api} from './api.js';
import {drawChart} from './chart.js';
import {differenceOf} from './difference.js';
import {h} from './dom.js';
import {bytes, decibel, fixed, milliseconds, plural, seconds, whole} from './format.js';
import {conditionWords, effectTitle} from './views/effects.js';
import {drawCost} from './views/curve.js';

const PICTURE_SIDE = 400;  // pixels, of the longer side
const VIEWS = 3;           // worst, middle and best

// Of an image's address: the page itself may load none such (its Content-Security-Policy), nor have a
// style of its own; the report's text has both.
const SRC = 'data-src';

const STYLE = `
@page { margin: 16mm; }
* { box-sizing: border-box; }
body { max-width: 860px; margin: 24px auto; padding: 0 16px; color: #171c22; background: #fff;
  font: 14px/1.45 system-ui, sans-serif; font-variant-numeric: tabular-nums; }
h1 { font-size: 24px; margin: 0; } h2 { font-size: 16px; margin: 28px 0 8px; break-after: avoid; }
p { margin: 4px 0; } .quiet { color: #59636f; }
table { border-collapse: collapse; width: 100%; margin: 6px 0; }
th, td { text-align: left; vertical-align: top; padding: 4px 10px 4px 0; border-bottom: 1px solid #dfe3e8; }
th { font-weight: 600; } tr, figure { break-inside: avoid; }
td.number, th.number { text-align: right; white-space: nowrap; }
td.told, th.told { text-align: right; } th.why { width: 45%; }
figure { margin: 10px 0; } figcaption { font-size: 12px; color: #59636f; }
.trio { display: grid; grid-template-columns: repeat(3, 1fr); gap: 8px; }
.trio img { width: 100%; display: block; }
.head { width: 100%; max-height: 420px; object-fit: contain; }
.chart { max-width: 100%; height: auto; }
@media screen { section[tabindex] { overflow-x: auto; } }
.chart text { fill: #59636f; font: 11px system-ui, sans-serif; }
.chart .grid { stroke: #dfe3e8; } .chart .axis { stroke: #c3cad3; }
.chart .line { fill: none; stroke: #1668b8; stroke-width: 2; }
.chart .dot, .chart .last { fill: #1668b8; } .chart .probe, .chart .moment { display: none; }
code { font: .92em ui-monospace, monospace; overflow-wrap: anywhere; }
`;

const inlined = (blob) => new Promise((done, fail) => {
  const reader = new FileReader();
  reader.onload = () => done(reader.result);
  reader.onerror = () => fail(reader.error);
  reader.readAsDataURL(blob);
});

const table = (head, rows) =>
    h('table', null,
      h('thead', null,
        h('tr', null, head.map(([words, kind]) => h('th', {scope: 'col', class: kind}, words)))),
      h('tbody', null,
        rows.map(
            (cells) => h('tr', null, cells.map((cell, i) => h('td', {class: head[i][1]}, cell))))));

const factsTable = (rows) => h(
    'table', null,
    h('tbody', null,
      rows.map(
          ([name, value]) => h('tr', null, h('th', {scope: 'row'}, name), h('td', null, value)))));

const section = (title, ...content) => {
  const kept = content.flat().filter(Boolean);
  if (!kept.length) return null;
  const node = h('section', null, h('h2', null, title), kept);
  if (node.querySelector('table')) {  // on a phone it is scrolled, also by the keyboard
    node.tabIndex = 0;
    node.setAttribute('aria-label', title);
  }
  return node;
};

/** A photograph's pixels over the background, at a size. */
async function pixelsOf(blob, {width, height}, background) {
  const picture = await createImageBitmap(blob);
  const context = new OffscreenCanvas(width, height).getContext('2d', {willReadFrequently: true});
  context.fillStyle = `rgb(${background.map((x) => Math.round(255 * x)).join(' ')})`;
  context.fillRect(0, 0, width, height);
  context.imageSmoothingQuality = 'high';
  context.drawImage(picture, 0, 0, width, height);
  picture.close();
  return context.getImageData(0, 0, width, height);
}

async function jpegOf(pixels) {
  const room = new OffscreenCanvas(pixels.width, pixels.height);
  room.getContext('2d').putImageData(pixels, 0, 0);
  return inlined(await room.convertToBlob({type: 'image/jpeg', quality: 0.9}));
}

/** Photograph, rendering and error of a view. */
async function comparison(scene, item, words, signal) {
  const {width, height} = item.camera;
  const k = Math.min(1, PICTURE_SIDE / Math.max(width, height));
  const size = {
    width: Math.max(1, Math.round(width * k)),
    height: Math.max(1, Math.round(height * k))
  };
  const view = `${item.split}:${item.index}`;
  const background = scene.config?.background ?? [1, 1, 1];
  const [photo, render] = await Promise.all([
    api.photo(scene.dataset, item.split, item.index, item.scale, signal),
    api.render(scene.id, {view, size, lens: 'as-taken', format: 'png'}, signal)
  ]);
  const pair =
      [await pixelsOf(photo, size, background), await pixelsOf(render.blob, size, background)];
  const {pixels, psnr} = differenceOf(pair[0].data, pair[1].data, 'error');
  const error = new ImageData(pixels, size.width, size.height);
  const shown = await Promise.all([...pair, error].map(jpegOf));
  return h(
      'figure', null,
      h('div', {class: 'trio'},
        shown.map(
            (src, i) => h(
                'img',
                {[SRC]: src, alt: `${['Photograph', 'Rendering', 'Error'][i]} of ${view}`}))),
      h('figcaption', null,
        `${words}${view}: photograph, rendering, error (white at a quarter of the range). ${
            psnr === null ? 'Equal' : decibel(psnr)} at ${size.width} × ${size.height}.`));
}

/**
 * The worst, the middle and the best view of the newest evaluation; else the first that it was not trained on, or, where
 * there are none, that it was.
 */
function viewsToShow(cameras, evaluation) {
  const full = cameras.filter((item) => item.scale === 0);
  const split = evaluation?.result.protocol.split;
  const scored = (evaluation?.result.per_view ?? [])
                     .filter((view) => view.scale === 0 && view.psnr !== null)
                     .sort((a, b) => a.psnr - b.psnr);
  if (!scored.length) {
    const first = ['test', 'val', 'train'].find((name) => full.some((item) => item.split === name));
    return full.filter((item) => item.split === first).slice(0, VIEWS).map((item) => [item, '']);
  }
  const picks = [['Worst, ', 0], ['Middle, ', scored.length >> 1], ['Best, ', scored.length - 1]];
  return picks.filter(([, at], i) => picks.findIndex(([, other]) => other === at) === i)
      .map(
          ([words, at]) =>
              [full.find((item) => item.split === split && item.index === scored[at].index), words])
      .filter(([item]) => item);
}

/** Of an ISO time, without its seconds. */
const minutes = (time) => time.slice(0, 16).replace('T', ' ');

const evaluationTable = (evaluations) =>
    table(
        [
          ['Views'], ['PSNR', 'number'], ['SSIM', 'number'], ['A picture', 'number'],
          ['At step', 'number'], ['When, UTC']
        ],
        evaluations.map(
            ({result, finished_at: when}) =>
                [`${plural(result.views, 'view')} of ${result.protocol.split}${
                     result.scales.length > 1 ? `, ${plural(result.scales.length, 'scale')}` : ''}`,
                 `${decibel(result.psnr)} ± ${fixed(result.psnr_spread, 2)}`, fixed(result.ssim, 4),
                 milliseconds(result.render_ms_median), whole(result.protocol.step),
                 minutes(when)]));

function effectsTable(scene, measured) {
  const gains = new Map(measured?.gains.map((gain) => [gain.name, gain]));
  const gained = measured ? [['Gain', 'number'], ['Cost', 'number']] : [];
  return scene.effects.length &&
      table([['Effect'], ['State'], ['Why', 'why'], ['Number', 'told'], ['On', 'told'], ...gained],
            scene.effects.map((effect) => {
              const gain = gains.get(effect.name);
              return [
                effectTitle(effect.name),
                effect.decided ? effect.on ? 'on' : 'off' : 'open', effect.reason, effect.number_text ?? '–',
                conditionWords(effect).replace(/^on /, '') || '–',
                ...(measured ? [gain && gain.gain !== null ? decibel(gain.gain) : '–',
                                gain && gain.cost !== null ? `${fixed(100 * gain.cost, 0)} %` : '–'] :
                               [])
              ];
            }));
}

/** What is known; of a scene that was never trained, why. */
function facts(scene, dataset, job) {
  const {config, psnr, held_out: held} = scene;
  const problem = job?.problem;
  return [
    [
      'Dataset',
      dataset ? `${dataset.name}: ${whole(dataset.frames)} images, ${dataset.width} × ${
                    dataset.height}, ${bytes(dataset.size_bytes)}` :
                scene.dataset_name
    ],
    [
      'Trained',
      scene.steps ? `${whole(scene.steps)} steps in ${seconds(scene.train_seconds)}` :
                    problem ? `not: ${problem.title}: ${problem.detail}` : 'not yet'
    ],
    ['Preset', config && `${config.preset}, seed ${config.seed}, on ${config.train_split}`],
    [
      'Field',
      config && `${config.planes} planes (${config.orientation}) of ${config.grow_to}², ${
                    config.channels} channels, networks of width ${config.width}`
    ],
    ['Held out', psnr !== null && `${decibel(psnr)}${held ? ` (${held})` : ''}`],
    ['Kernels', scene.kernels],
    ['Parameters', scene.parameters_sha256 && h('code', null, scene.parameters_sha256)]
  ].filter(([, value]) => value);
}

/** What could not be read is left out of the report. */
const orNull = (promise) => promise.catch(() => null);

/**
 * @param {string} id of the scene @param {AbortSignal} signal
 * @returns {Promise<Blob>}
 */
export async function reportOf(id, signal) {
  const scene = await api.scene(id, signal);
  const [dataset, cameras, evaluations, job, metrics, curve, measured, info] = await Promise.all([
    scene.dataset ? orNull(api.dataset(scene.dataset, signal)) : null,
    scene.dataset ? orNull(api.cameras(scene.dataset, signal)) : null,
    orNull(api.evaluations(scene.id, signal)), scene.job ? orNull(api.job(scene.job, signal)) : null,
    scene.job ? orNull(api.metrics(scene.job, signal)) : null, orNull(api.curve(scene.id, signal)),
    orNull(api.effects(scene.id, signal)), orNull(api.info(signal))
  ]);
  const shown = [];
  if (scene.steps > 0)
    for (const [item, words] of viewsToShow(cameras ?? [], evaluations?.[0]))
      shown.push(await orNull(comparison(scene, item, words, signal)));
  const points = (metrics ?? [])
                     .filter((m) => m.psnr !== null)
                     .map((m) => ({x: m.train_seconds, y: m.psnr, step: m.step}));
  const training = h('div');
  if (points.length)
    drawChart(
        training, points, {limitX: 0, running: false, now: 0, size: {width: 820, height: 240}});
  const cost = h('div');
  if (curve) drawCost(cost, curve.points, {size: {width: 820, height: 220}});
  const root = document.implementation.createHTMLDocument(`${scene.name} · ripnerf`);
  root.body.append(h(
      'main', null,
      ...[h('h1', null, scene.name),
          h('p', {class: 'quiet'},
            `A report of ripnerf ${info?.version ?? ''}, ${minutes(new Date().toISOString())} UTC${info ? `, on ${info.device_name || info.device}` : ''}`),
          factsTable(facts(scene, dataset, job)), section('Views', shown),
          section(
              'Evaluations',
              evaluations?.length &&
                  [
                    evaluationTable(evaluations),
                    h('p', {class: 'quiet'}, 'PSNR and SSIM against photographs, means over the views.')
                  ]),
          section(
              'Training',
              points.length &&
                  [
                    training,
                    h('p', {class: 'quiet'},
                      `PSNR over seconds of training, ${scene.held_out ?? 'held-out views'}.`)
                  ]),
          section(
              'Accuracy against time',
              curve &&
                  [
                    cost,
                    h('p', {class: 'quiet'},
                      `PSNR over milliseconds a picture, against ${
                          curve.photographs ? 'photographs' : 'the full picture'}: ${
                          plural(curve.views, 'view')} of ${curve.width} × ${curve.height}, ${
                          curve.kernels}.`)
                  ]),
          section('Effects', effectsTable(scene, measured)),
          section(
              'Compared with the paper',
              scene.differences.length &&
                  table(
                      [['What differs'], ['Measured']],
                      scene.differences.map((item) => [item.what, item.measured || '–'])))]
          .filter(Boolean)));
  const {head, body} = root;
  return new Blob(
      [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">', head.innerHTML,
        `<style>${STYLE}</style></head>`, body.outerHTML.replaceAll(`<img ${SRC}=`, '<img src='),
        '</html>'
      ],
      {type: 'text/html'});
}

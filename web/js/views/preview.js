// What an import would keep, before any photograph is sent: the daemon reads the documents and the
// beginnings of the images at once, and once all have been looked at here, small pictures of them.
import {api} from '../api.js';
import {fill, h} from '../dom.js';
import {find, isActive, putJob, state, watch} from '../store.js';
import {bytes, plural, seconds} from '../format.js';
import {facts, meter, recordedProblem, scroller} from '../ui.js';
import {headOf, isPhotograph} from '../photocheck.js';
import {sendInParts} from '../sending.js';
import {tarOf} from '../tar.js';
import {cameraPlot, middleOf, SPLIT_COLOURS} from './cloud.js';
import {expected, report} from './dataset.js';

const MOST = 128 << 20;  // more is not sent to be looked at, or a quarter of what an import takes
const LOOKS = 'ripnerf-looks';  // the folder of small pictures in what is sent
const THUMBS = 24;
const THUMB_PX = 160;
const SETTLE_MS = 400;  // after the last change of an option

/** So many of a list, evenly spaced. */
const some = (items, count) =>
    (items.length <= count ?
         items :
         Array.from({length: count}, (_, i) => items[Math.floor((i * items.length) / count)]));

/** A photograph of the folder, small; what its mask leaves out is darkened. */
async function paint(canvas, photo, mask) {
  const picture = await createImageBitmap(photo, {resizeWidth: THUMB_PX, resizeQuality: 'medium'});
  [canvas.width, canvas.height] = [picture.width, picture.height];
  const context = canvas.getContext('2d');
  context.drawImage(picture, 0, 0);
  picture.close();
  if (!mask) return;
  const cover =
      await createImageBitmap(mask, {resizeWidth: canvas.width, resizeHeight: canvas.height});
  context.globalCompositeOperation = 'multiply';
  context.globalAlpha = 0.8;
  context.drawImage(cover, 0, 0);
  cover.close();
}

/** Without poses nothing says which split a photograph is of. */
function thumbnail(item, files) {
  const canvas =
      h('canvas',
        {class: 'preview-thumb', role: 'img', 'aria-label': item.file, width: 1, height: 1});
  const photo = files.get(item.file);
  if (photo) paint(canvas, photo, files.get(item.mask)).catch(() => {});  // told in the report
  return h(
      'figure', null, canvas,
      item.split ?
          h('figcaption', null, swatch(item.split),
            ` ${item.split}${item.mask ? ', masked' : ''}`) :
          h('figcaption', null, item.file.split('/').at(-1)));
}

/** Whether a job ended by what it was given, not by what befell it. */
const isRefusal = (problem) => problem?.status >= 400 && problem.status < 500;

const swatch = (split) =>
    h('span', {class: 'split-mark', 'aria-hidden': 'true', 'data-split': split});

const optionWords = ({max_size: size, split, scales}) =>
    [size && `longest side ${size} px`, split && `test: every ${split.split(':')[1]}th view`,
     scales && `${scales} scales`]
        .filter(Boolean)
        .join(', ') ||
    'as the files are';

/** What an import by other options would keep, and what training takes of that; each can be taken. */
function choices(offered, take) {
  const heads =
      ['Options', 'Train', 'Test', 'Pixels', 'Trained at', 'Memory', 'Loading, training', 'Use'];
  const cells = (choice) =>
      [choice.views.train, choice.views.test, `${choice.width} × ${choice.height}`,
       choice.train_scale > 1 ? `1/${choice.train_scale}` : 'full size', bytes(choice.memory_bytes),
       `${seconds(choice.load_seconds)}, ${seconds(choice.seconds)}`];
  const row = (choice, i) => h(
      'tr', null, h('th', {scope: 'row'}, optionWords(choice)),
      cells(choice).map((words, k) => h('td', {'data-head': heads[k + 1]}, `${words}`)),
      h('td', null,
        i ? h('button', {
          type: 'button',
          class: 'small',
          'aria-label': `Take ${optionWords(choice)}`,
          onclick: () => take(choice)
        },
              'Take') :
            'chosen'));
  const words = 'What other options would give, estimated for the preset standard';
  return scroller(
      words, null,
      h('table', {class: 'table choices'}, h('caption', null, words),
        h('thead', null, h('tr', null, heads.map((t) => h('th', {scope: 'col'}, t)))),
        h('tbody', null, offered.map(row))));
}

/** Of photographs without poses: what pictures alone say. */
function foundUnposed({views, report: told}, files) {
  const photos = [...files.keys()]
                     .filter(isPhotograph)
                     .sort((a, b) => a.localeCompare(b, 'en', {numeric: true}))
                     .map((file) => ({file}));
  return [
    facts([['Photographs', `${views.train}`]]),
    report(told, true),
    h('div', {class: 'photos'}, some(photos, THUMBS).map((item) => thumbnail(item, files)))
  ];
}

/**
 * The ball, as it is known before pixels are read: where nobody gave one, the daemon fits it to what the photographs'
 * alpha channels cut out.
 */
const boundsWords = ({bounds, report: told}, isWhole) =>
    told.with_alpha && !isWhole && bounds.source !== 'given' && told.layout !== 'native' ?
    'fitted to what the alpha channels cut out, once the photographs are read' :
    `radius ${Number(bounds.radius.toPrecision(4))} about (${
        bounds.centre.map((x) => Number(x.toPrecision(3))).join(', ')})`;

function found(validation, files, {take, isWhole, signal}) {
  const {views, items, scales} = validation;
  const masked = items.filter((item) => item.mask).length;
  const splits = Object.keys(SPLIT_COLOURS).filter((split) => views[split]);
  const {width, height} = items[0]?.camera ?? {};
  const plot = cameraPlot({...validation, bounds: {centre: middleOf(items)}}, items, signal);
  return [
    facts([
      ['Views', splits.map((split) => [swatch(split), ` ${views[split]} ${split} `])],
      ['Kept at', width && `${width} × ${height} px${scales > 1 ? `, ${scales} scales` : ''}`],
      ['Masks', masked ? `${masked} of ${plural(items.length, 'view')}` : 'none'],
      ['Bounds', boundsWords(validation, isWhole)],
      ...expected(validation.report.expected, null)
    ]),
    items.length ? plot.node : null,
    report(validation.report, true),
    h('div', {class: 'photos'}, some(items, THUMBS).map((item) => thumbnail(item, files))),
    validation.report.choices ? choices(validation.report.choices, take) : null
  ];
}

/**
 * @param {{entries: {path: string, file: File}[], bytes: number, poses?: string}} plan not looked at: a film
 * @param {{values: () => any, take: (choice: any) => void, looks: Promise<{path: string, file:
 *     Blob}[]>, node: HTMLElement, onFault: (error: Error|null) => void, onRefused: (isRefused:
 *     boolean) => void}} options of the import, a change of which is looked at anew, and small pictures
 *     of the photographs, when there are; onRefused: what an import of the same options would be
 * @param {AbortSignal} signal
 * @returns {{node: HTMLElement}} empty where there is nothing to read before
 */
export function createPreview(plan, {values, take, looks, node: form, onFault, onRefused}, signal) {
  const node = h('div', {class: 'preview', role: 'status'});
  const files = new Map(plan.entries.map(({path, file}) => [path, file]));
  const most = Math.max(MOST, plan.bytes / 4);
  const bar = meter('Looking at the dataset');
  let upload = null;
  let asked = null;  // the newest job
  let shown = '';
  let timer = 0;
  let isWhole = false;  // the heads of files are all of them

  let isFaulty = false;
  const fault = (error) => {
    if (error || isFaulty) onFault(error);  // what is told of sending stays
    isFaulty = Boolean(error);
  };
  const poses = plan.poses && {poses: plan.poses};
  async function look() {
    try {
      const options = {...poses, ...values()};
      const job = putJob(await api.submit({type: 'validate', upload, options}));
      fault(null);
      onRefused(false);
      asked = job.id;
    } catch (error) {
      if (!signal.aborted) fault(error);
    }
  }
  async function send(entries, words) {
    const tar = tarOf(entries);
    upload = await sendInParts(tar, undefined, {
      onProgress: (sent) => bar.set(sent / tar.size, `${words}: ${bytes(sent)}`),
      onWait: () => bar.set(null, 'The connection is lost.'),
      signal
    });
    if (!signal.aborted) await look();
  }
  async function begin() {
    fill(node, bar.node);
    const heads = await Promise.all(plan.entries.map(headOf));
    const size = heads.reduce((sum, {file}) => sum + file.size, 0);
    isWhole = size === plan.bytes;
    if (size > most)
      return fill(
          node,
          h('p', {class: 'quiet'},
            `Documents and image headers are ${
                bytes(size)}: what is in them is told once they are sent.`));
    await send(heads, 'documents and image headers');
    const small = (await looks).map(({path, file}) => ({path: `${LOOKS}/${path}.jpg`, file}));
    const more = small.reduce((sum, {file}) => sum + file.size, 0);
    if (!signal.aborted && more && size + more <= most)
      await send([...heads, ...small], 'small pictures');
  }
  const show = (job) => {
    const key = `${job.id} ${job.state}`;
    if (key === shown) return;
    shown = key;
    if (isActive(job)) return bar.set(null, 'reading documents and image headers');
    onRefused(isRefusal(job.problem));
    if (job.result)
      return fill(
          node,
          plan.poses ? foundUnposed(job.result, files) :
                       found(job.result, files, {take, isWhole, signal}));
    fill(node, job.problem ? recordedProblem(job.problem) : null);
  };
  if (!plan.entries.some(({path}) => isPhotograph(path))) return {node};
  form.addEventListener('change', () => {
    clearTimeout(timer);
    timer = setTimeout(() => upload && !signal.aborted && look(), SETTLE_MS);
  }, {signal});
  watch(() => {
    const job = asked && find(state.jobs, asked);
    if (job) show(job);
  }, signal);
  begin().catch((error) => !signal.aborted && fault(error));
  return {node};
}

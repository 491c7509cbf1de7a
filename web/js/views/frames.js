// The frames of a path job as they arrive: a player, a scrubber, a strip and the download.
import {api, token} from '../api.js';
import {fill, h, saveBlob, showBlob, text} from '../dom.js';
import {followJob} from '../follow.js';
import {pictureOf} from '../grey16.js';
import {find, isActive, may, state, watch} from '../store.js';
import {bytes, plural} from '../format.js';
import {link} from '../router.js';
import {copyLink} from '../share.js';
import {called, FILMS} from '../outputs.js';
import {action, announce, choice, endOf, panel, toast} from '../ui.js';

const KEPT_PIXELS = 48e6;  // of decoded pictures held for playing, 4 bytes each
const ANNOUNCE_MS = 10_000;

/** @param {any} job @param {AbortSignal} signal */
export function framesPanel(job, signal) {
  const there = new Set();
  const pictures = new Map();
  const canvas = h('canvas', {class: 'frame', role: 'img', 'aria-label': 'Frame'});
  const waiting =
      h('p', {class: 'cover-note', role: 'status'},
        h('span', {class: 'spinner', 'aria-hidden': 'true'}), 'Waiting for the first frame');
  const scrub = h('input', {
    type: 'range',
    min: 0,
    max: 0,
    value: 0,
    step: 1,
    id: 'scrub',
    'aria-label': 'Frame number'
  });
  const shown = job.options?.format !== 'exr';  // a browser has no decoder of EXR
  const at = h('output', {'for': 'scrub'});
  const cells = h('div', {class: 'cells', 'aria-hidden': 'true'});
  const count = h('span', {class: 'quiet'});
  const keep = h('div', {class: 'row', hidden: true}, download(job), shareButton(job));
  const play =
      h('button', {type: 'button', disabled: true, onclick: () => (timer ? stop() : start())},
        'Play');
  const rate = h('input', {
    type: 'number',
    min: 1,
    max: 60,
    step: 'any',
    value: Math.min(60, job.options?.fps ?? 24),
    id: 'play-rate'
  });
  let current = -1;
  let wanted = -1;
  let pinned = false;  // the reader chose a frame: new ones no longer come up by themselves
  let timer = 0;
  let said = 0;

  const first = () => Math.min(...there);
  const known = () => (find(state.jobs, job.id) ?? job).progress?.total ?? 0;
  const total = () => Math.max(known(), there.size);
  const origin = () => job.options?.first ?? 0;

  const kept = () =>
      Math.max(8, KEPT_PIXELS / ((job.options?.width || 1920) * (job.options?.height || 1080)));

  /** Its memory goes at once, and after whoever waits for it has drawn it. */
  function forget(index) {
    pictures.get(index).then((bitmap) => bitmap.close(), () => {});
    pictures.delete(index);
  }

  signal.addEventListener('abort', () => [...pictures.keys()].forEach(forget), {once: true});

  async function picture(index) {
    if (!pictures.has(index)) {
      pictures.set(
          index,
          api.frame(job.id, index, signal)
              .then((blob) => pictureOf(blob, job.options?.output ?? 'rgb'))
              .then(({picture}) => picture));
      if (pictures.size > kept()) forget(pictures.keys().next().value);
    }
    try {
      return await pictures.get(index);
    } catch (error) {
      pictures.delete(index);
      throw error;
    }
  }

  async function show(index) {
    wanted = index;
    const bitmap = await picture(index).catch(() => null);
    if (!bitmap || wanted !== index || signal.aborted) return;
    if (canvas.width !== bitmap.width || canvas.height !== bitmap.height)
      Object.assign(canvas, {width: bitmap.width, height: bitmap.height});
    canvas.getContext('2d').drawImage(bitmap, 0, 0);
    current = index;
    waiting.hidden = true;
    canvas.setAttribute('aria-label', `Frame ${index}`);
    scrub.value = index;
    text(at, `frame ${index}`);
    [...cells.children].forEach(
        (cell, i) =>
            (i + origin() === index ? cell.setAttribute('data-current', '') :
                                      cell.removeAttribute('data-current')));
  }

  function update() {
    const all = total();
    while (cells.children.length < all) cells.append(h('span'));
    for (const index of there) cells.children[index - origin()]?.setAttribute('data-there', '');
    scrub.min = origin();
    scrub.max = Math.max(origin(), origin() + all - 1);
    text(count, known() ? `${there.size} of ${plural(all, 'frame')}` : plural(there.size, 'frame'));
    play.disabled = there.size < 2 || !shown;
    keep.hidden = !there.size;
    const now = find(state.jobs, job.id) ?? job;
    if (!shown && there.size)
      fill(waiting, 'EXR frames are not shown here: download them for a program that reads them.');
    if (!there.size && !isActive(now)) fill(waiting, `No frames: the job ${endOf(now)}.`);
  }

  function arrived(index) {
    if (there.has(index)) return;
    there.add(index);
    update();
    if (shown && !pinned && !timer) show(index);
    if (performance.now() - said > ANNOUNCE_MS) {
      said = performance.now();
      announce(`${plural(there.size, 'frame')} rendered`);
    }
  }

  function step() {
    const order = [...there].sort((a, b) => a - b);
    const next = order.find((index) => index > current) ?? first();
    picture(order[(order.indexOf(next) + 4) % order.length]).catch(() => {});
    show(next);
  }
  function start() {
    pinned = true;
    text(play, 'Pause');
    timer = setInterval(step, 1000 / Math.min(60, Math.max(0.1, Number(rate.value) || 24)));
    step();
  }
  function stop() {
    clearInterval(timer);
    timer = 0;
    text(play, 'Play');
  }
  rate.addEventListener('change', () => {
    if (timer) {
      stop();
      start();
    }
  });
  scrub.addEventListener('input', () => {
    pinned = true;
    stop();
    if (there.has(Number(scrub.value))) show(Number(scrub.value));
  });
  signal.addEventListener('abort', () => {
    stop();
    for (const index of [...pictures.keys()]) forget(index);
  }, {once: true});

  api.frames(job.id, signal)
      .then((items) => items.forEach((item) => arrived(item.index)), () => {});
  followJob(job.id, (type, data) => type === 'frame' && arrived(data.index), signal);
  watch(update, signal);
  const both = choice('Shown', [['film', 'film'], ['frames', 'frames']], 'film');
  const showOne = () => {
    const now = find(state.jobs, job.id) ?? job;
    const made = Boolean(now.result?.film);
    both.node.hidden = !made;
    film.hidden = made ? both.control.value !== 'film' : !job.options?.film || isActive(now);
    frames.hidden = made && both.control.value === 'film';
    if (frames.hidden) stop();
    if (film.hidden) film.querySelector('video')?.pause();
  };
  both.control.onChange(showOne);
  const film = filmPanel(job, signal);
  const frames = panel(
      'Frames', {tools: h('div', {class: 'row'}, count, keep)},
      h('div', {class: 'screen'}, canvas, waiting),
      h('div', {class: 'row player'}, play, scrub, at,
        h('div', {class: 'row'}, h('label', {'for': 'play-rate'}, 'at'), rate,
          h('span', {class: 'quiet'}, 'frames/s'))),
      cells);
  watch(showOne, signal);
  return [both.node, film, frames];
}

/** The film, once it is made: it plays here and can be kept. Whether it is shown says who holds it. */
function filmPanel(job, signal) {
  const box = h('div');
  const node = panel('Film', {class: 'panel', hidden: true}, box);
  const wanted = job.options?.film;
  let shown = '';
  if (!wanted) return node;
  const show = async (now) => {
    const {film, film_bytes: size} = now.result;
    const name = `${now.scene_name ?? now.id}${film.slice(film.lastIndexOf('.'))}`;
    const blob = await api.download(`v1/jobs/${encodeURIComponent(now.id)}/film`, {signal});
    const picture =
        film.endsWith('.gif') ? h('img', {class: 'film', alt: 'The film'}) : h('video', {
          class: 'film',
          controls: true,
          loop: true,
          muted: true,
          playsinline: true,
          'aria-label': 'The film'
        });
    showBlob(picture, blob, signal);
    fill(
        box, h('div', {class: 'screen'}, picture),
        h('div', {class: 'row'},
          h('span', {class: 'quiet'}, `${called(FILMS, wanted)}, ${bytes(size)}`),
          action('Save film', async () => saveBlob(blob, name), {kind: 'primary'})));
  };
  watch(() => {
    const now = find(state.jobs, job.id) ?? job;
    const key = `${now.state} ${now.result?.film ?? ''}`;
    if (key === shown) return;
    shown = key;
    if (now.result?.film)
      show(now).catch(toast);
    else
      fill(box, h('p', {class: 'quiet'}, `None: the job ${endOf(now)}.`));
  }, signal);
  return node;
}

/** For someone without a token: these pictures, read-only. */
function shareButton(job) {
  if (!may('train')) return null;
  const publish = () => copyLink({job: job.id}, link.job(job.id), job.scene_name ?? job.id);
  return action('Share', publish, {
    kind: 'small',
    title: 'A link for someone without a token: these pictures, read-only, for 30 days'
  });
}

function download(job) {
  const path = `v1/jobs/${encodeURIComponent(job.id)}/frames.tar`;
  const name = `${job.scene_name ?? job.id}-frames.tar`;
  return token.get() ?
      action('Download', async () => saveBlob(await api.download(path), name), {kind: 'small'}) :
      h('a', {class: 'button small', href: path, download: name}, 'Download');
}

// The picture of a scene and everything that moves its camera.
import {api, Problem, Unreachable} from '../api.js';
import {
  cameraOf,
  defaultOrbit,
  fovOf,
  keyMove,
  listen,
  openCvPose,
  orbitOfPose,
  poseOfOrbit,
  upOf
} from '../orbit.js';
import {fill, h, text} from '../dom.js';
import {compact, milliseconds, whole} from '../format.js';
import {createViewer} from '../viewer.js';
import {choice, toast} from '../ui.js';
import {createWipe} from './wipe.js';

const LEVELS = ['coarse', 'half size', 'refined'];
const MAX_SIDE = 1280;

/**
 * @param {any} scene @param {any[]} cameras the dataset's, all splits
 * @param {{live: () => boolean, failed: () => boolean, onKey: () => void}}
 *     host @param {AbortSignal} signal
 */
export function createViewport(scene, cameras, host, signal) {
  const bounds = scene.bounds ?? {centre: [0, 0, 0], radius: 1.5};
  const full = cameras.filter((item) => item.scale === 0);
  const up = upOf(full.map((item) => item.camera));
  const orbitAt = (item) => orbitOfPose(openCvPose(item.camera), fovOf(item.camera), up, bounds);
  const start = full.length ? orbitAt(full.find((item) => item.split === 'test') ?? full[0]) :
                              defaultOrbit(bounds, up);
  let orbit = start;
  let pose = null;  // a recorded key's exact pose, until the camera is moved

  const canvas = h('canvas', {class: 'picture'});
  const hud = h('p', {class: 'hud'});
  const cover =
      h('div', {class: 'cover-note', role: 'status'},
        h('span', {class: 'spinner', 'aria-hidden': 'true'}), 'Waiting for the first picture');
  const help =
      'Arrow keys turn, Shift and arrows move, plus and minus come nearer and go away, R resets, K records a key.';
  const stage =
      h('div', {
        class: 'stage',
        tabindex: 0,
        role: 'application',
        'aria-label': `Camera about ${scene.name}. ${help}`
      },
        canvas, cover, hud);
  const output =
      choice('Show', [['rgb', 'colour'], ['depth', 'depth'], ['alpha', 'opacity']], 'rgb');
  const fov =
      h('input', {type: 'range', min: 5, max: 100, step: 0.5, value: orbit.fovDeg, id: 'fov'});
  const fovWords = h('output', {'for': 'fov'});
  const detail = h('select', {id: 'detail'}, [
    ['0.5', 'half'], ['1', 'normal'], ['2', 'sharp']
  ].map(([value, words]) => h('option', {value, selected: value === '1'}, words)));
  const wipe = createWipe(scene, signal);
  const views = viewPicker(full, (item) => {
    set(orbitAt(item), openCvPose(item.camera));
    wipe.show(item).catch(toast);
  });

  const viewer = createViewer(
      canvas, {
        camera: (width, height) =>
            (pose ?
                 {world_from_camera: pose, axes: 'opencv', width, height, fov_y_deg: orbit.fovDeg} :
                 cameraOf(orbit, width, height)),
        fullSize,
        output: () => output.control.value,
        live: host.live,
        send: (body, stop) => api.render(scene.id, body, stop),
        onPicture: showFacts,
        onTrouble: showTrouble,
      },
      signal);

  function fullSize() {
    const factor = Math.min(
        Number(detail.value), devicePixelRatio * (detail.value === '2' ? 2 : 1),
        MAX_SIDE / stage.clientWidth);
    const even = (x) => Math.max(16, 2 * Math.round((x * factor) / 2));
    return {width: even(stage.clientWidth), height: even(stage.clientHeight)};
  }

  function set(next, exactPose = null) {
    orbit = next;
    pose = exactPose;
    wipe.hide();
    views?.clear();
    fov.value = orbit.fovDeg;
    text(fovWords, `${Number(orbit.fovDeg.toFixed(1))}°`);
    viewer.changed();
  }

  function showFacts(facts) {
    stage.dataset.ready = 'true';
    stage.dataset.level = LEVELS[facts.level];
    text(
        hud,
        [
          facts.step === 0 ? 'not trained yet' : LEVELS[facts.level],
          `${facts.width} × ${facts.height}`,
          Number.isFinite(facts.step) ? `step ${whole(facts.step)}` : '',
          Number.isFinite(facts.renderMs) ? `${milliseconds(facts.renderMs)} rendering` : '',
          `${milliseconds(facts.totalMs)} in all`,
          Number.isFinite(facts.samples) ? `${compact(facts.samples)} samples` : ''
        ].filter(Boolean)
            .join('  ·  '));
  }

  function showTrouble(error) {
    cover.hidden = !error && stage.dataset.ready === 'true';
    stage.dataset.trouble = String(Boolean(error));
    if (!error) return;
    if (host.failed()) {
      fill(cover, 'No picture: training ended without a checkpoint.');
      return;
    }
    const waits = error instanceof Unreachable ||
        error instanceof Problem && (error.status === 503 || error.status === 409);
    fill(
        cover, waits ? h('span', {class: 'spinner', 'aria-hidden': 'true'}) : null,
        h('span', null,
          error instanceof Unreachable ?
              'The daemon does not answer; the picture comes back with it.' :
              `${error.title ?? 'No picture'}: ${error.detail || error.message}`));
  }

  function resize() {
    const ratio = Math.min(2, devicePixelRatio || 1);
    const [width, height] =
        [Math.round(stage.clientWidth * ratio), Math.round(stage.clientHeight * ratio)];
    if (!width || canvas.width === width && canvas.height === height) return;
    const before = canvas.width > 1 ? createImageBitmap(canvas) : null;
    Promise.resolve(before).then((old) => {
      Object.assign(canvas, {width, height});
      if (old) canvas.getContext('2d').drawImage(old, 0, 0, width, height);
      viewer.changed();
    });
  }

  listen(stage, () => orbit, set, signal);
  stage.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || keyMove(event, orbit)) return;
    if (event.key === 'r' || event.key === 'R') set(start);
    if (event.key === 'k' || event.key === 'K') host.onKey();
  }, {signal});
  fov.addEventListener('input', () => set({...orbit, fovDeg: Number(fov.value)}));
  output.control.onChange(() => viewer.refresh());
  detail.addEventListener('change', () => viewer.refresh());
  const observer = new ResizeObserver(resize);
  observer.observe(stage);
  signal.addEventListener('abort', () => observer.disconnect(), {once: true});
  text(fovWords, `${Number(orbit.fovDeg.toFixed(1))}°`);

  stage.append(wipe.node);
  const node = h(
      'section', {class: 'viewport', 'aria-label': 'View'}, stage,
      h('div', {class: 'viewport-tools'}, output.node,
        h('div', {class: 'tool'}, h('label', {'for': 'fov'}, 'Field of view'), fov, fovWords),
        h('div', {class: 'tool'}, h('label', {'for': 'detail'}, 'Detail'), detail), views?.node,
        h('button', {type: 'button', title: 'R', onclick: () => set(start)}, 'Reset'),
        h('button', {type: 'button', class: 'primary', title: 'K', onclick: () => host.onKey()},
          'Record key')),
      h('p', {class: 'quiet help', 'aria-hidden': 'true'},
        'Drag turns, Shift-drag moves, the wheel comes nearer. Keys: arrows, Shift-arrows, + and −, R resets, K records.'));
  return {
    node,
    get orbit() { return orbit; },
    pose: () => pose ?? poseOfOrbit(orbit),
    /** Shows an exact pose; moving on from it keeps its direction. */
    show: (exact, fovDeg) => set(orbitOfPose(exact, fovDeg, up, bounds), exact),
    /** A small picture of a camera for a key. */
    thumbnail: async (exact, fovDeg, stop) => (await api.render(
                                                   scene.id, {
                                                     camera: {
                                                       world_from_camera: exact,
                                                       axes: 'opencv',
                                                       width: 144,
                                                       height: 108,
                                                       fov_y_deg: fovDeg
                                                     },
                                                     format: 'jpeg',
                                                     jpeg_quality: 80
                                                   },
                                                   stop))
                                                  .blob,
    refresh: viewer.refresh,
    msPerPixel: viewer.msPerPixel,
  };
}

/** "Go to a view": a split's camera by number. */
function viewPicker(cameras, show) {
  const splits = [...new Set(cameras.map((item) => item.split))];
  if (!splits.length) return null;
  const select =
      h('select', {
        id: 'view-pick',
        onchange: () => {
          const {value} = select;
          if (value !== '') show(cameras[Number(value)]);
          select.value = value;
        }
      },
        h('option', {value: ''}, 'choose'),
        splits.map(
            (split) => h(
                'optgroup', {label: split},
                cameras.map(
                    (item, i) =>
                        (item.split === split ? h('option', {value: i}, `${split}:${item.index}`) :
                                                null)))));
  return {
    node: h('div', {class: 'tool'}, h('label', {'for': 'view-pick'}, 'View'), select),
    clear: () => {
      select.value = '';
    }
  };
}

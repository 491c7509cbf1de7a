// The picture of a scene and everything that moves its camera.
import {api, Problem, Unreachable} from '../api.js';
import {
  aroundCamera,
  cameraOf,
  defaultOrbit,
  fly,
  fovOf,
  keyMove,
  listen,
  lookAt,
  openCvPose,
  orbitOfCamera,
  orbitOfPose,
  orbitOfWord,
  poseOfOrbit,
  upOf,
  wordOfOrbit
} from '../orbit.js';
import {add, column, cross, scale, unit} from '../vector.js';
import {fill, h, saveBlob, showBlob, sleep, text} from '../dom.js';
import {readGrey16} from '../grey16.js';
import {opticsOfPicture} from '../optics.js';
import {compact, milliseconds, seconds, whole} from '../format.js';
import {legend, OUTPUTS} from '../outputs.js';
import {createViewer} from '../viewer.js';
import {action, choice, copyWords, STANDS_IN_MS, toast} from '../ui.js';
import {link} from '../router.js';
import {copyLink} from '../share.js';
import {may, means, state, watch} from '../store.js';
import {createCrop} from './crop.js';
import {cameraNear, drawOverlay} from './overlay.js';
import {createWipe} from './wipe.js';

const LEVELS = ['coarse', 'half size', 'refined'];
const MAX_SIDE = 1280;
const AWAY = 'The daemon does not answer; the picture comes back with it.';
const TOLD_MS = 250;  // figures of pictures of a moving camera are told no more often: nobody reads them

/**
 * @param {any} scene @param {any[]} cameras the dataset's, all splits
 * @param {{live: () => boolean, failed: () => boolean, onKey?: () => void, onTake?: () => void,
 *     onMoved?: () => void, onPick?: (id: string) => void, camera: string|null, crop?: string|null, at?: number|null,
 *     onNow?: () => void, start?: any, up?: number[]}}
 *     host onTake: the chosen key shall have this camera; onMoved: the reader chose another camera;
 *     onPick: a key was pointed at; camera: the address's; at: training seconds to look back at, and
 *     what leads back; start: a camera to begin at where no cameras are given; up: the dataset's
 * @param {AbortSignal} signal
 */
export function createViewport(scene, cameras, host, signal) {
  const bounds = scene.bounds ?? {centre: [0, 0, 0], radius: 1.5};
  const full = cameras.filter((item) => item.scale === 0);
  const up = host.up ?? upOf(full.map((item) => item.camera));
  const orbitAt = ({camera}) => orbitOfCamera(camera, up, bounds);
  const first = full.find((item) => item.split === 'test') ?? full[0] ??
      (host.start ? {camera: host.start} : null);
  const start = first ? orbitAt(first) : defaultOrbit(bounds, up);
  let orbit = orbitOfWord(host.camera, up) ?? start;
  let things = {path: null, selected: null, time: null};  // drawn over the picture
  let budgetMs = null;  // of a refined picture; null: as long as it takes
  let pose = null;      // a recorded key's exact pose, until the camera is moved
  let optics = {};      // and its effects
  let at = host.at ?? null;  // training seconds that are looked back at
  let refined = null;  // the picture that is shown, as it came: a canvas has pixels of its own

  const canvas = h('canvas', {class: 'picture'});
  const over = h('canvas', {class: 'overlay', 'aria-hidden': 'true'});
  const hud = h('p', {class: 'hud'});
  const cover =
      h('div', {class: 'cover-note', role: 'status'},
        h('span', {class: 'spinner', 'aria-hidden': 'true'}), 'Waiting for the first picture');
  const photograph = h('img', {class: 'first', alt: '', draggable: 'false'});  // until there is one
  const keyed = host.onKey ? ', K records a key, U moves the chosen key here' : '';
  const help =
      `Arrow keys turn, Shift and arrows move, W A S D Q E fly, plus and minus come nearer and go away, F fills the screen, R resets${keyed}.`;
  const stage =
      h('div', {
        class: 'stage',
        tabindex: 0,
        role: 'application',
        'aria-label': `Camera about ${scene.name}. ${help}`
      },
        canvas, over, cover, hud);
  const past = h(
      'p', {class: 'past', hidden: true},
      h('button', {type: 'button', class: 'small', onclick: () => host.onNow?.()}, 'Back to now'));
  for (const type of ['pointerdown', 'wheel', 'keydown'])
    past.addEventListener(type, (event) => event.stopPropagation());
  stage.append(past);
  const output =
      choice('Show', OUTPUTS, 'rgb');
  /** A photograph or another scene's picture beside a map's colours would say nothing. */
  const inColour = () => output.control.value === 'rgb';
  const fov =
      h('input', {type: 'range', min: 5, max: 100, step: 0.5, value: orbit.fovDeg, id: 'fov'});
  const fovWords = h('output', {'for': 'fov'});
  const detail = h('select', {id: 'detail'}, [
    ['0.5', 'half'], ['1', 'normal'], ['2', 'sharp']
  ].map(([value, words]) => h('option', {value, selected: value === '1'}, words)));
  const route =
      h('input', {type: 'checkbox', id: 'show-route', checked: true, onchange: () => drawThings()});
  const cameras3d =
      h('input', {type: 'checkbox', id: 'show-cameras', onchange: () => drawThings()});
  const wipe = createWipe(scene, canvas, signal);
  const visit = (item) => {
    set(orbitAt(item), openCvPose(item.camera));
    if (inColour()) wipe.show(item).catch(toast);
  };
  const views = viewPicker(full, visit);

  const crop = createCrop(bounds, host.crop, () => {
    keepAddress();
    drawThings();
    viewer.changed();
  });
  const viewer = createViewer(
      canvas, {
        camera: cameraFor,
        fullSize,
        optics: () => optics,
        output: () => output.control.value,
        budgetMs: () => budgetMs,
        at: () => at,
        crop: () => crop.box(),
        live: () => !at && host.live(),
        send: (body, stop) => api.render(scene.id, body, stop),
        onPicture: showFacts,
        onTrouble: showTrouble,
      },
      signal);

  function cameraFor(width, height) {
    return pose ?
        {world_from_camera: pose, axes: 'opencv', width, height, fov_y_deg: orbit.fovDeg} :
        cameraOf(orbit, width, height);
  }

  function fullSize() {
    const factor = Math.min(
        Number(detail.value), devicePixelRatio * (detail.value === '2' ? 2 : 1),
        MAX_SIDE / stage.clientWidth);
    const even = (x) => Math.max(16, 2 * Math.round((x * factor) / 2));
    return {width: even(stage.clientWidth), height: even(stage.clientHeight)};
  }

  /** The view that is begun at, as it was photographed, where its picture takes long. */
  async function standIn() {
    const isWanted = () =>
        orbit === start && !stage.dataset.ready && stage.dataset.trouble !== 'true';
    await sleep(STANDS_IN_MS, signal);
    const blob =
        isWanted() && await api.photo(scene.dataset, first.split, first.index, 0, signal);
    if (!blob || !isWanted()) return;
    showBlob(photograph, blob, signal);
    cover.before(photograph);
    fill(
        cover, h('span', {class: 'spinner', 'aria-hidden': 'true'}),
        'A photograph, until the first picture is there');
  }
  if (first?.split) standIn().catch(() => {});

  /** A camera that the reader chose; nothing else moves it from now on. */
  function set(next, exactPose = null) {
    host.onMoved?.();
    place(next, exactPose);
  }

  function place(next, exactPose = null, effects = {}) {
    photograph.remove();
    orbit = next;
    pose = exactPose;
    optics = effects;
    wipe.hide();
    views?.clear();
    keepAddress();
    viewer.changed();
    drawSoon();
  }

  /** What follows the camera beside the picture: once a frame, however often it moves. */
  let planned = 0;
  function drawSoon() {
    planned ||= requestAnimationFrame(() => {
      planned = 0;
      drawThings();
      fov.value = orbit.fovDeg;
      text(fovWords, `${Number(orbit.fovDeg.toFixed(1))}°`);
    });
  }

  /** The address holds the camera, so that it can be sent. */
  let addressTimer = 0;
  function keepAddress() {
    clearTimeout(addressTimer);
    addressTimer = setTimeout(() => {
      if (!signal.aborted) window.history.replaceState(null, '', addressOf());
    }, 300);
  }
  const queryOf = () => `?camera=${wordOfOrbit(orbit)}${at ? `&at=${at}` : ''}${
      crop.word() ? `&crop=${crop.word()}` : ''}`;
  const addressOf = () => link.scene(scene.name, queryOf());

  const photographs =
      full.filter((item) => item.split === 'train')
          .map((item) => ({item, pose: openCvPose(item.camera), fovDeg: fovOf(item.camera)}));
  function drawThings() {
    const shown = cameras3d.checked ? photographs : [];
    drawOverlay(over, {pose: pose ?? poseOfOrbit(orbit), fovDeg: orbit.fovDeg}, {
      ...things,
      path: route.checked ? things.path : null,
      photographs: shown,
      crop: crop.box(),
      radius: bounds.radius
    });
  }

  /** What is drawn at a point of the stage: a key of the path, else a photograph's camera, or null. */
  function drawnAt(event) {
    const box = stage.getBoundingClientRect();
    const near = (items) => cameraNear(
        items, {pose: pose ?? poseOfOrbit(orbit), fovDeg: orbit.fovDeg}, bounds.radius, box,
        [event.clientX - box.left, event.clientY - box.top]);
    return (route.checked && near(things.path?.keys ?? [])) ||
        (cameras3d.checked && near(photographs)) || null;
  }
  let pressedAt = null;  // null: what was pressed has become a drag
  function hover(event) {
    if (!event.buttons) stage.toggleAttribute('data-over', Boolean(drawnAt(event)));
    if (event.buttons && pressedAt &&
        Math.hypot(event.clientX - pressedAt[0], event.clientY - pressedAt[1]) > 4)
      pressedAt = null;
  }
  function pick(event) {
    const control = event.target.closest('.wipe-bar, .past, [data-own]');
    const found = !control && pressedAt && drawnAt(event);
    if (found?.item)
      visit(found.item);
    else if (found)
      host.onPick?.(found.id);
  }

  /** What lies under a point of the stage becomes what the camera turns about. */
  async function lookThere(event) {
    const box = stage.getBoundingClientRect();
    const eyePose = pose ?? poseOfOrbit(orbit);
    const focal = box.height / 2 / Math.tan((orbit.fovDeg * Math.PI) / 360);
    const x = (event.clientX - box.left - box.width / 2) / focal;
    const y = (event.clientY - box.top - box.height / 2) / focal;
    const eye = column(eyePose, 3);
    const ray = unit(
        add(column(eyePose, 2), add(scale(column(eyePose, 0), x), scale(column(eyePose, 1), y))));
    const right = unit(cross(ray, up));
    const down = cross(ray, right);
    const aimed = [0, 1, 2].map((i) => [right[i], down[i], ray[i], eye[i]]);
    const distance = await depthOf(aimed);
    if (distance) set(lookAt(orbit, add(eye, scale(ray, distance))));
  }

  /** How far away what a camera's middle shows is, dataset units; null where that is nothing. */
  async function depthOf(aimed) {
    const camera = {world_from_camera: aimed, axes: 'opencv', width: 9, height: 9, fov_y_deg: 0.6};
    const {blob} = await api.render(
        scene.id, {camera, output: 'depth', format: 'png', supersample: 1}, signal);
    const depth = await readGrey16(blob);
    const hit = [...(depth?.values ?? [])].filter((value) => value).sort((a, b) => a - b);
    if (!hit.length || !(depth.scale > 0)) return null;
    return (hit[hit.length >> 1] / 65535) * depth.scale;
  }

  // Another scene of the same photographs, seen by the same camera.
  const rivals = state.scenes.filter(
      (other) =>
          other.id !== scene.id && other.steps > 0 && means(scene.dataset, {id: other.dataset}));
  // And this scene as it was earlier in its training.
  const marks = scene.marks?.length ?
      h('optgroup', {label: 'Earlier in this training'},
        scene.marks.map((mark) => h('option', {value: `at:${mark.train_seconds}`},
                                    `after ${seconds(mark.train_seconds)}`))) :
      null;
  const rival =
      h('select', {id: 'rival', onchange: () => beside()},
        h('option', {value: ''}, 'none'),
        rivals.map((other) => h('option', {value: other.id}, other.name)), marks);
  const besideWords = h('p', {class: 'hud beside', role: 'status'});  // what the picture waits for, or lacks
  stage.append(besideWords);
  async function beside() {
    const then = /^at:/.test(rival.value) ? Number(rival.value.slice(3)) : null;
    const other = then ? {id: scene.id, name: `After ${seconds(then)}`} :
                         rivals.find((one) => one.id === rival.value);
    if (!other || !inColour()) {
      text(besideWords, other ? `${other.name} is laid over colours alone` : '');
      return wipe.hide();
    }
    const seen = orbit;
    const chosen = rival.value;
    const isWanted = () => seen === orbit && rival.value === chosen && inColour();
    text(
        besideWords,
        then ? `Rendering the scene as it was after ${seconds(then)}…` :
               `Rendering ${other.name}…`);
    try {
      const blob = await pictureFrom(other.id, then);
      if (!isWanted()) return;
      wipe.lay(blob, other.name, false, refined);
      text(besideWords, '');
    } catch (error) {
      if (!isWanted() || signal.aborted) return;
      wipe.hide();
      text(besideWords, `${other.name} is not shown: ${error.detail || error.message}`);
    }
  }
  /** What this camera sees in a scene, in full; `then`: as it was after so many seconds of training. */
  async function pictureFrom(id, then) {
    const {width, height} = fullSize();
    const {blob} = await api.render(
        id, {
          camera: cameraFor(width, height),
          format: 'png',
          ...(then ? {at: then} : {}),
          ...(crop.box() ? {crop: crop.box()} : {})
        },
        signal);
    return blob;
  }

  let toldAt = -Infinity;
  function showFacts(facts) {
    refined = facts.level === 2 && facts.output === 'rgb' ? facts.blob : null;
    if (facts.level === 2) host.onRefined(facts);
    if (facts.level === 2 && rival.value) beside();
    photograph.remove();
    cover.hidden = true;
    stage.dataset.ready = 'true';
    stage.dataset.level = LEVELS[facts.level];
    const now = performance.now();
    if (facts.level === 0 && now - toldAt < TOLD_MS) return;
    toldAt = now;
    fill(hud, figuresOf(facts), legend(facts.scale, facts.output));
  }

  function showTrouble(error) {
    cover.hidden = !error && stage.dataset.ready === 'true';
    stage.dataset.trouble = String(Boolean(error));
    if (!error) return;
    photograph.remove();
    if (host.failed()) {
      fill(cover, 'No picture: training ended without a checkpoint.');
      return;
    }
    const waits = error instanceof Unreachable ||
        error instanceof Problem && (error.status === 503 || error.status === 409);
    fill(
        cover, waits ? h('span', {class: 'spinner', 'aria-hidden': 'true'}) : null,
        h('span', null,
          error instanceof Unreachable           ? AWAY :
              error.status === 409 && !scene.steps ? 'No picture yet: training has not begun.' :
                                                     `${error.title ?? 'No picture'}: ${error.detail || error.message}`));
  }
  /** With the daemon a picture is asked for at once; it may take long there, which is no absence. */
  watch(({connection}) => {
    if (connection.status !== 'online' || !cover.textContent.includes(AWAY)) return;
    fill(
        cover, h('span', {class: 'spinner', 'aria-hidden': 'true'}),
        h('span', null, 'The daemon is back; waiting for its picture'));
    viewer.refresh();
  }, signal);

  function resize() {
    const ratio = Math.min(2, devicePixelRatio || 1);
    const [width, height] =
        [Math.round(stage.clientWidth * ratio), Math.round(stage.clientHeight * ratio)];
    if (!width || canvas.width === width && canvas.height === height) return;
    const before = stage.dataset.ready ? createImageBitmap(canvas) : null;
    drawThings();
    Promise.resolve(before).then((old) => {
      Object.assign(canvas, {width, height});
      if (old) canvas.getContext('2d').drawImage(old, 0, 0, width, height);
      old?.close();
      viewer.changed();
    });
  }

  listen(stage, () => orbit, set, signal);
  flyWithKeys(stage, () => orbit, set, bounds.radius, signal);
  stage.addEventListener('pointerdown', (event) => {
    pressedAt = [event.clientX, event.clientY];
  }, {signal});
  stage.addEventListener('click', pick, {signal});
  stage.addEventListener('pointermove', hover, {signal});
  stage.addEventListener('dblclick', (event) => lookThere(event).catch(toast), {signal});
  stage.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || keyMove(event, orbit)) return;
    const key = event.key.toLowerCase();
    if (key === 'r') set(start);
    if (key === 'k') host.onKey?.();
    if (key === 'u') host.onTake?.();
    if (key === 'f') fillScreen();
  }, {signal});
  const fillScreen = () =>
      (document.fullscreenElement ? document.exitFullscreen() : node.requestFullscreen())
          .catch(toast);
  const save = async ({width, height} = fullSize()) => {
    const camera = cameraFor(width, height);
    const shown = opticsOfPicture(optics, true);
    const {blob} = await api.render(
        scene.id, {
          camera,
          output: output.control.value,
          format: 'png',
          ...(at ? {at} : {}),
          ...(crop.box() ? {crop: crop.box()} : {}),
          ...(Object.keys(shown).length ? {optics: shown} : {})
        },
        signal);
    saveBlob(blob, `${scene.name}-${width}x${height}.png`);
  };
  const share = async () => {
    const address = new URL(addressOf(), window.location.href).href;
    await copyWords(
        address, {what: 'A link to this camera', copied: 'The link to this camera is copied'});
  };
  const publish = () =>
      copyLink({scene: scene.id}, link.scene(scene.id, queryOf()), scene.name);
  fov.addEventListener('input', () => set({...orbit, fovDeg: Number(fov.value)}));
  output.control.onChange(() => {
    viewer.refresh();
    const item = views?.chosen();
    if (!inColour()) {
      wipe.hide();
      beside();
    } else if (item)
      wipe.show(item).catch(toast);
  });
  detail.addEventListener('change', () => viewer.refresh());
  const observer = new ResizeObserver(resize);
  observer.observe(stage);
  signal.addEventListener('abort', () => observer.disconnect(), {once: true});
  text(fovWords, `${Number(orbit.fovDeg.toFixed(1))}°`);

  past.hidden = !at;
  stage.append(wipe.node);
  const node = h(
      'section', {class: 'viewport', 'aria-label': 'View'}, stage,
      h('div', {class: 'viewport-tools'}, output.node,
        h('div', {class: 'tool'}, h('label', {'for': 'fov'}, 'Field of view'), fov, fovWords),
        h('div', {class: 'tool'}, h('label', {'for': 'detail'}, 'Detail'), detail), views?.node,
        h('div', {class: 'tool'}, route, h('label', {'for': 'show-route'}, 'Path')),
        photographs.length ?
            h('div', {class: 'tool'}, cameras3d, h('label', {'for': 'show-cameras'}, 'Cameras')) :
            null,
        rivals.length || marks ?
            h('div', {class: 'tool'}, h('label', {'for': 'rival'}, 'Beside'), rival) :
            null,
        h('div', {class: 'tool tools-end'},
          h('button', {type: 'button', class: 'small', title: 'R', onclick: () => set(start)},
            'Reset'),
          h('button', {type: 'button', class: 'small', title: 'F', onclick: fillScreen},
            'Full screen'),
          action('Save picture', () => save(), {kind: 'small', title: 'As it is shown, refined'}),
          exact(save), crop.node,
          action('Copy link', share, {kind: 'small', title: 'A link to this camera'}),
          may('train') ? action('Share', publish, {
            kind: 'small',
            title: 'A link for someone without a token: this scene, read-only, for 30 days'
          }) :
                         null),
        host.onKey ?
            h('button', {type: 'button', class: 'primary', title: 'K', onclick: () => host.onKey()},
              'Record key') :
            null),
      h('p', {class: 'quiet help touch'},
        'One finger turns, two move the picture and, spread or pinched, come nearer or go away; ' +
            'a double tap looks there.'),
      h('p', {class: 'quiet help', 'aria-hidden': 'true'},
        `Drag turns, Shift-drag moves, the wheel comes nearer, a double click looks there. Keys: arrows, W A S D fly, Q E down and up, + and −, F full screen, R resets${
            keyed}.${photographs.length ? ' A drawn camera is gone to by a click.' : ''}`));
  return {
    node,
    up,
    /** How long a refined picture may take; null: as long as it takes. */
    set budgetMs(ms) {
      budgetMs = ms;
      viewer.refresh();
    },
    /** Lays the full picture over what is shown, and says how far the two are apart. */
    besideFull: async () => {
      const seen = orbit;
      const blob = await pictureFrom(scene.id, at);
      if (seen === orbit) wipe.lay(blob, 'The full picture', true, refined);
    },
    /** Training seconds to look back at; null: as it is now. */
    set at(then) {
      at = then;
      past.hidden = !at;
      keepAddress();
      viewer.refresh();
    },
    /** The training photographs' cameras. */
    cameras: photographs,
    /** Right below the picture, in sight with it. */
    below: (part) => stage.after(part),
    /** What of a path is drawn over the picture. */
    overlay: (next) => {
      things = next;
      drawSoon();
    },
    /** Shows a dataset's view beside its photograph. */
    compare: (split, index) => {
      const item = full.find((one) => one.split === split && one.index === index);
      if (!item) return;
      if (!inColour()) output.control.value = 'rgb';
      visit(item);
      stage.scrollIntoView({block: 'nearest'});
    },
    get orbit() { return orbit; },
    /** The box that is shown: low corner, then high one; null: all. */
    crop: () => crop.box(),
    pose: () => pose ?? poseOfOrbit(orbit),
    /** Shows an exact pose; moving on from it keeps its direction. */
    show: (exact, fovDeg, effects) =>
        place(orbitOfPose(exact, fovDeg, up, bounds), exact, effects ?? {}),
    depthOf,
    /** A small picture of a camera for a key; `around`: of all directions. */
    thumbnail: async (exact, fovDeg, stop, effects, around) => {
      const small = opticsOfPicture(effects, true);
      const camera = around ?
          aroundCamera(exact, 176, 88) :
          {world_from_camera: exact, axes: 'opencv', width: 144, height: 108, fov_y_deg: fovDeg};
      const {blob} = await api.render(
          scene.id, {
            camera,
            format: 'jpeg',
            jpeg_quality: 80,
            ...(Object.keys(small).length ? {optics: small, supersample: 4} : {})
          },
          stop);
      return blob;
    },
    refresh: viewer.refresh,
    msPerPixel: viewer.msPerPixel,
  };
}

/** What a picture is and took, one line; a phone has no room for what is marked as `more`. */
function figuresOf(facts) {
  const more = (words) => h('span', {class: 'more'}, words);
  const known = (value, told) => (Number.isFinite(value) ? told : null);
  return [
    facts.step === 0                   ? 'not trained yet' :
        Number.isFinite(facts.askedMs) ? `within ${milliseconds(facts.askedMs)}` :
                                         LEVELS[facts.level],
    more(`  ·  ${facts.width} × ${facts.height}`),
    known(facts.at, `  ·  after ${seconds(facts.at)}`),
    known(facts.at, more(' of training')),
    known(facts.step, `  ·  step ${whole(facts.step)}`),
    known(facts.renderMs, `  ·  ${milliseconds(facts.renderMs)}`),
    known(facts.renderMs, more(' rendering')),
    more(`  ·  ${milliseconds(facts.totalMs)} in all`),
    known(facts.samples, more(`  ·  ${compact(facts.samples)} samples`))
  ];
}

/** A picture of as many pixels as are asked for. */
function exact(save) {
  const [width, height] = [['Width', 1920], ['Height', 1080]].map(
      ([label, value]) => h(
          'input', {type: 'number', min: 1, max: 16384, value, 'aria-label': `${label}, pixels`}));
  return h(
      'details', {class: 'exact'}, h('summary', null, 'Exact size'),
      h('div', {class: 'row'}, width, '×', height,
        action(
            'Save', () => save({width: Number(width.value), height: Number(height.value)}),
            {kind: 'small'})));
}

/**
 * W and S forward and back, A and D sideways, Q and E down and up, for as long as they are held.
 */
function flyWithKeys(stage, get, set, radius, signal) {
  const ways =
      {w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], e: [0, 1, 0], q: [0, -1, 0]};
  const held = new Set();
  let last = 0;
  const tick = (now) => {
    if (!held.size || signal.aborted) return;
    const step = (Math.min(100, now - last) / 1000) * 0.8 * radius;
    last = now;
    const [x, y, z] = [...held].reduce((sum, key) => add(sum, ways[key]), [0, 0, 0]);
    set(fly(get(), x * step, y * step, z * step));
    requestAnimationFrame(tick);
  };
  stage.addEventListener('keydown', (event) => {
    const key = event.key.toLowerCase();
    if (event.ctrlKey || event.metaKey || event.altKey || !ways[key]) return;
    event.preventDefault();
    if (held.has(key)) return;
    held.add(key);
    if (held.size > 1) return;
    last = performance.now() - 16;
    requestAnimationFrame(tick);
  }, {signal});
  addEventListener('keyup', (event) => held.delete(event.key.toLowerCase()), {signal});
  stage.addEventListener('blur', () => held.clear(), {signal});
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
      if (select.value) select.value = '';
    },
    /** The view that is shown, if it was chosen here. */
    chosen: () => (select.value ? cameras[Number(select.value)] : null)
  };
}

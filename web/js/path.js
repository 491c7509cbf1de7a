// Camera paths: keys, their order and times, the native document, and a preview of the motion.
import {
  add,
  column,
  dot,
  mix,
  norm,
  poseOfQuaternion,
  quaternionOf,
  scale,
  slerp,
  sub
} from './vector.js';
import {blendOptics, opticsOf, problemOfOptics} from './optics.js';
import {dolly, poseOfOrbit, turn, yawOfPlace} from './orbit.js';

/**
 * @typedef {{id: string, time: number, pose: number[][], fovDeg: number, optics?: any, picture?:
 * Blob}} Key
 * @typedef {{keys: Key[], fps: number, interpolation: 'spline'|'linear'|'circle', tension: number,
 * constantSpeed: boolean, loop: boolean, lens: 'pinhole'|'equirectangular', width: number, height:
 * number}} Path
 */

const STEP_S = 1;
let serial = 0;
const newId = () => `k${Date.now().toString(36)}${serial++}`;

export const emptyPath = (width, height) => ({
  keys: [],
  fps: 24,
  interpolation: 'spline',
  tension: 0,
  constantSpeed: false,
  loop: false,
  lens: 'pinhole',
  width,
  height
});

/** A key one second after the last. */
export function addKey(path, pose, fovDeg, picture) {
  const time = path.keys.length ? path.keys.at(-1).time + STEP_S : 0;
  return {...path, keys: [...path.keys, {id: newId(), time, pose, fovDeg, picture}]};
}

/** A key at a time that no other has, in its place among them. */
export function insertKey(path, time, pose, fovDeg, optics) {
  const keys = [
    ...path.keys.filter((key) => Math.abs(key.time - time) > 1e-6),
    {id: newId(), time, pose, fovDeg, optics}
  ];
  return {...path, keys: keys.sort((a, b) => a.time - b.time)};
}

/** A key at another time; it does not pass its neighbours. The same path where it cannot move. */
export function shiftKey(path, id, time) {
  const at = path.keys.findIndex((key) => key.id === id);
  if (at < 0) return path;
  const gap = 0.02;
  const low = at ? path.keys[at - 1].time + gap : 0;
  const high = path.keys[at + 1] ? path.keys[at + 1].time - gap : 86400;
  const to = Math.max(low, Math.min(high, time));
  return to === path.keys[at].time ? path : changeKey(path, id, {time: to});
}

export const removeKey = (path, id) => ({...path, keys: path.keys.filter((key) => key.id !== id)});

/** Moves a key to another place; the places keep their times. */
export function moveKey(path, id, to) {
  const from = path.keys.findIndex((key) => key.id === id);
  if (from < 0 || to < 0 || to >= path.keys.length || from === to) return path;
  const times = path.keys.map((key) => key.time);
  const keys = [...path.keys];
  keys.splice(to, 0, ...keys.splice(from, 1));
  return {...path, keys: keys.map((key, i) => ({...key, time: times[i]}))};
}

export const changeKey = (path, id, values) =>
    ({...path, keys: path.keys.map((key) => (key.id === id ? {...key, ...values} : key))});

/** Why the daemon would refuse the path, or null. */
export function problemOf(path) {
  if (!path.keys.length) return 'Record at least one key.';
  for (let i = 0; i < path.keys.length; i++) {
    const {time, fovDeg} = path.keys[i];
    if (!(time >= 0)) return `Key ${i + 1}: the time must be 0 s or later.`;
    if (i && !(time > path.keys[i - 1].time))
      return `Key ${i + 1}: its time must be later than that of key ${i}.`;
    if (!(fovDeg > 0 && fovDeg < 180))
      return `Key ${i + 1}: the field of view must lie between 0 and 180 degrees.`;
    const wrong = problemOfOptics(path.keys[i].optics);
    if (wrong) return `Key ${i + 1}: ${wrong}`;
  }
  if (!(path.fps > 0 && path.fps <= 1000)) return 'Frames per second must lie between 0 and 1000.';
  if (!(path.width >= 1 && path.height >= 1)) return 'The picture needs a width and a height.';
  return null;
}

/** Duration of one round in seconds; a loop closes after the mean gap between its keys. */
export function duration(path) {
  const {keys} = path;
  if (keys.length < 2) return 0;
  const span = keys.at(-1).time - keys[0].time;
  return path.loop ? span + span / (keys.length - 1) : span;
}

/** The same keys, two at least, so that one round takes `seconds`. */
export function stretch(path, seconds) {
  const factor = seconds / duration(path);
  const start = path.keys[0].time;
  const keys = path.keys.map((key) => ({...key, time: start + factor * (key.time - start)}));
  return {...path, keys};
}

export const frameCount = (path) => {
  const frames = Math.floor(duration(path) * path.fps + 1e-9);
  return path.loop && path.keys.length > 1 ? Math.max(1, frames) : frames + 1;
};

/** The native document. */
export const documentOf = (path) => ({
  axes: 'opencv',
  fps: path.fps,
  interpolation: path.interpolation,
  ...(path.tension ? {tension: path.tension} : {}),
  ...(path.constantSpeed ? {constant_speed: true} : {}),
  ...(path.lens === 'equirectangular' ? {lens: path.lens} : {}),
  loop: path.loop,
  width: path.width,
  height: path.height,
  keys: path.keys.map(
      ({time, pose, fovDeg, optics}) =>
          ({time, world_from_camera: pose, fov_y_deg: fovDeg, ...opticsOf(optics)})),
});

/** Back from a document, in either axes. */
export function pathOfDocument(document) {
  const sign = document.axes === 'opengl' ? -1 : 1;
  return {
    fps: document.fps ?? 30,
    interpolation: document.interpolation ?? 'spline',
    tension: document.tension ?? 0,
    constantSpeed: Boolean(document.constant_speed),
    loop: Boolean(document.loop),
    lens: document.lens ?? 'pinhole',
    width: document.width,
    height: document.height,
    keys: document.keys.map(
        (key) => ({
          id: newId(),
          time: key.time,
          fovDeg: key.fov_y_deg,
          optics: opticsOf(key),
          pose: key.world_from_camera.map((row) => [row[0], sign * row[1], sign * row[2], row[3]]),
        })),
  };
}

/** A full turn about the orbit's target in `count` keys, closed. */
export function turnTable(path, orbit, count, seconds) {
  const keys =
      Array.from({length: count}, (_, i) => ({
                                    id: newId(),
                                    time: (i * seconds) / count,
                                    pose: poseOfOrbit(turn(orbit, (2 * Math.PI * i) / count, 0)),
                                    fovDeg: orbit.fovDeg
                                  }));
  return {...path, keys, loop: true, interpolation: 'circle'};
}

// ---- ready-made paths ----

const LARGEST_GAP = Math.PI / 2;  // between photographs, that a whole turn flies over
const LEAST_ARC = 0.02;           // less is no way to swing on

/**
 * Where about the orbit's target the photographs were taken: the first yaw and how far the others go, radians; null
 * where that is all around, or one place.
 */
export function photographedArc(orbit, cameras) {
  const yaws = cameras.map(({pose}) => yawOfPlace(orbit, column(pose, 3))).sort((a, b) => a - b);
  let gap = 0;
  let first = 0;
  yaws.forEach((yaw, i) => {
    const next = yaws[i + 1] ?? yaws[0] + 2 * Math.PI;
    if (next - yaw > gap) [gap, first] = [next - yaw, next];
  });
  const arc = 2 * Math.PI - gap;
  return gap <= LARGEST_GAP || arc < LEAST_ARC ? null : {first, arc};
}

/** To the end of what was photographed and back, slowest where it turns; all around where that was. */
function swing(path, orbit, cameras) {
  const seen = photographedArc(orbit, cameras);
  if (!seen) return turnTable(path, orbit, 8, 6);
  const at = (part) => ({...orbit, yaw: seen.first + seen.arc * 0.5 * (1 - Math.cos(2 * Math.PI * part))});
  const count = 16;
  return {
    ...path,
    loop: true,
    interpolation: 'circle',
    keys: orbitKeys(Array.from({length: count}, (_, i) => at(i / count)), 6 - 6 / count)
  };
}

const keysOf = (cameras, seconds) =>
    cameras.map(({pose, fovDeg}, i) => ({
                  id: newId(),
                  time: cameras.length > 1 ? (i * seconds) / (cameras.length - 1) : 0,
                  pose,
                  fovDeg
                }));
const orbitKeys = (orbits, seconds) =>
    keysOf(orbits.map((orbit) => ({pose: poseOfOrbit(orbit), fovDeg: orbit.fovDeg})), seconds);
const sweep = (count, make) => Array.from({length: count}, (_, i) => make(i / (count - 1)));

/** What can be made out of where one stands: name, words, and the path. */
export const PREFABS = [
  ['swing', 'Swing over the photographs', swing],
  ['orbit', 'Whole turn', (path, orbit) => turnTable(path, orbit, 8, 6)],
  [
    'arc', 'Arc', (path, orbit) => ({
                    ...path,
                    loop: false,
                    interpolation: 'circle',
                    keys: orbitKeys(sweep(5, (t) => turn(orbit, ((t - 0.5) * Math.PI) / 2, 0)), 4)
                  })
  ],
  [
    'spiral', 'Spiral',
    (path, orbit) => ({
      ...path,
      loop: false,
      interpolation: 'spline',
      keys: orbitKeys(
          sweep(
              13,
              (t) =>
                  dolly(turn({...orbit, pitch: -0.1}, 3 * Math.PI * t, 1.1 * t), 1.25 - 0.5 * t)),
          9)
    })
  ],
  [
    'dolly-zoom', 'Dolly zoom',
    (path, orbit) => ({
      ...path,
      loop: false,
      interpolation: 'linear',
      keys: orbitKeys(sweep(9, (t) => dollyZoom(orbit, 1.8 - 1.2 * t)), 4)
    })
  ],
  ['photographs', 'Through the photographs', null],
];

/** Nearer by a factor and wider, so that the target stays as large. @param {Orbit} orbit */
function dollyZoom(orbit, factor) {
  const half = Math.tan((orbit.fovDeg * Math.PI) / 360) / factor;
  return {...dolly(orbit, factor), fovDeg: (Math.atan(half) * 360) / Math.PI};
}

/** Through up to `most` of the photographs' cameras, evenly taken. */
export function throughCameras(path, cameras, most = 24) {
  const step = Math.max(1, cameras.length / most);
  const chosen =
      Array.from({length: Math.min(most, cameras.length)}, (_, i) => cameras[Math.floor(i * step)]);
  return {...path, loop: false, interpolation: 'spline', keys: keysOf(chosen, chosen.length - 1)};
}

// ---- undo ----

/** Steps back and forth over values that are never changed in place. */
export function createHistory(limit = 200) {
  let past = [];
  let future = [];
  return {
    /**
     * Notes what was before a change; changes with the same `word` within a second are one, with the
     * same object, such as a drag, however long that takes.
     */
    note(before, word, now = Date.now()) {
      const last = past.at(-1);
      const isOne = last && word && last.word === word;
      if (!(isOne && (typeof word === 'object' || now - last.at < 1000)))
        past = [...past, {value: before, word, at: now}].slice(-limit);
      else
        last.at = now;
      future = [];
    },
    undo(now) {
      const last = past.pop();
      if (!last) return null;
      future.push(now);
      return last.value;
    },
    redo(now) {
      const next = future.pop();
      if (!next) return null;
      past.push({value: now, word: '', at: 0});
      return next;
    },
    canUndo: () => past.length > 0,
    canRedo: () => future.length > 0,
  };
}

// ---- between keys ----

/** Centripetal Catmull-Rom from b to c as a cubic with the daemon's tangents, tension applied. */
function spline([a, b, c, d], tension, u) {
  const gap = (p, q) => Math.sqrt(Math.hypot(...p.map((x, i) => x - q[i])));
  const step = [gap(a, b), gap(b, c), gap(c, d)];
  if (!(step[1] > 0)) return mix(b, c, u);
  const [u2, u3] = [u * u, u * u * u];
  return b.map((_, i) => {
    const chord = c[i] - b[i];
    let [begin, end] = [chord, chord];
    if (step[0] > 0)
      begin += step[1] * ((b[i] - a[i]) / step[0] - (c[i] - a[i]) / (step[0] + step[1]));
    if (step[2] > 0)
      end += step[1] * ((d[i] - c[i]) / step[2] - (d[i] - b[i]) / (step[1] + step[2]));
    return b[i] + (3 * u2 - 2 * u3) * chord +
        ((u3 - 2 * u2 + u) * begin + (u3 - u2) * end) * (1 - tension);
  });
}

/** The point nearest to all lines of sight; null when they are parallel. */
export function centreOf(keys) {
  const m = [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]];
  for (const {pose} of keys) {
    const [forward, eye] = [column(pose, 2), column(pose, 3)];
    for (let i = 0; i < 3; i++)
      for (let j = 0; j < 3; j++) {
        const part = (i === j ? 1 : 0) - forward[i] * forward[j];
        m[i][j] += part;
        m[i][3] += part * eye[j];
      }
  }
  for (let i = 0; i < 3; i++) {
    if (!(m[i][i] > 1e-6 * keys.length)) return null;
    for (let r = i + 1; r < 3; r++) {
      const factor = m[r][i] / m[i][i];
      for (let c = i; c < 4; c++) m[r][c] -= factor * m[i][c];
    }
  }
  const centre = [0, 0, 0];
  for (let i = 2; i >= 0; i--) {
    centre[i] = m[i][3];
    for (let c = i + 1; c < 3; c++) centre[i] -= m[i][c] * centre[c];
    centre[i] /= m[i][i];
  }
  return centre;
}

/** Along the arc from p to q about the centre, or null where there is none. */
function arc(centre, p, q, u) {
  const [a, b] = [sub(p, centre), sub(q, centre)];
  const [ra, rb] = [norm(a), norm(b)];
  if (!(ra > 0 && rb > 0)) return null;
  const angle = Math.acos(Math.max(-1, Math.min(1, dot(a, b) / (ra * rb))));
  if (angle > 3.1) return null;
  const sine = Math.sin(angle);
  const [wa, wb] =
      sine > 1e-9 ? [Math.sin((1 - u) * angle) / sine, Math.sin(u * angle) / sine] : [1 - u, u];
  const r = ra + (rb - ra) * u;
  return add(centre, add(scale(a, (r * wa) / ra), scale(b, (r * wb) / rb)));
}

/** From key `i` to the next, a loop's last one to the first: four keys about it, and where, 0 .. 1. */
function segmentAfter(path, i, u) {
  const {keys} = path;
  const last = keys.length - 1;
  const neighbour = (j) =>
      keys[path.loop ? (j + keys.length) % keys.length : Math.min(last, Math.max(0, j))];
  return {four: [neighbour(i - 1), keys[i], neighbour(i + 1), neighbour(i + 2)], u};
}

/** Which keys a time lies between, and where. */
function segmentAt(path, time) {
  const {keys} = path;
  const last = keys.length - 1;
  let i = 0;
  while (i < last && keys[i + 1].time - keys[0].time <= time) i++;
  if (i === last && !path.loop || keys.length === 1)
    return {four: [keys[i], keys[i], keys[i], keys[i]], u: 0};
  const [begin, end] = stretchOf(path, i);
  return segmentAfter(path, i, Math.min(1, (time - begin) / (end - begin)));
}

const ways = new WeakMap();  // what is worked out once for each path
function wayOf(path) {
  if (!ways.has(path)) {
    const way = {
      centre: path.interpolation === 'circle' ? centreOf(path.keys) : null,
      travelled: []
    };
    ways.set(path, way);
    if (path.constantSpeed && path.keys.length > 1) way.travelled = measureWay(path);
  }
  return ways.get(path);
}

function positionOn(path, {four, u}) {
  const points = four.map((key) => column(key.pose, 3));
  const {centre} = wayOf(path);
  if (path.interpolation === 'circle' && centre) {
    const found = arc(centre, points[1], points[2], u);
    if (found) return found;
  }
  return path.interpolation === 'spline' ? spline(points, path.tension ?? 0, u) :
                                           mix(points[1], points[2], u);
}

const PARTS = 32;  // of each stretch between keys, for its length

/** When the stretch that begins at key `i` begins and ends, seconds from the first key. */
const stretchOf = (path, i) =>
    [path.keys[i].time - path.keys[0].time,
     path.keys[i + 1] ? path.keys[i + 1].time - path.keys[0].time : duration(path)];

function measureWay(path) {
  const count = PARTS * (path.keys.length - (path.loop ? 0 : 1));
  let before = column(path.keys[0].pose, 3);
  let length = 0;
  return Array.from({length: count + 1}, (_, i) => {
    const stretch = Math.floor(Math.min(i, count - 1) / PARTS);
    const now = positionOn(path, segmentAfter(path, stretch, i / PARTS - stretch));
    length += norm(sub(now, before));
    before = now;
    return length;
  });
}

/** The time of the keys' clock at which the camera has travelled as far as it should have. */
export function timeOfWay(path, time) {
  const {travelled} = wayOf(path);
  const all = travelled.at(-1);
  if (!path.constantSpeed || !(all > 0)) return time;
  const wanted = Math.min(1, time / duration(path)) * all;
  let high = travelled.findIndex((x, i) => i && x > wanted);
  if (high < 0) high = travelled.length - 1;
  const step = travelled[high] - travelled[high - 1];
  const part = step > 0 ? (wanted - travelled[high - 1]) / step : 0;
  const stretch = Math.floor((high - 1) / PARTS);
  const u = (high - 1 + Math.min(part, 1)) / PARTS - stretch;
  return mix([stretchOf(path, stretch)[0]], [stretchOf(path, stretch)[1]], u)[0];
}

/** When the camera passes a key, seconds from the first. */
export function momentOf(path, index) {
  const {travelled} = wayOf(path);
  const all = travelled.at(-1);
  if (!path.constantSpeed || !(all > 0)) return path.keys[index].time - path.keys[0].time;
  return (duration(path) * travelled[PARTS * index]) / all;
}

/**
 * The camera at `time` seconds from the first key. The daemon's frames follow the same positions
 * and turn a little more smoothly.
 * @param {Path} path @returns {{pose: number[][], fovDeg: number, optics?: any}}
 */
export function cameraAt(path, time) {
  if (path.keys.length === 1) return path.keys[0];
  const at = timeOfWay(path, time);
  const {four, u} = segmentAt(path, at);
  return {
    pose: poseOfQuaternion(
        slerp(quaternionOf(four[1].pose), quaternionOf(four[2].pose), u), positionOn(path, {four, u})),
    fovDeg: mix([four[1].fovDeg], [four[2].fovDeg], u)[0],
    optics: blendOptics(four[1].optics, four[2].optics, u),
  };
}

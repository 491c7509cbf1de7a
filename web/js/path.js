// Camera paths: keys, their order and times, the native document, and a preview of the motion.
import {column, mix, poseOfQuaternion, quaternionOf, slerp} from './vector.js';
import {poseOfOrbit, turn} from './orbit.js';

/**
 * @typedef {{id: string, time: number, pose: number[][], fovDeg: number, picture?: Blob}} Key
 * @typedef {{keys: Key[], fps: number, interpolation: 'spline'|'linear', loop: boolean, width:
 * number, height: number}} Path
 */

const STEP_S = 1;
let serial = 0;
const newId = () => `k${Date.now().toString(36)}${serial++}`;

export const emptyPath = (width, height) =>
    ({keys: [], fps: 24, interpolation: 'spline', loop: false, width, height});

/** A key one second after the last. */
export function addKey(path, pose, fovDeg, picture) {
  const time = path.keys.length ? path.keys.at(-1).time + STEP_S : 0;
  return {...path, keys: [...path.keys, {id: newId(), time, pose, fovDeg, picture}]};
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

export const frameCount = (path) => {
  const frames = Math.floor(duration(path) * path.fps + 1e-9);
  return path.loop && path.keys.length > 1 ? Math.max(1, frames) : frames + 1;
};

/** The native document. */
export const documentOf = (path) => ({
  axes: 'opencv',
  fps: path.fps,
  interpolation: path.interpolation,
  loop: path.loop,
  width: path.width,
  height: path.height,
  keys:
      path.keys.map(({time, pose, fovDeg}) => ({time, world_from_camera: pose, fov_y_deg: fovDeg})),
});

/** Back from a document, in either axes. */
export function pathOfDocument(document) {
  const sign = document.axes === 'opengl' ? -1 : 1;
  return {
    fps: document.fps ?? 30,
    interpolation: document.interpolation ?? 'spline',
    loop: Boolean(document.loop),
    width: document.width,
    height: document.height,
    keys: document.keys.map(
        (key) => ({
          id: newId(),
          time: key.time,
          fovDeg: key.fov_y_deg,
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
  return {...path, keys, loop: true};
}

/** Centripetal Catmull-Rom through b and c. */
function spline(a, b, c, d, t) {
  const gap = (p, q) => Math.max(1e-6, Math.sqrt(Math.hypot(...p.map((x, i) => x - q[i]))));
  const [t1, t2, t3] = [gap(a, b), gap(a, b) + gap(b, c), gap(a, b) + gap(b, c) + gap(c, d)];
  const at = t1 + t * (t2 - t1);
  const a1 = mix(a, b, at / t1);
  const a2 = mix(b, c, (at - t1) / (t2 - t1));
  const a3 = mix(c, d, (at - t2) / (t3 - t2));
  return mix(mix(a1, a2, at / t2), mix(a2, a3, (at - t1) / (t3 - t1)), (at - t1) / (t2 - t1));
}

/**
 * The camera at `time` seconds from the first key. For the preview: the daemon's own frames follow
 * the same positions and turn a little more smoothly.
 * @param {Path} path @returns {{pose: number[][], fovDeg: number}}
 */
export function cameraAt(path, time) {
  const {keys} = path;
  const start = keys[0].time;
  const last = keys.length - 1;
  let i = 0;
  while (i < last && keys[i + 1].time - start <= time) i++;
  if (i === last && !path.loop || keys.length === 1) return keys[i];
  const next = (i + 1) % keys.length;
  const end = next ? keys[next].time - start : duration(path);
  const t = Math.min(1, (time - (keys[i].time - start)) / (end - (keys[i].time - start)));
  const neighbour = (j) =>
      keys[path.loop ? (j + keys.length) % keys.length : Math.min(last, Math.max(0, j))];
  const four = [neighbour(i - 1), keys[i], keys[next], neighbour(i + 2)];
  const position = path.interpolation === 'linear' ?
      mix(column(four[1].pose, 3), column(four[2].pose, 3), t) :
      spline(...four.map((key) => column(key.pose, 3)), t);
  return {
    pose: poseOfQuaternion(
        slerp(quaternionOf(four[1].pose), quaternionOf(four[2].pose), t), position),
    fovDeg: mix([four[1].fovDeg], [four[2].fovDeg], t)[0],
  };
}

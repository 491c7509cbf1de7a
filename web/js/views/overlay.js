// The camera path and the photographs' cameras, drawn over the picture of the scene.
import {cameraAt, duration} from '../path.js';
import {column, dot, norm, sub} from '../vector.js';
import {edgesOf} from './crop.js';

const STEPS = 160;
const CAMERA_SIZE = 0.14;  // of a drawn camera, in radii of the scene

/** Where points of the dataset fall in a picture of width x height; null behind the camera. */
export function projector(pose, fovDeg, width, height) {
  const [right, down, forward, eye] = [0, 1, 2, 3].map((j) => column(pose, j));
  const focal = height / 2 / Math.tan((fovDeg * Math.PI) / 360);
  return (point) => {
    const to = sub(point, eye);
    const depth = dot(to, forward);
    if (!(depth > 1e-4)) return null;
    return [
      width / 2 + (focal * dot(to, right)) / depth, height / 2 + (focal * dot(to, down)) / depth
    ];
  };
}

/** The corners of a camera's picture at a distance from it. */
function corners(pose, fovDeg, aspect, size) {
  const half = Math.tan((fovDeg * Math.PI) / 360);
  return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(
      ([x, y]) => [0, 1, 2].map(
          (i) => pose[i][3] +
              size * (pose[i][2] + half * (x * aspect * pose[i][0] + y * pose[i][1]))));
}

function line(context, points, closed) {
  let open = false;
  context.beginPath();
  for (const at of closed ? [...points, points[0]] : points) {
    if (at && open) context.lineTo(at[0], at[1]);
    if (at && !open) context.moveTo(at[0], at[1]);
    open = Boolean(at);
  }
  context.stroke();
}

/** One through which the reader looks hides the picture: it is left out. */
const isNear = (a, b, size) => norm(sub(column(a, 3), column(b, 3))) < 1.5 * size;

function drawCamera(context, project, {pose, fovDeg}, aspect, size) {
  const eye = project(column(pose, 3));
  const frame = corners(pose, fovDeg, aspect, size).map(project);
  line(context, frame, true);
  for (const corner of frame) line(context, [eye, corner]);
}

const REACH = 14;  // pixels about a drawn camera's eye that mean it

/**
 * The camera whose eye is drawn nearest to a point of the picture, or null where none is within
 * reach. @param {{pose: number[][]}[]} items @param {{pose: number[][], fovDeg: number}} camera that
 *     looks @param {number} radius the scene's @param {number[]} point pixels
 */
export function cameraNear(items, camera, radius, {width, height}, [x, y]) {
  const project = projector(camera.pose, camera.fovDeg, width, height);
  let [best, found] = [REACH, null];
  for (const item of items) {
    if (isNear(item.pose, camera.pose, CAMERA_SIZE * radius)) continue;
    const at = project(column(item.pose, 3));
    const away = at ? Math.hypot(at[0] - x, at[1] - y) : Infinity;
    if (away < best) [best, found] = [away, item];
  }
  return found;
}

/**
 * @param {HTMLCanvasElement} canvas over the picture
 * @param {{pose: number[][], fovDeg: number}} camera that looks
 * @param {{path: any, selected: string|null, time: number|null, photographs: {pose: number[][],
 *     fovDeg: number, colour?: string}[], radius: number, crop?: number[]|null}} things
 */
export function drawOverlay(canvas, camera, {path, selected, time, photographs, radius, crop}) {
  canvas.hidden = !photographs.length && !crop && !path?.keys.length;
  if (canvas.hidden) return;  // a layer less for the browser to put together
  const ratio = devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const context = canvas.getContext('2d');
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  const project = projector(camera.pose, camera.fovDeg, width, height);
  const size = CAMERA_SIZE * radius;
  context.lineJoin = 'round';
  context.lineWidth = 1;
  const away = (item) => !isNear(item.pose, camera.pose, size);
  for (const item of photographs.filter(away)) {
    context.strokeStyle = item.colour ?? 'rgb(120 130 140 / 75%)';
    drawCamera(context, project, item, 1, 0.6 * size);
  }
  context.strokeStyle = 'rgb(217 72 15 / 80%)';
  for (const [a, b] of crop ? edgesOf(crop) : []) line(context, [project(a), project(b)]);
  if (!path?.keys.length) return;
  const whole = duration(path);
  const aspect = path.width / path.height || 1;
  if (whole > 0) {
    const way = Array.from(
        {length: STEPS + 1},
        (_, i) => project(column(cameraAt(path, (whole * i) / STEPS).pose, 3)));
    context.lineWidth = 4;
    context.strokeStyle = 'rgb(255 255 255 / 80%)';
    line(context, way, path.loop);
    context.lineWidth = 2;
    context.strokeStyle = '#1668b8';
    line(context, way, path.loop);
  }
  for (const key of path.keys.filter(away)) {
    const chosen = key.id === selected;
    context.lineWidth = chosen ? 2 : 1.25;
    context.strokeStyle = chosen ? '#d9480f' : '#1668b8';
    drawCamera(context, project, key, aspect, size);
  }
  if (time !== null && whole > 0) {
    context.lineWidth = 2;
    context.strokeStyle = '#2b8a3e';
    const now = cameraAt(path, time);
    if (away(now)) drawCamera(context, project, now, aspect, 1.2 * size);
  }
}

// The sparse points of a dataset, and where its photographs were taken from: to turn with the mouse
// or the arrow keys.
import {api} from '../api.js';
import {fill, h} from '../dom.js';
import {plural} from '../format.js';
import {fovOf, openCvPose, poseOfOrbit, upOf} from '../orbit.js';
import {panel} from '../ui.js';
import {drawOverlay, projector} from './overlay.js';

const FOV_DEG = 45;
const TURN = 0.01;     // radians a pixel that the mouse moves
const KEY_TURN = 0.1;  // radians a key
const KEYS = {
  ArrowLeft: [1, 0],
  ArrowRight: [-1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1]
};

function drawPoints(canvas, camera, points) {
  const context = canvas.getContext('2d');
  const project = projector(camera.pose, camera.fovDeg, canvas.clientWidth, canvas.clientHeight);
  for (const [x, y, z, ...colour] of points) {
    const at = project([x, y, z]);
    if (!at) continue;
    context.fillStyle = `rgb(${colour.join(' ')})`;
    context.fillRect(at[0], at[1], 1.5, 1.5);
  }
}

/** How far from the bounds' centre the cameras are: so large a share of them is nearer. */
function distanceOf(photographs, centre, share) {
  const all = photographs.map(({pose}) => Math.hypot(...centre.map((c, i) => pose[i][3] - c)))
                  .sort((a, b) => a - b);
  return all[Math.floor(share * all.length)] || 1;
}

/** Between all cameras: what a plot without points is of. */
export const middleOf = (items) => [0, 1, 2].map(
    (i) => items.reduce((sum, {camera}) => sum + openCvPose(camera)[i][3], 0) / items.length);

/** What marks a split in the plot, and in its legend. */
export const SPLIT_COLOURS = {
  train: '#1668b8',
  val: '#8a6d00',
  test: '#d9480f'
};

/**
 * A plot of cameras and points, to turn. @param {any} space bounds, and up where it is known
 * @param {any[]} items {camera, split} @param {AbortSignal} signal
 */
export function cameraPlot({bounds, up}, items, signal) {
  const photographs = items.map(
      ({camera, split}) =>
          ({pose: openCvPose(camera), fovDeg: fovOf(camera), colour: SPLIT_COLOURS[split]}));
  const away = distanceOf(photographs, bounds.centre, 0.5);
  const orbit = {
    target: bounds.centre,
    distance: Math.max(2.5 * away, 2.8 * distanceOf(photographs, bounds.centre, 0.95)),  // all in sight
    yaw: 0.6,
    pitch: 0.5,
    up: up ?? upOf(items.map(({camera}) => camera)),
    fovDeg: FOV_DEG
  };
  const canvas = h('canvas', {
    class: 'cloud',
    tabindex: 0,
    role: 'img',
    'aria-label': 'Sparse points and cameras; arrow keys turn them'
  });
  let points = [];
  const draw = () => {
    const camera = {pose: poseOfOrbit(orbit), fovDeg: FOV_DEG};
    drawOverlay(
        canvas, camera, {path: null, selected: null, time: null, photographs, radius: 0.4 * away});
    drawPoints(canvas, camera, points);
  };
  const turn = (yaw, pitch) => {
    orbit.yaw += yaw;
    orbit.pitch = Math.max(-1.5, Math.min(1.5, orbit.pitch + pitch));
    draw();
  };
  canvas.addEventListener('pointerdown', (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener(
      'pointermove',
      (event) => event.buttons && turn(-TURN * event.movementX, TURN * event.movementY));
  canvas.addEventListener('keydown', (event) => {
    if (!KEYS[event.key]) return;
    event.preventDefault();
    turn(...KEYS[event.key].map((k) => k * KEY_TURN));
  });
  const sizes = new ResizeObserver(draw);
  sizes.observe(canvas);
  signal.addEventListener('abort', () => sizes.disconnect());
  return {
    node: canvas,
    show: (found) => {
      points = found;
      draw();
    }
  };
}

/**
 * A panel that fills once the points are there; empty where none came with the dataset.
 * @param {any} dataset @param {any[]} cameras @param {AbortSignal} signal
 */
export function cloudPanel(dataset, cameras, signal) {
  const node = h('div', {hidden: true});
  const finest = cameras.filter((item) => item.scale === 0);
  const plot = cameraPlot(dataset, finest, signal);
  api.points(dataset.id, signal)
      .then(({count, items}) => {
        if (!count) return;
        fill(
            node,
            panel(
                'Sparse points', null, plot.node,
                h('p', {class: 'quiet'},
                  `${plural(count, 'point')}${
                      count > items.length ?
                          `, ${items.length} of them shown` :
                          ''}, ${plural(finest.length, 'camera')}; drag to turn`)));
        node.hidden = false;
        plot.show(items);
      })
      .catch(() => {});  // there is nothing to draw, then
  return node;
}

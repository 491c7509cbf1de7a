// A camera that turns about a target: pure functions over a plain state, and the input that drives
// it.
import {add, column, cross, dot, norm, poseOf, scale, sub, unit} from './vector.js';

const MAX_PITCH = (89.5 * Math.PI) / 180;

/**
 * Angles in radians, lengths in dataset units; `up` is a unit vector.
 * @typedef {{target: number[], distance: number, yaw: number, pitch: number, up: number[], fovDeg:
 * number}} Orbit
 */

/** Two axes that complete `up` to a right-handed frame, the first as near to world x as can be. */
function ground(up) {
  const seed = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const first = unit(sub(seed, scale(up, dot(seed, up))));
  return [first, cross(up, first)];
}

/** From the target towards the eye. */
function outward({yaw, pitch, up}) {
  const [a, b] = ground(up);
  const flat = add(scale(a, Math.cos(yaw)), scale(b, Math.sin(yaw)));
  return add(scale(flat, Math.cos(pitch)), scale(up, Math.sin(pitch)));
}

/** Where about the target a place lies, radians. @param {Orbit} orbit */
export function yawOfPlace({target, up}, place) {
  const [a, b] = ground(up);
  const out = sub(place, target);
  return Math.atan2(dot(out, b), dot(out, a));
}

/** world-from-camera, 3x4, OpenCV axes. @param {Orbit} orbit */
export function poseOfOrbit(orbit) {
  const out = outward(orbit);
  const forward = scale(out, -1);
  const right = unit(cross(forward, orbit.up));
  return poseOf(
      right, cross(forward, right), forward, add(orbit.target, scale(out, orbit.distance)));
}

/** A native camera object for a picture of the given size. @param {Orbit} orbit */
export const cameraOf = (orbit, width, height) => ({
  world_from_camera: poseOfOrbit(orbit),
  axes: 'opencv',
  width,
  height,
  fov_y_deg: orbit.fovDeg
});

/** A native camera that sees all around, as a path's equirectangular frames do. */
export const aroundCamera = (pose, width, height) => ({
  world_from_camera: pose,
  axes: 'opencv',
  width,
  height,
  fx: width / (2 * Math.PI),
  fy: height / Math.PI,
  cx: width / 2,
  cy: height / 2,
  lens: {model: 'equirectangular'}
});

/** A camera's pose in OpenCV axes, whatever axes it is given in. */
export function openCvPose(camera) {
  const sign = camera.axes === 'opengl' ? -1 : 1;
  return camera.world_from_camera.slice(0, 3).map(
      (row) => [row[0], sign * row[1], sign * row[2], row[3]]);
}

/** Vertical field of view in degrees. */
export const fovOf = (camera) =>
    camera.fov_y_deg ?? (2 * Math.atan(camera.height / 2 / camera.fy) * 180) / Math.PI;

/**
 * The mean of the cameras' up directions; an axis of the world where it is within 25 degrees of
 * one.
 */
export function upOf(cameras) {
  let sum = [0, 0, 0];
  for (const camera of cameras) sum = sub(sum, column(openCvPose(camera), 1));
  if (norm(sum) < 1e-6) return [0, 0, 1];
  const up = unit(sum);
  for (const axis of [[0, 0, 1], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, -1]]) {
    if (dot(up, axis) > Math.cos((25 * Math.PI) / 180)) return axis;
  }
  return up;
}

/**
 * The orbit whose camera is (but for roll) the given one; its target is near the bounds' centre.
 */
export function orbitOfPose(pose, fovDeg, up, bounds) {
  const eye = column(pose, 3);
  const forward = unit(column(pose, 2));
  const distance = Math.max(0.1 * bounds.radius, dot(sub(bounds.centre, eye), forward));
  const out = scale(forward, -1);
  const [a, b] = ground(up);
  return {
    target: add(eye, scale(forward, distance)),
    distance,
    up,
    fovDeg,
    yaw: Math.atan2(dot(out, b), dot(out, a)),
    pitch: clamp(Math.asin(clamp(dot(out, up), -1, 1)), -MAX_PITCH, MAX_PITCH),
  };
}

/** Heading, tilt and roll of a pose, radians; heading and tilt are those towards which it looks. */
export function anglesOfPose(pose, up) {
  const forward = unit(column(pose, 2));
  const [a, b] = ground(up);
  const level = unit(cross(forward, up));
  const right = column(pose, 0);
  return {
    yaw: Math.atan2(dot(forward, b), dot(forward, a)),
    pitch: Math.asin(clamp(dot(forward, up), -1, 1)),
    roll: Math.atan2(dot(cross(level, right), forward), dot(level, right)),
  };
}

/** The other way, at a place. */
export function poseOfAngles({yaw, pitch, roll}, place, up) {
  const [a, b] = ground(up);
  const tilt = clamp(pitch, -MAX_PITCH, MAX_PITCH);
  const flat = add(scale(a, Math.cos(yaw)), scale(b, Math.sin(yaw)));
  const forward = add(scale(flat, Math.cos(tilt)), scale(up, Math.sin(tilt)));
  const level = unit(cross(forward, up));
  const under = cross(forward, level);
  const right = add(scale(level, Math.cos(roll)), scale(under, Math.sin(roll)));
  return poseOf(right, cross(forward, right), forward, place);
}

/** Moves camera and target together: right, up and forward in dataset units. */
export function fly(orbit, right, upward, forward) {
  const pose = poseOfOrbit(orbit);
  const by = add(
      add(scale(column(pose, 0), right), scale(orbit.up, upward)), scale(column(pose, 2), forward));
  return {...orbit, target: add(orbit.target, by)};
}

/** The eye stays, the target comes to a point: what is double-clicked is looked at. */
export function lookAt(orbit, point) {
  const eye = column(poseOfOrbit(orbit), 3);
  const out = sub(eye, point);
  const distance = norm(out);
  if (!(distance > 1e-6)) return orbit;
  const [a, b] = ground(orbit.up);
  const unitOut = scale(out, 1 / distance);
  return {
    ...orbit,
    target: point,
    distance,
    yaw: Math.atan2(dot(unitOut, b), dot(unitOut, a)),
    pitch: clamp(Math.asin(clamp(dot(unitOut, orbit.up), -1, 1)), -MAX_PITCH, MAX_PITCH)
  };
}

/** The orbit at a camera of the API. */
export const orbitOfCamera = (camera, up, bounds) =>
    orbitOfPose(openCvPose(camera), fovOf(camera), up, bounds);

/**
 * Where to begin without cameras: outside the bounds, a little above; within those that hold the cameras, which are
 * of a place whose walls would hide it.
 */
export function defaultOrbit({centre, radius, source}, up = [0, 0, 1]) {
  const within = source === 'cameras';
  return {
    target: [...centre],
    distance: (within ? 0.65 : 2.7) * radius,
    yaw: -0.9,
    pitch: within ? 0.1 : 0.45,
    up,
    fovDeg: within ? 60 : 40
  };
}

/** A camera as a short word for an address, and back: target, distance, heading, tilt, lens. */
export const wordOfOrbit =
    ({target, distance, yaw, pitch, fovDeg}) => [...target, distance, yaw, pitch, fovDeg]
                                                    .map((x) => Number(x.toPrecision(6)))
                                                    .join('_');
export function orbitOfWord(word, up) {
  const numbers = (word ?? '').split('_').map(Number);
  if (numbers.length !== 7 || numbers.some((x) => !Number.isFinite(x))) return null;
  const [x, y, z, distance, yaw, pitch, fovDeg] = numbers;
  if (!(distance > 0 && fovDeg > 0 && fovDeg < 180)) return null;
  return {target: [x, y, z], distance, yaw, pitch: clamp(pitch, -MAX_PITCH, MAX_PITCH), up, fovDeg};
}

const clamp = (x, low, high) => Math.min(high, Math.max(low, x));

export const turn = (orbit, dYaw, dPitch) =>
    ({...orbit, yaw: orbit.yaw + dYaw, pitch: clamp(orbit.pitch + dPitch, -MAX_PITCH, MAX_PITCH)});
export const dolly = (orbit, factor) =>
    ({...orbit, distance: clamp(orbit.distance * factor, 1e-3, 1e6)});

/** Moves the target in the picture's plane by a share of its height. */
export function pan(orbit, dx, dy) {
  const pose = poseOfOrbit(orbit);
  const height = 2 * orbit.distance * Math.tan((orbit.fovDeg * Math.PI) / 360);
  const shift = add(scale(column(pose, 0), -dx * height), scale(column(pose, 1), -dy * height));
  return {...orbit, target: add(orbit.target, shift)};
}

/** What a key does to an orbit, or null. @param {KeyboardEvent} event @param {Orbit} orbit */
export function keyMove(event, orbit) {
  if (event.ctrlKey || event.metaKey || event.altKey) return null;
  const step = (4 * Math.PI) / 180;
  const [x, y] =
      {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[event.key] ??
      [0, 0];
  if (x || y)
    return event.shiftKey ? pan(orbit, -x * 0.04, y * 0.04) : turn(orbit, x * step, y * step);
  if (event.key === '+' || event.key === '=') return dolly(orbit, 1 / 1.08);
  if (event.key === '-' || event.key === '_') return dolly(orbit, 1.08);
  return null;
}

/**
 * Drag turns, a second button, Shift or two fingers pan, wheel and pinch come nearer.
 * @param {HTMLElement} element @param {() => Orbit} get @param {(orbit: Orbit) => void} set
 * @param {AbortSignal} signal
 */
export function listen(element, get, set, signal) {
  const fingers = new Map();
  const options = {signal};
  element.addEventListener('pointerdown', (event) => {
    if (event.target.closest('[data-own]')) return;
    if (event.pointerType === 'mouse' && event.button > 2) return;
    element.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  }, options);
  const moved = (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const size = element.clientHeight || 1;
    const [dx, dy] = [(now[0] - before[0]) / size, (now[1] - before[1]) / size];
    if (!dx && !dy) return;  // the second event of one movement
    if (fingers.size === 2)
      set(pinch(get(), fingers, event.pointerId, now, dx, dy));
    else if (event.shiftKey || event.buttons & 6)
      set(pan(get(), dx, dy));
    else
      set(turn(get(), -dx * Math.PI, dy * Math.PI));
    fingers.set(event.pointerId, now);
  };
  // The first comes at once, the second with the browser's next frame.
  for (const type of ['pointerrawupdate', 'pointermove'])
    element.addEventListener(type, moved, options);
  for (const type of ['pointerup', 'pointercancel'])
    element.addEventListener(type, (event) => fingers.delete(event.pointerId), options);
  element.addEventListener('contextmenu', (event) => event.preventDefault(), options);
  element.addEventListener('wheel', (event) => {
    event.preventDefault();
    set(dolly(get(), Math.exp(clamp(event.deltaY, -240, 240) * 0.0012)));
  }, {signal, passive: false});
  element.addEventListener('keydown', (event) => {
    const moved = keyMove(event, get());
    if (!moved) return;
    event.preventDefault();
    set(moved);
  }, options);
}

function pinch(orbit, fingers, id, now, dx, dy) {
  const [other] = [...fingers].filter(([key]) => key !== id).map(([, at]) => at);
  const before = fingers.get(id);
  const gap = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]) || 1;
  return pan(dolly(orbit, gap(before) / gap(now)), dx / 2, dy / 2);
}

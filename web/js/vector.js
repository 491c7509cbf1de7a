// Three-vectors, 3x3 rotations and quaternions: plain arrays, pure functions.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross =
    (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);
export const unit = (a) => scale(a, 1 / (norm(a) || 1));
export const mix = (a, b, t) => a.map((x, i) => x + (b[i] - x) * t);

/** Column `j` of a 3x4 pose. */
export const column = (pose, j) => [pose[0][j], pose[1][j], pose[2][j]];
/** A 3x4 pose from its columns right, down, forward and position. */
export const poseOf = (x, y, z, t) => [0, 1, 2].map((i) => [x[i], y[i], z[i], t[i]]);

/** Unit quaternion [w, x, y, z] of a pose's rotation. */
export function quaternionOf(m) {
  const trace = m[0][0] + m[1][1] + m[2][2];
  if (trace > 0) {
    const k = 2 * Math.sqrt(trace + 1);
    return [k / 4, (m[2][1] - m[1][2]) / k, (m[0][2] - m[2][0]) / k, (m[1][0] - m[0][1]) / k];
  }
  const i = m[0][0] > m[1][1] && m[0][0] > m[2][2] ? 0 : m[1][1] > m[2][2] ? 1 : 2;
  const [j, l] = [(i + 1) % 3, (i + 2) % 3];
  const k = 2 * Math.sqrt(1 + m[i][i] - m[j][j] - m[l][l]);
  const q = [(m[l][j] - m[j][l]) / k, 0, 0, 0];
  q[1 + i] = k / 4;
  q[1 + j] = (m[j][i] + m[i][j]) / k;
  q[1 + l] = (m[l][i] + m[i][l]) / k;
  return q;
}

/** 3x4 pose of a unit quaternion and a position. */
export function poseOfQuaternion([w, x, y, z], t) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), t[0]],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), t[1]],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), t[2]],
  ];
}

/** Spherical interpolation along the shorter arc. */
export function slerp(a, b, t) {
  let cosine = a.reduce((sum, x, i) => sum + x * b[i], 0);
  const sign = cosine < 0 ? -1 : 1;
  cosine = Math.min(1, Math.abs(cosine));
  const angle = Math.acos(cosine);
  const weights = angle < 1e-6 ?
      [1 - t, t] :
      [Math.sin((1 - t) * angle) / Math.sin(angle), Math.sin(t * angle) / Math.sin(angle)];
  const q = a.map((x, i) => weights[0] * x + weights[1] * sign * b[i]);
  const length = Math.hypot(...q);
  return q.map((x) => x / length);
}

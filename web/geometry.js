// @ts-check
// Rigid motions. Names are `a_from_b` as everywhere in posed: they map points of frame b to frame a. Metres.

/** @typedef {[number, number]} Vec2 */
/** @typedef {[number, number, number]} Vec3 */
/** Rows. @typedef {[Vec3, Vec3, Vec3]} Mat3 */
/** @typedef {{rotation: Mat3, translation: Vec3}} Pose */

/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @type {(a: Vec3, by: number) => Vec3} */
export const scale = (a, by) => [a[0] * by, a[1] * by, a[2] * by];
/** @type {(a: Vec3, b: Vec3) => number} */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @type {(a: Vec3) => number} */
export const norm = (a) => Math.hypot(...a);
/** @type {(a: Vec3) => Vec3} */
export const unit = (a) => scale(a, 1 / norm(a));
/** @type {(a: Vec2, b: Vec2) => number} */
export const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

/** @type {(m: Mat3, v: Vec3) => Vec3} */
export const rotate = (m, v) => [dot(m[0], v), dot(m[1], v), dot(m[2], v)];
/** @type {(m: Mat3) => Mat3} */
export const transpose = (m) => [
  [m[0][0], m[1][0], m[2][0]],
  [m[0][1], m[1][1], m[2][1]],
  [m[0][2], m[1][2], m[2][2]],
];

/** @type {Pose} */
export const IDENTITY = { rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation: [0, 0, 0] };

/** @type {(pose: Pose, point: Vec3) => Vec3} */
export const transform = (pose, point) => add(rotate(pose.rotation, point), pose.translation);

/** @type {(a_from_b: Pose, b_from_c: Pose) => Pose} */
export function compose(a_from_b, b_from_c) {
  const columns = transpose(b_from_c.rotation).map((column) => rotate(a_from_b.rotation, column));
  return {
    rotation: transpose(/** @type {Mat3} */ (columns)),
    translation: transform(a_from_b, b_from_c.translation),
  };
}

/** @type {(pose: Pose) => Pose} */
export function inverse({ rotation, translation }) {
  const back = transpose(rotation);
  return { rotation: back, translation: scale(rotate(back, translation), -1) };
}

/** @type {(rotation_xyzw: number[], translation_m: number[]) => Pose} */
export function fromQuaternion([x0, y0, z0, w0], [tx, ty, tz]) {
  const length = Math.hypot(x0, y0, z0, w0);
  const [x, y, z, w] = [x0 / length, y0 / length, z0 / length, w0 / length];
  return {
    rotation: [
      [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
      [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
      [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ],
    translation: [tx, ty, tz],
  };
}

/**
 * A pose as requests state it. The quaternion is found from its largest component, so that nothing is lost.
 * @param {Pose} pose
 * @returns {{rotation_xyzw: number[], translation_m: number[]}}
 */
export function stated({ rotation: m, translation }) {
  const trace = m[0][0] + m[1][1] + m[2][2];
  const squares = [2 * m[0][0] - trace, 2 * m[1][1] - trace, 2 * m[2][2] - trace, trace];
  const largest = squares.indexOf(Math.max(...squares));
  const s = Math.sqrt(1 + squares[largest]) / 2;
  const [a, b, c] = [m[2][1], m[0][2], m[1][0]];
  const [d, e, f] = [m[1][2], m[2][0], m[0][1]];
  const rows = [
    [s * s * 4, c + f, e + b, a - d],
    [c + f, s * s * 4, a + d, b - e],
    [e + b, a + d, s * s * 4, c - f],
    [a - d, b - e, c - f, s * s * 4],
  ];
  const q = rows[largest].map((value) => value / (4 * s));
  const sign = q[3] < 0 ? -1 : 1;
  return { rotation_xyzw: q.map((value) => sign * value), translation_m: [...translation] };
}

/** Whether rows are those of a rotation, to what people round to. @type {(m: Mat3) => boolean} */
export function isRotation(m) {
  const near = (/** @type {number} */ value, /** @type {number} */ wanted) => Math.abs(value - wanted) < 1e-3;
  const units = m.every((row) => near(norm(row), 1));
  const square = near(dot(m[0], m[1]), 0) && near(dot(m[0], m[2]), 0) && near(dot(m[1], m[2]), 0);
  return units && square && near(dot(cross(m[0], m[1]), m[2]), 1);
}

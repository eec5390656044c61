// @ts-check
// Points in photos. The frame of a scene is the one in which things stand: metres, z up, a board at z = 0.

/** @typedef {[number, number]} Vec2 */
/** @typedef {[number, number, number]} Vec3 */
/** A photo with its camera. @typedef {{
 *   id: number, name: string, width: number, height: number, matrix: number[][], camera_from_standing: number[][],
 * }} Frame */

const NEAR_M = 0.02;

/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** @type {(a: Vec3, by: number) => Vec3} */
export const scale = (a, by) => [a[0] * by, a[1] * by, a[2] * by];
/** @type {(a: number[], b: number[]) => number} */
export const dot = (a, b) => a.reduce((sum, value, k) => sum + value * b[k], 0);
/** @type {(a: Vec2, b: Vec2) => number} */
export const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

/** @type {(frame: Frame, point: Vec3) => Vec3} */
export const inCamera = ({ camera_from_standing: rows }, point) =>
  /** @type {Vec3} */ (rows.map((row) => dot(row.slice(0, 3), point) + row[3]));

/** The pixel of a point, or nothing behind the camera. @type {(frame: Frame, point: Vec3) => Vec2 | null} */
export function project(frame, point) {
  const [x, y, z] = inCamera(frame, point);
  if (z < NEAR_M) return null;
  const [u, v] = frame.matrix;
  return [(u[0] * x + u[1] * y) / z + u[2], (v[1] * y) / z + v[2]];
}

/** Where a camera stands, and where it looks through a pixel. @type {(frame: Frame, pixel: Vec2) => {origin: Vec3, direction: Vec3}} */
export function ray({ matrix: [u, v], camera_from_standing: rows }, pixel) {
  const y = (pixel[1] - v[2]) / v[1];
  const seen = [(pixel[0] - u[2] - u[1] * y) / u[0], y, 1];
  const back = (/** @type {number[]} */ vector) =>
    /** @type {Vec3} */ ([0, 1, 2].map((column) => rows.reduce((sum, row, k) => sum + row[column] * vector[k], 0)));
  return { origin: scale(back(rows.map((row) => row[3])), -1), direction: back(seen) };
}

/** Where a pixel's ray meets the plane at a height, in front of the camera. @type {(frame: Frame, pixel: Vec2, z: number) => Vec3 | null} */
export function onPlane(frame, pixel, z) {
  const { origin, direction } = ray(frame, pixel);
  const along = (z - origin[2]) / direction[2];
  return Number.isFinite(along) && along > 0 ? add(origin, scale(direction, along)) : null;
}

/** Of a point from a line between two others, and where along it, 0 to 1. @type {(p: Vec2, a: Vec2, b: Vec2) => {apart: number, along: number}} */
export function fromSegment(p, a, b) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const length = dx * dx + dy * dy;
  const along = length ? Math.min(1, Math.max(0, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / length)) : 0;
  return { apart: distance(p, [a[0] + along * dx, a[1] + along * dy]), along };
}

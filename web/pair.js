// @ts-check
// Two images of a still object with a known relative pose: where clicked points are, and the frame that three of them span.

import { project, unproject } from './camera.js';
import { IDENTITY, add, cross, distance, norm, rotate, scale, subtract, transform, transpose, unit } from './geometry.js';

/** @typedef {import('./camera.js').Camera} Camera */
/** @typedef {import('./geometry.js').Vec2} Vec2 */
/** @typedef {import('./geometry.js').Vec3} Vec3 */
/** @typedef {import('./geometry.js').Pose} Pose */
/** @typedef {{first: Camera, second: Camera, second_from_first: Pose}} Pair */
/** A point in the frame of the first camera, and how well its clicks fit: pixels, and millimetres between point and ray. */
/** @typedef {{point: Vec3, firstPx: number, secondPx: number, rayMm: number}} Placed */

/** Nearest point of an epipolar line, metres. */
const NEAR_M = 0.02;
/** Below this the three points of a frame lie on one line. */
const MIN_ANGLE_RAD = (5 * Math.PI) / 180;

/** Where a pixel of the first image may be in the second; null where the lens sees nothing. @type {(pair: Pair, pixel: Vec2) => (Vec2 | null)[]} */
export function epipolarLine({ first, second, second_from_first }, pixel) {
  const ray = unproject(first, pixel);
  if (!ray) return [];
  // Even steps of the inverse depth are about even on the line; the last is at infinity, where only the direction counts.
  return Array.from({ length: 129 }, (_, step) => {
    const inverse = (1 - step / 128) / NEAR_M;
    const turned = rotate(second_from_first.rotation, [...ray, 1]);
    return project(second, add(turned, scale(second_from_first.translation, inverse)));
  });
}

/** The point that two pixels see. @type {(pair: Pair, firstPx: Vec2, secondPx: Vec2) => Placed | string} */
export function triangulate(pair, firstPx, secondPx) {
  const rays = [unproject(pair.first, firstPx), unproject(pair.second, secondPx)];
  if (!rays[0] || !rays[1]) return 'outside what the lens model describes';
  const back = transpose(pair.second_from_first.rotation);
  const directions = [unit([...rays[0], 1]), unit(rotate(back, [...rays[1], 1]))];
  const second = scale(rotate(back, pair.second_from_first.translation), -1);
  const normal = cross(directions[0], directions[1]);
  if (norm(normal) < 1e-4) return 'the two rays are parallel; take images from farther apart';
  const along = dot3(cross(second, directions[1]), normal) / dot3(normal, normal);
  const other = dot3(cross(second, directions[0]), normal) / dot3(normal, normal);
  if (along <= 0 || other <= 0) return 'the rays meet behind a camera; check the relative pose and which way it goes';
  const middle = scale(add(scale(directions[0], along), add(second, scale(directions[1], other))), 0.5);
  const point = refined(pair, middle, firstPx, secondPx);
  const errors = residuals(pair, point, firstPx, secondPx);
  if (!errors) return 'outside what the lens model describes';
  const inSecond = transform(pair.second_from_first, point);
  const misses = [norm(cross(point, directions[0])), norm(cross(inSecond, unit([...rays[1], 1])))];
  const [a, b, c, d] = errors;
  return { point, firstPx: Math.hypot(a, b), secondPx: Math.hypot(c, d), rayMm: 1e3 * Math.max(...misses) };
}

/** @type {(a: Vec3, b: Vec3) => number} */
const dot3 = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** @type {(pair: Pair, point: Vec3, firstPx: Vec2, secondPx: Vec2) => number[] | null} */
function residuals({ first, second, second_from_first }, point, firstPx, secondPx) {
  const [a, b] = [project(first, transform(IDENTITY, point)), project(second, transform(second_from_first, point))];
  return a && b && [a[0] - firstPx[0], a[1] - firstPx[1], b[0] - secondPx[0], b[1] - secondPx[1]];
}

/** Least squares of the pixels, by Gauss and Newton. @type {(pair: Pair, start: Vec3, firstPx: Vec2, secondPx: Vec2) => Vec3} */
function refined(pair, start, firstPx, secondPx) {
  let point = start;
  for (let round = 0; round < 5; round++) {
    const errors = residuals(pair, point, firstPx, secondPx);
    const step = 1e-6 * norm(point);
    const columns = [0, 1, 2].map((axis) => {
      const moved = /** @type {Vec3} */ (point.map((value, index) => value + (index === axis ? step : 0)));
      const there = residuals(pair, moved, firstPx, secondPx);
      return errors && there && there.map((value, index) => (value - errors[index]) / step);
    });
    const [a, b, c] = columns;
    if (!errors || !a || !b || !c) return point;
    const sum = (/** @type {number[]} */ left, /** @type {number[]} */ right) => left.reduce((total, value, index) => total + value * right[index], 0);
    const rows = /** @type {Vec3[]} */ ([a, b, c].map((left) => [sum(left, a), sum(left, b), sum(left, c)]));
    const right = /** @type {Vec3} */ ([a, b, c].map((left) => -sum(left, errors)));
    const volume = dot3(rows[0], cross(rows[1], rows[2]));
    if (!(Math.abs(volume) > 0)) return point;
    // Cramer's rule; the matrix is symmetric.
    const change = scale([
      dot3(right, cross(rows[1], rows[2])), dot3(rows[0], cross(right, rows[2])), dot3(rows[0], cross(rows[1], right)),
    ], 1 / volume);
    point = add(point, change);
  }
  return point;
}

/** The frame that three points span, in the frame of the points. @type {(origin: Vec3, onX: Vec3, inXy: Vec3) => Pose | null} */
export function spanned(origin, onX, inXy) {
  const [toX, toXy] = [subtract(onX, origin), subtract(inXy, origin)];
  if (norm(toX) < 1e-9 || norm(toXy) < 1e-9) return null;
  const x = unit(toX);
  const across = cross(x, unit(toXy));
  if (norm(across) < Math.sin(MIN_ANGLE_RAD)) return null;
  const z = unit(across);
  return { rotation: transpose([x, cross(z, x), z]), translation: origin };
}

/** How far a pixel is from a line of pixels. @type {(line: (Vec2 | null)[], pixel: Vec2) => number} */
export function offLine(line, pixel) {
  let least = Infinity;
  for (let index = 1; index < line.length; index++) {
    const [a, b] = [line[index - 1], line[index]];
    if (!a || !b) continue;
    const length2 = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2;
    const along = length2 > 0 ? ((pixel[0] - a[0]) * (b[0] - a[0]) + (pixel[1] - a[1]) * (b[1] - a[1])) / length2 : 0;
    const t = Math.max(0, Math.min(1, along));
    least = Math.min(least, distance(pixel, [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]));
  }
  return least;
}

// @ts-check
// An upright box or cylinder, and what dragging does to it.

import { add, dot, onPlane, project, scale } from './geometry.js';

/** @typedef {import('./geometry.js').Vec2} Vec2 */
/** @typedef {import('./geometry.js').Vec3} Vec3 */
/** @typedef {import('./geometry.js').Frame} Frame */
/** Metres; `base` is the middle of its underside, `size` its length, width and height, `yaw` the turn about z.
 * @typedef {{kind: 'box' | 'cylinder', base: Vec3, yaw: number, size: Vec3}} Solid */
/** One of its sides: the axis that it is square to, and which way it looks. @typedef {{axis: 0 | 1 | 2, sign: 1 | -1}} Side */
/** Where two sides meet. @typedef {[Side, Side]} Edge */

const LEAST_M = 0.002;
const MOST_M = 10;
const STEPS = 8;
const RIM = Array.from({ length: 33 }, (_, k) => [Math.cos((k * Math.PI) / 16) / 2, Math.sin((k * Math.PI) / 16) / 2]);

/** @type {Edge[]} */
export const EDGES = (() => {
  /** @type {Side[]} */
  const sides = [0, 1, 2].flatMap((axis) => [1, -1].map((sign) => /** @type {Side} */ ({ axis, sign })));
  return sides.flatMap((a, k) => sides.slice(k + 1).filter((b) => b.axis !== a.axis).map((b) => /** @type {Edge} */ ([a, b])));
})();

/** Its axes. @type {(solid: Solid) => [Vec3, Vec3, Vec3]} */
export function axes({ yaw }) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [[c, s, 0], [-s, c, 0], [0, 0, 1]];
}

/** A point by its place in the solid: -1/2 to 1/2 along each axis. @type {(solid: Solid, place: number[]) => Vec3} */
export function at(solid, place) {
  const [x, y, z] = axes(solid);
  const { base, size } = solid;
  return add(add(add(base, scale(x, place[0] * size[0])), scale(y, place[1] * size[1])), scale(z, (place[2] + 0.5) * size[2]));
}

/** The ends of an edge. @type {(solid: Solid, edge: Edge) => [Vec3, Vec3]} */
export function ends(solid, edge) {
  const place = [0, 0, 0];
  for (const { axis, sign } of edge) place[axis] = sign / 2;
  const along = [0, 1, 2].find((axis) => edge.every((side) => side.axis !== axis)) ?? 0;
  return /** @type {[Vec3, Vec3]} */ ([-0.5, 0.5].map((end) => at(solid, place.map((value, axis) => (axis === along ? end : value)))));
}

/** The lines that show it. @type {(solid: Solid) => Vec3[][]} */
export function lines(solid) {
  if (solid.kind === 'box') return EDGES.map((edge) => ends(solid, edge));
  const rims = [-0.5, 0.5].map((z) => RIM.map(([x, y]) => at(solid, [x, y, z])));
  return [...rims, ...[0, 8, 16, 24].map((k) => [rims[0][k], rims[1][k]])];
}

/** With some of its sides moved outwards. @type {(solid: Solid, sides: Side[], by: number[]) => Solid} */
export function moved(solid, sides, by) {
  const unit = axes(solid);
  /** @type {Vec3} */
  const size = [...solid.size];
  let { base } = solid;
  sides.forEach(({ axis, sign }, k) => {
    const grown = Math.min(MOST_M, Math.max(LEAST_M, size[axis] + by[k]));
    const change = grown - size[axis];
    size[axis] = grown;
    if (axis < 2) base = add(base, scale(unit[axis], (sign * change) / 2));
    else if (sign < 0) base = add(base, [0, 0, -change]);
  });
  return { ...solid, base, size };
}

/** The sides that an edge moves: what stands on the ground stays there. @type {(edge: Edge, grounded: boolean) => Side[]} */
export const movable = (edge, grounded) => edge.filter(({ axis, sign }) => !(grounded && axis === 2 && sign < 0));

/**
 * With an edge dragged so that the point of it that was taken is seen at a pixel (least squares, held back where an axis
 * points at the camera).
 * @param {Solid} solid @param {Frame} frame @param {Edge} edge @param {number} along of the edge, 0 to 1
 * @param {Vec2} pixel @param {boolean} grounded
 */
export function edgeDragged(solid, frame, edge, along, pixel, grounded) {
  const sides = movable(edge, grounded);
  const unit = axes(solid);
  const outwards = sides.map(({ axis, sign }) => scale(unit[axis], sign));
  const [a, b] = ends(solid, edge);
  const start = add(scale(a, 1 - along), scale(b, along));
  const by = sides.map(() => 0);
  for (let step = 0; step < STEPS; step += 1) {
    const place = outwards.reduce((sum, axis, k) => add(sum, scale(axis, by[k])), start);
    const seen = project(frame, place);
    if (!seen) break;
    const h = 1e-4;
    const slopes = outwards.map((axis) => {
      const next = project(frame, add(place, scale(axis, h))) ?? seen;
      return [(next[0] - seen[0]) / h, (next[1] - seen[1]) / h];
    });
    const off = [pixel[0] - seen[0], pixel[1] - seen[1]];
    solve(slopes, off).forEach((value, k) => (by[k] += value));
  }
  return moved(solid, sides, by.map((value) => (Number.isFinite(value) ? value : 0)));
}

/** Least squares of one or two unknowns. @type {(slopes: number[][], off: number[]) => number[]} */
function solve(slopes, off) {
  const size = slopes.reduce((sum, slope) => sum + dot(slope, slope), 0);
  const little = 1e-3 * size + 1e-9;
  if (slopes.length === 1) return [dot(slopes[0], off) / (size + little)];
  const [p, q] = slopes;
  const [pp, pq, qq] = [dot(p, p) + little, dot(p, q), dot(q, q) + little];
  const [po, qo] = [dot(p, off), dot(q, off)];
  const determinant = pp * qq - pq * pq;
  return [(qq * po - pq * qo) / determinant, (pp * qo - pq * po) / determinant];
}

/** The frame turned by a quarter: what was the width is the length. @type {(solid: Solid) => Solid} */
export function turnedAxes(solid) {
  const [length, width, height] = solid.size;
  return { ...solid, yaw: wrapped(solid.yaw + Math.PI / 2), size: [width, length, height] };
}

/** @type {(yaw: number) => number} */
export const wrapped = (yaw) => Math.atan2(Math.sin(yaw), Math.cos(yaw));

/**
 * A first guess from one drawn box (x, y, width, height): it stands where the underside of the box meets the ground.
 * @type {(frame: Frame, box: number[], kind: 'box' | 'cylinder') => Solid | null}
 */
export function standing(frame, [x, y, width, height], kind) {
  const near = onPlane(frame, [x + width / 2, y + height - 1], 0);
  if (!near) return null;
  const depth = dot(frame.camera_from_standing[2].slice(0, 3), near) + frame.camera_from_standing[2][3];
  const side = (0.75 * width * depth) / frame.matrix[0][0];
  const seenFrom = dot(frame.camera_from_standing[2].slice(0, 3), [0, 0, -1]); // 1 from straight above
  const upright = Math.max(0.25, Math.sqrt(Math.max(0, 1 - seenFrom * seenFrom)));
  const tall = Math.max(0.3 * side, (height * depth) / frame.matrix[1][1] / upright - side * seenFrom);
  const back = onPlane(frame, [x + width / 2, y + height - 2], 0);
  const away = back ? Math.atan2(back[1] - near[1], back[0] - near[0]) : 0;
  const base = add(near, [(Math.cos(away) * side) / 2, (Math.sin(away) * side) / 2, 0]);
  return { kind, base: [base[0], base[1], 0], yaw: 0, size: [side, side, tall] };
}

/** @type {(entry: import('./api.js').Entry) => Solid | null} */
export function ofEntry({ solid, base_mm, yaw_deg, size_mm }) {
  if (!base_mm || !size_mm) return null;
  const metres = (/** @type {number[]} */ values) => /** @type {Vec3} */ ([0, 1, 2].map((k) => (values[k] ?? 0) / 1000));
  return { kind: solid ?? 'box', base: metres(base_mm), yaw: ((yaw_deg ?? 0) * Math.PI) / 180, size: metres(size_mm) };
}

/** @type {(solid: Solid, scene: string) => import('./api.js').Entry} */
export function asEntry({ kind, base, yaw, size }, scene) {
  const mm = (/** @type {number[]} */ values) => values.map((value) => Math.round(value * 1e5) / 100);
  return { solid: kind, base_mm: mm(base), yaw_deg: Math.round((yaw * 180e3) / Math.PI) / 1000, size_mm: mm(size), scene };
}

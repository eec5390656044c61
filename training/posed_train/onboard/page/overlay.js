// @ts-check
// Solids, boxes and outlines over a photo.

import { project } from './geometry.js';
import { at, lines } from './solid.js';

/** @typedef {import('./geometry.js').Vec2} Vec2 */
/** @typedef {import('./geometry.js').Vec3} Vec3 */
/** @typedef {import('./geometry.js').Frame} Frame */
/** @typedef {import('./model.js').Thing} Thing */
/** From a pixel of the photo to one of the canvas. @typedef {(pixel: Vec2) => Vec2} Place */

const EDGE = '#000000';
export const AXES = /** @type {[string, string][]} */ ([['x', '#ff4d4d'], ['y', '#3ddc60'], ['z', '#4da3ff']]);

/** A line with a dark edge, so that it shows on everything.
 * @param {CanvasRenderingContext2D} context @param {(Vec2 | null)[]} points @param {Place} place */
export function line(context, points, place, colour = '#ffffff', width = 1.5, dash = /** @type {number[]} */ ([])) {
  const path = new Path2D();
  let down = false;
  for (const point of points) {
    if (point) path[down ? 'lineTo' : 'moveTo'](...place(point));
    down = point !== null;
  }
  context.setLineDash(dash);
  for (const [style, wide, alpha] of /** @type {const} */ ([[EDGE, width + 2, 0.5], [colour, width, 1]])) {
    Object.assign(context, { strokeStyle: style, lineWidth: wide, globalAlpha: alpha, lineJoin: 'round', lineCap: 'round' });
    context.stroke(path);
  }
  context.globalAlpha = 1;
  context.setLineDash([]);
}

/** @param {CanvasRenderingContext2D} context @param {Vec2} place @param {number} radius @param {string} colour */
export function dot(context, place, radius, colour, filled = true) {
  context.beginPath();
  context.arc(...place, radius, 0, 2 * Math.PI);
  Object.assign(context, { lineWidth: 3, strokeStyle: EDGE, fillStyle: colour });
  context.stroke();
  if (filled) context.fill();
  else {
    Object.assign(context, { lineWidth: 1.5, strokeStyle: colour });
    context.stroke();
  }
}

/** @param {CanvasRenderingContext2D} context @param {Vec2} place @param {string} words @param {string} colour */
function text(context, [x, y], words, colour) {
  Object.assign(context, { font: '600 13px system-ui, sans-serif', lineWidth: 4, strokeStyle: EDGE, fillStyle: colour, lineJoin: 'round' });
  context.strokeText(words, x + 4, y - 3);
  context.fillText(words, x + 4, y - 3);
}

/** @param {CanvasRenderingContext2D} context @param {Frame} frame @param {Thing} thing @param {Place} place @param {number} width */
export function drawSolid(context, frame, { solid, colour }, place, width) {
  if (!solid) return;
  for (const one of lines(solid)) line(context, one.map((point) => project(frame, point)), place, colour, width);
}

/** The object's axes, by their names. @param {CanvasRenderingContext2D} context @param {Frame} frame @param {Thing} thing @param {Place} place */
export function drawAxes(context, frame, { solid, up }, place) {
  if (!solid) return;
  const middle = project(frame, at(solid, [0, 0, 0]));
  const length = 0.35 * Math.max(...solid.size);
  axesOfBox(up).forEach((direction, k) => {
    const tip = project(frame, at(solid, direction.map((value, axis) => (value * length) / solid.size[axis])));
    line(context, [middle, tip], place, AXES[k][1], 2.5);
    if (tip) text(context, place(tip), AXES[k][0], AXES[k][1]);
  });
}

/** Where x, y and z of an object point in its box, whose z is up: axes change places by turns. @param {string} up @returns {Vec3[]} */
export function axesOfBox(up) {
  const shift = 'zxy'.indexOf(up[up.length - 1]);
  return [0, 1, 2].map((axis) => {
    const direction = /** @type {Vec3} */ ([0, 0, 0]);
    direction[(axis - shift + 3) % 3] = 1;
    return up.startsWith('-') ? [direction[0], -direction[1] || 0, -direction[2] || 0] : direction;
  });
}

/** @param {CanvasRenderingContext2D} context @param {[number, number][][]} outlines @param {Place} place @param {string} colour */
export function drawOutlines(context, outlines, place, colour) {
  context.save();
  const path = new Path2D();
  for (const outline of outlines) {
    outline.forEach((point, k) => path[k ? 'lineTo' : 'moveTo'](...place(point)));
    path.closePath();
  }
  Object.assign(context, { fillStyle: colour, strokeStyle: colour, globalAlpha: 0.28, lineWidth: 1 });
  context.fill(path);
  context.globalAlpha = 0.9;
  context.stroke(path);
  context.restore();
}

// @ts-check
// What an answer says, drawn into its image.

import { project } from './camera.js';
import { add, fromQuaternion, scale, transform } from './geometry.js';

/** @typedef {import('./types').components['schemas']} Schemas */
/** @typedef {Schemas['PoseReport']} PoseReport */
/** @typedef {import('./camera.js').Camera} Camera */
/** @typedef {import('./geometry.js').Vec2} Vec2 */
/** @typedef {import('./geometry.js').Vec3} Vec3 */
/** @typedef {import('./geometry.js').Pose} Pose */
/** An image with its size in the file. @typedef {{bitmap: ImageBitmap, width: number, height: number}} Picture */

const AXES = /** @type {[Vec3, string, string][]} */ ([
  [[1, 0, 0], '#ff4d4d', 'x'],
  [[0, 1, 0], '#3ddc60', 'y'],
  [[0, 0, 1], '#4da3ff', 'z'],
]);
const INK = '#ffffff';
const EDGE = '#000000';
/** Residuals are too small to see as they are. */
export const RESIDUALS_TIMES = 5;
/** Two dimensions, 95 %. */
const ELLIPSE_SIGMAS = 2.4477;
/** Unknown objects get axes of this length, metres. */
const SOME_DIAMETER_M = 0.08;

/** A canvas that shows an image; drawing is in pixels of the image, line widths in those of the screen. */
export class Sheet {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    const context = canvas.getContext('2d');
    if (!context) throw new Error('this browser cannot draw');
    this.context = context;
    this.px = 1;
    this.scale = 1;
  }

  /** Fits the canvas to its width on the screen and draws the image. @param {Picture} picture */
  begin({ bitmap, width, height }) {
    this.canvas.style.aspectRatio = `${width} / ${height}`;
    this.px = window.devicePixelRatio || 1;
    const shown = Math.max(1, Math.round((this.canvas.clientWidth || 640) * this.px));
    Object.assign(this.canvas, { width: shown, height: Math.round((shown * height) / width) });
    this.scale = shown / width;
    this.context.drawImage(bitmap, 0, 0, this.canvas.width, this.canvas.height);
    Object.assign(this.context, { lineCap: 'round', lineJoin: 'round' });
  }

  /** Where a pixel of the image is on the canvas: its centre is half a pixel inside. @param {Vec2} pixel @returns {Vec2} */
  at([u, v]) {
    return [(u + 0.5) * this.scale, (v + 0.5) * this.scale];
  }

  /** A line with a dark edge, so that it shows on everything. @param {(Vec2 | null)[]} points */
  line(points, colour = INK, width = 2, dash = /** @type {number[]} */ ([])) {
    const path = new Path2D();
    let down = false;
    for (const point of points) {
      if (point) path[down ? 'lineTo' : 'moveTo'](...this.at(point));
      down = point !== null;
    }
    this.stroke(path, colour, width, dash);
  }

  /** @param {Path2D} path */
  stroke(path, colour = INK, width = 2, dash = /** @type {number[]} */ ([])) {
    const { context, px } = this;
    context.setLineDash(dash.map((length) => length * px));
    for (const [style, wide] of /** @type {const} */ ([[EDGE, width + 2], [colour, width]])) {
      Object.assign(context, { strokeStyle: style, lineWidth: wide * px, globalAlpha: style === EDGE ? 0.55 : 1 });
      context.stroke(path);
    }
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  /** @param {Vec2} pixel @param {string} words */
  text([u, v], words, colour = INK) {
    const { context, px } = this;
    const [x, y] = this.at([u, v]);
    context.font = `600 ${14 * px}px system-ui, sans-serif`;
    const inside = Math.max(2 * px, Math.min(x, this.canvas.width - context.measureText(words).width - 4 * px));
    Object.assign(context, { lineWidth: 4 * px, strokeStyle: EDGE, fillStyle: colour });
    context.strokeText(words, inside, Math.max(y, 15 * px));
    context.fillText(words, inside, Math.max(y, 15 * px));
  }

  /** A circle of so many pixels of the screen. @param {Vec2} pixel @param {number} radius */
  dot(pixel, radius, colour = INK, filled = true) {
    const path = new Path2D();
    path.arc(...this.at(pixel), radius * this.px, 0, 2 * Math.PI);
    this.stroke(path, colour, filled ? 1 : 1.5);
    this.context.fillStyle = colour;
    if (filled) this.context.fill(path);
  }

  /** @param {Vec2} pixel @param {number} radius */
  cross([u, v], radius, colour = INK) {
    const reach = (radius * this.px) / this.scale;
    this.line([[u - reach, v - reach], [u + reach, v + reach]], colour);
    this.line([[u - reach, v + reach], [u + reach, v - reach]], colour);
  }

  /** The axes of a frame, each so long; curved as the lens curves them. @param {Camera} camera @param {Pose} camera_from_frame @param {number} lengthM */
  axes(camera, camera_from_frame, lengthM, labels = false, faint = false) {
    for (const [axis, colour, name] of AXES) {
      const along = Array.from({ length: 9 }, (_, step) => project(camera, transform(camera_from_frame, scale(axis, (lengthM * step) / 8))));
      this.line(along, colour, faint ? 1.5 : 3, faint ? [4, 5] : []);
      const tip = along[8];
      if (labels && tip) this.text([tip[0] + (4 * this.px) / this.scale, tip[1]], name, colour);
    }
  }
}

/** @type {(pose: {camera_from_object: {rotation_xyzw: number[], translation_m: number[]}}) => Pose} */
export const poseOf = ({ camera_from_object: { rotation_xyzw, translation_m } }) => fromQuaternion(rotation_xyzw, translation_m);

/**
 * Draws an answer. `chosen` is the pose that is pointed at: its alternatives are shown, others are faint.
 * @param {Sheet} sheet
 * @param {Picture} picture
 * @param {PoseReport[]} poses
 * @param {Camera} camera
 * @param {Map<string, number>} diametersM
 * @param {number | null} chosen
 */
export function drawAnswer(sheet, picture, poses, camera, diametersM, chosen) {
  sheet.begin(picture);
  const centre = /** @type {Vec2} */ ([camera.cx, camera.cy]);
  const arm = (7 * sheet.px) / sheet.scale;
  sheet.line([[centre[0] - arm, centre[1]], [centre[0] + arm, centre[1]]], INK, 1);
  sheet.line([[centre[0], centre[1] - arm], [centre[0], centre[1] + arm]], INK, 1);
  const order = poses.map((_, index) => index).sort((a, b) => Number(a === chosen) - Number(b === chosen));
  for (const index of order) {
    const pose = poses[index];
    const length = (diametersM.get(pose.object) ?? SOME_DIAMETER_M) / 2;
    const alone = chosen === null || index === chosen;
    sheet.context.globalAlpha = 1;
    drawBox(sheet, pose, alone);
    if (!pose.camera_from_object) continue;
    if (index === chosen) {
      for (const other of pose.alternatives ?? []) sheet.axes(camera, poseOf(other), length, false, true);
    }
    if (alone) drawEvidence(sheet, pose, camera);
    sheet.axes(camera, poseOf({ camera_from_object: pose.camera_from_object }), length, alone, !alone);
  }
}

/** @param {Sheet} sheet @param {PoseReport} pose @param {boolean} alone */
function drawBox(sheet, { object, status, detection }, alone) {
  const [x, y, width, height] = detection.box_px;
  const corners = /** @type {Vec2[]} */ ([[x, y], [x + width, y], [x + width, y + height], [x, y + height], [x, y]]);
  sheet.line(corners, INK, alone ? 1.5 : 1, status === 'ok' ? [] : [6, 4]);
  if (alone) sheet.text([x, y - (5 * sheet.px) / sheet.scale], status === 'ok' ? object : `${object}: ${status.replace('_', ' ')}`);
}

/** Keypoints with their residuals, and where the position may be. @param {Sheet} sheet @param {PoseReport} pose @param {Camera} camera */
function drawEvidence(sheet, pose, camera) {
  for (const { pixel, residual_px, inlier } of pose.keypoints ?? []) {
    const at = /** @type {Vec2} */ (pixel);
    if (!inlier) sheet.cross(at, 3.5);
    else sheet.dot(at, 1.5);
    if (residual_px) sheet.dot(at, (residual_px * RESIDUALS_TIMES * sheet.scale) / sheet.px, INK, false);
  }
  const ellipse = positionEllipse(pose, camera);
  if (ellipse) sheet.line(ellipse, '#ffd43b', 2);
}

/** The pixels around the position that hold it with 95 %. @param {PoseReport} pose @param {Camera} camera @returns {Vec2[] | null} */
export function positionEllipse({ camera_from_object, covariance }, camera) {
  if (!camera_from_object || !covariance) return null;
  const position = /** @type {Vec3} */ (camera_from_object.translation_m);
  const middle = project(camera, position);
  const step = 1e-5;
  const moved = AXES.map(([axis]) => project(camera, add(position, scale(axis, step))));
  if (!middle || moved.some((pixel) => !pixel)) return null;
  const rows = [0, 1].map((row) => moved.map((pixel) => (/** @type {Vec2} */ (pixel)[row] - middle[row]) / step));
  const part = (/** @type {number} */ a, /** @type {number} */ b) =>
    rows[a].reduce((sum, left, i) => sum + rows[b].reduce((inner, right, j) => inner + left * covariance[i][j] * right, 0), 0);
  const [uu, uv, vv] = [part(0, 0), part(0, 1), part(1, 1)];
  // By Cholesky: a circle mapped by the root of the covariance.
  const l11 = Math.sqrt(Math.max(uu, 0));
  const l21 = l11 > 0 ? uv / l11 : 0;
  const l22 = Math.sqrt(Math.max(vv - l21 * l21, 0));
  return Array.from({ length: 41 }, (_, index) => {
    const [c, s] = [Math.cos((index * Math.PI) / 20), Math.sin((index * Math.PI) / 20)];
    return /** @type {Vec2} */ ([middle[0] + ELLIPSE_SIGMAS * l11 * c, middle[1] + ELLIPSE_SIGMAS * (l21 * c + l22 * s)]);
  });
}

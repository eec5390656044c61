// @ts-check
// An image in which points are clicked, with a magnifier for the last tenth of a pixel.

import { h } from './elements.js';
import { distance } from './geometry.js';
import { Sheet } from './overlay.js';

/** @typedef {import('./images.js').Picture} Picture */
/** @typedef {import('./geometry.js').Vec2} Vec2 */
/** Draws over the image. @typedef {(sheet: Sheet) => void} Paint */

/** Screen pixels for one of the image in the magnifier. */
const MAGNIFY = 8;
/** This near, in pixels of the screen, a click means the point that is there. */
const REACH_PX = 9;
/** What an arrow key moves: alone, with Shift, with Alt; pixels of the image. */
const STEPS = { plain: 0.5, shift: 10, alt: 0.1 };
const ARROWS = /** @type {Record<string, Vec2>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] });

export class Picker {
  /**
   * @param {string} name
   * @param {{click: (pixel: Vec2) => void, select: (index: number) => void, move: (pixel: Vec2) => void, box?: (box: number[]) => void}} on
   * what to do with a click on nothing, with one on a point, with a new place for the selected point, and with a drawn box
   */
  constructor(name, on) {
    this.on = on;
    /** @type {Picture | null} */
    this.picture = null;
    /** @type {(Vec2 | null)[]} */
    this.points = [];
    this.selected = -1;
    /** @type {Paint} */
    this.paint = () => {};
    /** Where the next point would be placed by keyboard, or the pointer is. @type {Vec2 | null} */
    this.cursor = null;
    this.drawsBox = false;
    const help = `${name}: arrow keys move the selected point or the cursor by half a pixel, with Shift by ten, with Alt by a tenth; Enter places a point.`;
    this.canvas = h('canvas', { class: 'picture pick', tabindex: '0', role: 'application', 'aria-label': help });
    this.lens = h('canvas', { class: 'lens', role: 'img', 'aria-label': `${name}, magnified ${MAGNIFY} times` });
    this.sheet = new Sheet(this.canvas);
    this.lensSheet = new Sheet(this.lens);
    this.element = h('div', {}, this.canvas, this.lens);
    this.canvas.addEventListener('pointerdown', (event) => this.press(event));
    this.canvas.addEventListener('pointermove', (event) => this.hover(event));
    this.canvas.addEventListener('pointerleave', () => this.unhover());
    this.canvas.addEventListener('keydown', (event) => this.key(event));
    this.lens.addEventListener('pointerdown', (event) => this.refine(event));
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    this.show(null);
  }

  /** @param {Picture | null} picture */
  show(picture) {
    this.picture = picture;
    this.element.hidden = picture === null;
    this.cursor = null;
    this.draw();
  }

  /** @param {PointerEvent} event @returns {Vec2} */
  pixel({ offsetX, offsetY }) {
    const by = (this.picture?.width ?? 1) / this.canvas.clientWidth;
    return [offsetX * by - 0.5, offsetY * by - 0.5];
  }

  /** @param {PointerEvent} event */
  press(event) {
    if (event.button !== 0 || !this.picture) return;
    const pixel = this.pixel(event);
    this.canvas.setPointerCapture(event.pointerId);
    if (this.drawsBox) return this.drag((to) => this.on.box?.(boxOf(pixel, to)), () => (this.drawsBox = false));
    const reach = (REACH_PX * this.picture.width) / this.canvas.clientWidth;
    const near = this.points.findIndex((point) => point && distance(point, pixel) < reach);
    if (near < 0) this.on.click(pixel);
    else this.on.select(near);
    const start = this.points[this.selected];
    if (!start) return;
    // Dragging moves the point by as much as the pointer, so that it does not jump under it.
    this.drag((to) => this.on.move([start[0] + to[0] - pixel[0], start[1] + to[1] - pixel[1]]));
  }

  /** @param {(pixel: Vec2) => void} move */
  drag(move, end = () => {}) {
    const over = new AbortController();
    this.canvas.addEventListener('pointermove', (event) => move(this.pixel(event)), { signal: over.signal });
    for (const kind of /** @type {const} */ (['pointerup', 'pointercancel'])) {
      this.canvas.addEventListener(kind, () => (over.abort(), end()), { signal: over.signal });
    }
  }

  /** @param {PointerEvent} event */
  hover(event) {
    this.cursor = this.pixel(event);
    this.draw();
  }

  unhover() {
    this.cursor = null;
    this.draw();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (!this.picture) return;
    const point = this.points[this.selected];
    const from = point ?? this.cursor ?? [(this.picture.width - 1) / 2, (this.picture.height - 1) / 2];
    const arrow = ARROWS[event.key];
    if (arrow) {
      const step = event.shiftKey ? STEPS.shift : event.altKey ? STEPS.alt : STEPS.plain;
      /** @type {Vec2} */
      const to = [from[0] + arrow[0] * step, from[1] + arrow[1] * step];
      if (point) this.on.move(to);
      else this.cursor = to;
    } else if (event.key === 'Enter' || event.key === ' ') this.on.click(this.cursor ?? from);
    else return;
    event.preventDefault();
    this.draw();
  }

  /** A click in the magnifier places the selected point to a fraction of a pixel. @param {PointerEvent} event */
  refine(event) {
    const centre = this.points[this.selected];
    if (!centre) return;
    const off = (/** @type {number} */ at, /** @type {number} */ side) => (at - side / 2) / MAGNIFY;
    this.on.move([centre[0] + off(event.offsetX, this.lens.clientWidth), centre[1] + off(event.offsetY, this.lens.clientHeight)]);
  }

  draw() {
    if (!this.picture) return;
    this.sheet.begin(this.picture);
    this.paintOver(this.sheet);
    const centre = this.cursor ?? this.points[this.selected];
    this.drawLens(centre ?? null, this.picture);
  }

  /** @param {Sheet} sheet */
  paintOver(sheet) {
    this.paint(sheet);
    this.points.forEach((point, index) => {
      if (!point) return;
      const selected = index === this.selected;
      sheet.cross(point, selected ? 6 : 4, selected ? '#ffd43b' : '#ffffff');
      sheet.text([point[0] + (7 * sheet.px) / sheet.scale, point[1] - (5 * sheet.px) / sheet.scale], String(index + 1), selected ? '#ffd43b' : '#ffffff');
    });
    if (this.cursor && sheet === this.sheet && document.activeElement === this.canvas) sheet.dot(this.cursor, 4, '#ffd43b', false);
  }

  /** @param {Vec2 | null} centre @param {Picture} picture */
  drawLens(centre, { bitmap, width }) {
    const sheet = this.lensSheet;
    sheet.px = window.devicePixelRatio || 1;
    const side = Math.max(1, Math.round(this.lens.clientWidth * sheet.px));
    Object.assign(this.lens, { width: side, height: side });
    sheet.scale = sheet.px;
    if (!centre) return sheet.text([8, 20], 'Magnifier');
    sheet.scale = MAGNIFY * sheet.px;
    const { context } = sheet;
    const shown = side / sheet.scale;
    const [left, top] = [centre[0] + 0.5 - shown / 2, centre[1] + 0.5 - shown / 2];
    const by = bitmap.width / width;
    context.imageSmoothingEnabled = false;
    context.translate(-left * sheet.scale, -top * sheet.scale);
    context.drawImage(bitmap, 0, 0, (bitmap.width / by) * sheet.scale, (bitmap.height / by) * sheet.scale);
    this.paintOver(sheet);
  }
}

/** @type {(a: Vec2, b: Vec2) => number[]} */
function boxOf(a, b) {
  return [Math.min(a[0], b[0]), Math.min(a[1], b[1]), Math.abs(a[0] - b[0]), Math.abs(a[1] - b[1])].map(Math.round);
}

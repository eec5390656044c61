// @ts-check
// The open photo: boxes are drawn in it, and edges of the 3D box dragged.

import { imageOf } from './api.js';
import { distance, fromSegment, onPlane, project } from './geometry.js';
import { drawAxes, drawOutlines, drawSolid, dot, line } from './overlay.js';
import { EDGES, at, edgeDragged, ends, movable, wrapped } from './solid.js';

/** @typedef {import('./geometry.js').Vec2} Vec2 */
/** @typedef {import('./model.js').Model} Model */
/** @typedef {import('./solid.js').Solid} Solid */
/** @typedef {import('./solid.js').Edge} Edge */
/** What a pointer has taken, with the solid as it was then.
 * @typedef {{kind: 'edge', edge: Edge, along: number, off: Vec2, solid: Solid} | {kind: 'move', off: Vec2, solid: Solid}
 *   | {kind: 'turn', solid: Solid} | {kind: 'draw', from: Vec2, to: Vec2} | {kind: 'pan', last: Vec2}} Grip */

const NEAR_PX = 9;
const LEAST_BOX_PX = 4;
const MOST_ZOOM = 24;
const KNOB = 0.72;

export class Editor {
  /** @param {HTMLCanvasElement} canvas @param {Model} model @param {(photo: string) => Record<string, [number, number][][]> | null} outlinesOf */
  constructor(canvas, model, outlinesOf) {
    Object.assign(this, { canvas, model, outlinesOf });
    this.canvas = canvas;
    this.model = model;
    this.outlinesOf = outlinesOf;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
    this.view = { zoom: 1, x: 0, y: 0 };
    /** @type {Grip | null} */
    this.grip = null;
    /** @type {Vec2 | null} */
    this.cursor = null;
    this.image = new Image();
    this.shown = '';
    this.image.addEventListener('load', () => this.draw());
    canvas.addEventListener('pointerdown', (event) => this.down(event));
    canvas.addEventListener('pointermove', (event) => this.move(event));
    for (const end of ['pointerup', 'pointercancel']) canvas.addEventListener(end, () => this.up());
    canvas.addEventListener('wheel', (event) => this.wheel(event), { passive: false });
    model.addEventListener('change', () => this.show());
    new ResizeObserver(() => this.draw()).observe(canvas);
    this.show();
  }

  /** Opens the model's photo. */
  show() {
    const { scene, frame } = this.model;
    const wanted = imageOf(scene.name, frame, false);
    if (wanted !== this.shown) {
      this.shown = wanted;
      this.image.src = wanted;
      this.whole(false);
    }
    this.draw();
  }

  whole(redraw = true) {
    this.view = { zoom: 1, x: 0, y: 0 };
    if (redraw) this.draw();
  }

  /** Pixels of the canvas for one of the photo. */
  get scale() {
    return (this.canvas.width / this.model.frame.width) * this.view.zoom;
  }

  /** @param {Vec2} pixel @returns {Vec2} */
  place = ([u, v]) => [(u + 0.5 - this.view.x) * this.scale, (v + 0.5 - this.view.y) * this.scale];

  /** The photo's pixel under a pointer. @param {{clientX: number, clientY: number}} event @returns {Vec2} */
  pixel({ clientX, clientY }) {
    const { left, top, width } = this.canvas.getBoundingClientRect();
    const by = this.canvas.width / width / this.scale;
    return [(clientX - left) * by + this.view.x - 0.5, (clientY - top) * by + this.view.y - 0.5];
  }

  /** How near, in pixels of the photo, a pointer must come. */
  get near() {
    return (NEAR_PX * (window.devicePixelRatio || 1)) / this.scale;
  }

  /** What there is to take at a pixel. @param {Vec2} pixel @returns {Grip | null} */
  at(pixel) {
    const { frame, scene, thing, drawing } = this.model;
    if (drawing || !thing.solid) return null;
    const { solid } = thing;
    for (const [kind, place] of /** @type {['move' | 'turn', Vec2 | null][]} */ ([['turn', this.knob(solid)], ['move', project(frame, solid.base)]])) {
      if (place && distance(place, pixel) < this.near) {
        return kind === 'turn' ? { kind, solid } : { kind, solid, off: [place[0] - pixel[0], place[1] - pixel[1]] };
      }
    }
    /** @type {{apart: number, grip: Grip} | null} */
    let best = null;
    for (const edge of EDGES) {
      if (!movable(edge, scene.grounded).length) continue;
      const [a, b] = ends(solid, edge).map((end) => project(frame, end));
      if (!a || !b) continue;
      const { apart, along } = fromSegment(pixel, a, b);
      if (apart > this.near || (best && best.apart <= apart)) continue;
      const taken = [a[0] + along * (b[0] - a[0]), a[1] + along * (b[1] - a[1])];
      best = { apart, grip: { kind: 'edge', edge, along: alongInSpace(this.model, edge, pixel, along), off: [taken[0] - pixel[0], taken[1] - pixel[1]], solid } };
    }
    return best && best.grip;
  }

  /** Where the knob that turns is seen. @param {Solid} solid */
  knob(solid) {
    return project(this.model.frame, at(solid, [KNOB, 0, -0.5]));
  }

  /** @param {PointerEvent} event */
  down(event) {
    if (event.button !== 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    const pixel = this.pixel(event);
    const taken = this.at(pixel);
    if (taken) this.model.remember();
    this.grip = taken ?? (this.model.drawing ? { kind: 'draw', from: pixel, to: pixel } : { kind: 'pan', last: [event.clientX, event.clientY] });
  }

  /** @param {PointerEvent} event */
  move(event) {
    const pixel = this.pixel(event);
    this.cursor = pixel;
    const { grip, model } = this;
    if (!grip) {
      this.canvas.classList.toggle('over', this.at(pixel) !== null);
      this.canvas.classList.toggle('drawing', model.drawing);
    } else if (grip.kind === 'pan') {
      const by = (window.devicePixelRatio || 1) / this.scale;
      this.view.x -= (event.clientX - grip.last[0]) * by;
      this.view.y -= (event.clientY - grip.last[1]) * by;
      grip.last = [event.clientX, event.clientY];
    } else if (grip.kind === 'draw') {
      grip.to = pixel;
    } else {
      const solid = this.dragged(grip, pixel);
      if (solid) model.place(solid);
    }
    this.draw();
  }

  /** @param {Exclude<Grip, {kind: 'draw' | 'pan'}>} grip @param {Vec2} pixel @returns {Solid | null} */
  dragged(grip, pixel) {
    const { frame, scene } = this.model;
    const { solid } = grip;
    if (grip.kind === 'edge') {
      return edgeDragged(solid, frame, grip.edge, grip.along, [pixel[0] + grip.off[0], pixel[1] + grip.off[1]], scene.grounded);
    }
    const target = grip.kind === 'move' ? /** @type {Vec2} */ ([pixel[0] + grip.off[0], pixel[1] + grip.off[1]]) : pixel;
    const point = onPlane(frame, target, solid.base[2]);
    if (!point) return null;
    if (grip.kind === 'move') return { ...solid, base: point };
    return { ...solid, yaw: wrapped(Math.atan2(point[1] - solid.base[1], point[0] - solid.base[0])) };
  }

  up() {
    const { grip } = this;
    this.grip = null;
    if (grip?.kind !== 'draw') return;
    const { frame } = this.model;
    const inside = (/** @type {Vec2} */ [u, v]) => [Math.min(frame.width - 0.5, Math.max(-0.5, u)) + 0.5, Math.min(frame.height - 0.5, Math.max(-0.5, v)) + 0.5];
    const [a, b] = [inside(grip.from), inside(grip.to)];
    const box = [Math.min(a[0], b[0]), Math.min(a[1], b[1]), Math.abs(a[0] - b[0]), Math.abs(a[1] - b[1])];
    if (Math.min(box[2], box[3]) >= LEAST_BOX_PX) void this.model.drawn(box);
    this.draw();
  }

  /** @param {WheelEvent} event */
  wheel(event) {
    event.preventDefault();
    const pixel = this.pixel(event);
    const zoom = Math.min(MOST_ZOOM, Math.max(1, this.view.zoom * Math.exp(-event.deltaY / 400)));
    const ratio = this.view.zoom / zoom;
    this.view = { zoom, x: pixel[0] + 0.5 - (pixel[0] + 0.5 - this.view.x) * ratio, y: pixel[1] + 0.5 - (pixel[1] + 0.5 - this.view.y) * ratio };
    if (zoom === 1) this.whole(false);
    this.draw();
  }

  draw() {
    const { canvas, context, model } = this;
    const { frame, things, thing, scene } = model;
    const px = window.devicePixelRatio || 1;
    canvas.style.aspectRatio = `${frame.width} / ${frame.height}`;
    const width = Math.max(1, Math.round((canvas.clientWidth || 640) * px));
    const height = Math.round((width * frame.height) / frame.width);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    context.clearRect(0, 0, width, height);
    context.imageSmoothingEnabled = this.view.zoom < 4;
    if (this.image.complete && this.image.naturalWidth) {
      const [left, top] = this.place([-0.5, -0.5]);
      context.drawImage(this.image, left, top, frame.width * this.scale, frame.height * this.scale);
    }
    const outlines = this.outlinesOf(frame.name);
    for (const one of things) {
      if (outlines?.[one.name]) drawOutlines(context, outlines[one.name], this.place, one.colour);
      drawSolid(context, frame, one, this.place, one === thing ? 2 : 1.2);
      const box = one.boxes[frame.name];
      if (box) this.rectangle(box, one.colour, [5, 5]);
    }
    drawAxes(context, frame, thing, this.place);
    if (thing.solid && !model.drawing) this.handles(thing.solid, scene.grounded);
    if (this.grip?.kind === 'draw') {
      const [a, b] = [this.grip.from, this.grip.to];
      this.rectangle([a[0] + 0.5, a[1] + 0.5, b[0] - a[0], b[1] - a[1]], thing.colour, []);
    }
    if (model.bad.has(frame.name)) this.rectangle([2, 2, frame.width - 4, frame.height - 4], '#ff5050', [12, 8]);
  }

  /** Edges to take, the middle of the underside to move, and a knob to turn. @param {Solid} solid @param {boolean} grounded */
  handles(solid, grounded) {
    const { context, model } = this;
    if (solid.kind === 'cylinder') {
      for (const edge of EDGES) {
        if (movable(edge, grounded).length) line(context, ends(solid, edge).map((end) => project(model.frame, end)), this.place, '#ffffff', 1, [3, 5]);
      }
    }
    const taken = this.cursor && !this.grip ? this.at(this.cursor) : this.grip;
    if (taken?.kind === 'edge') line(context, ends(solid, taken.edge).map((end) => project(model.frame, end)), this.place, '#ffffff', 3);
    const [base, knob] = [project(model.frame, solid.base), this.knob(solid)];
    if (base && knob) line(context, [base, knob], this.place, '#ffffff', 1, [2, 4]);
    if (base) dot(context, this.place(base), 6, taken?.kind === 'move' ? '#ffd43b' : '#ffffff');
    if (knob) dot(context, this.place(knob), 6, taken?.kind === 'turn' ? '#ffd43b' : '#ffffff', false);
  }

  /** @param {number[]} box @param {string} colour @param {number[]} dash */
  rectangle([x, y, w, h], colour, dash) {
    /** @type {Vec2[]} */
    const corners = [[x, y], [x + w, y], [x + w, y + h], [x, y + h], [x, y]];
    line(this.context, corners.map(([u, v]) => /** @type {Vec2} */ ([u - 0.5, v - 0.5])), this.place, colour, 1.5, dash);
  }
}

/** Where along an edge of the solid a pixel is: a share of the edge in the photo is another one in space. @param {Model} model @param {Edge} edge @param {Vec2} pixel @param {number} inPhoto */
function alongInSpace({ frame, thing }, edge, pixel, inPhoto) {
  if (!thing.solid) return inPhoto;
  const [a, b] = ends(thing.solid, edge);
  let best = { apart: Infinity, along: inPhoto };
  for (let k = 0; k <= 64; k += 1) {
    const along = k / 64;
    const seen = project(frame, [0, 1, 2].reduce((point, axis) => ((point[axis] = a[axis] + along * (b[axis] - a[axis])), point), /** @type {[number, number, number]} */ ([0, 0, 0])));
    const apart = seen ? distance(seen, pixel) : Infinity;
    if (apart < best.apart) best = { apart, along };
  }
  return best.along;
}

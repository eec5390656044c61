// @ts-check
// What is drawn so far: of one scene at a time, with a way back.

import { fit } from './api.js';
import { asEntry, ofEntry, standing } from './solid.js';

/** @typedef {import('./api.js').Entry} Entry */
/** @typedef {import('./api.js').Project} Project */
/** @typedef {import('./api.js').Scene} Scene */
/** @typedef {import('./geometry.js').Frame} Frame */
/** @typedef {import('./solid.js').Solid} Solid */
/** An object. `kind` is empty where the boxes are to tell it; `byHand`: the solid is as it was placed, not by the boxes alone.
 * @typedef {{
 *   name: string, colour: string, kind: '' | 'box' | 'cylinder', boxes: Record<string, number[]>, solid: Solid | null, byHand: boolean,
 *   up: string, symmetries: string[], measured_mm: number[],
 * }} Thing */

const COLOURS = ['#3cdc3c', '#ffa028', '#6fa8ff', '#dc3cdc', '#28dcdc', '#ffff50'];
const LEAST_BOXES = 2;
const WAYS_BACK = 100;

export class Model extends EventTarget {
  /** @param {Project} project */
  constructor(project) {
    super();
    this.project = project;
    /** Whether the person wants to draw a box; if not said, it follows from what there is. @type {boolean | null} */
    this.asksToDraw = null;
    this.unsaved = false;
    this.scene = project.scenes[0];
    /** @type {Thing[]} */
    this.things = [];
    /** Names of photos. @type {Set<string>} */
    this.bad = new Set();
    this.active = 0;
    this.photo = 0;
    /** The object whose boxes are being fitted. */
    this.fitting = '';
    /** What was before. @type {string[]} */
    this.back = [];
    this.open(this.scene.name);
  }

  /** @param {string} name of a scene */
  open(name) {
    this.scene = this.project.scenes.find((scene) => scene.name === name) ?? this.project.scenes[0];
    this.things = this.project.objects.map((item, k) => {
      const drawn = this.scene.drawn[item.name] ?? {};
      const solid = ofEntry(drawn);
      return {
        name: item.name,
        colour: COLOURS[k % COLOURS.length],
        kind: drawn.solid ?? '',
        boxes: { ...drawn.boxes },
        solid,
        byHand: solid !== null,
        up: drawn.up ?? item.up,
        symmetries: drawn.symmetries ?? item.symmetries,
        measured_mm: item.size_mm,
      };
    });
    this.bad = new Set(this.scene.bad);
    this.active = 0;
    this.photo = 0;
    this.back = [];
    this.unsaved = false;
    for (const thing of this.things) if (!thing.solid && Object.keys(thing.boxes).length >= LEAST_BOXES) void this.refit(thing);
    this.changed(false);
  }

  get frame() {
    return this.scene.frames[this.photo];
  }

  get thing() {
    return this.things[this.active];
  }

  /** Whether dragging draws a box: until there is one in two photos, it does in every other photo. */
  get drawing() {
    const { solid, byHand, boxes } = this.thing;
    if (!solid) return true;
    return this.asksToDraw ?? (!byHand && Object.keys(boxes).length < LEAST_BOXES && !boxes[this.frame.name]);
  }

  /** Opens a photo. @param {number} photo */
  turnTo(photo) {
    const { length } = this.scene.frames;
    this.photo = (photo + length) % length;
    if (this.asksToDraw === false) this.asksToDraw = null;
    this.changed(false);
  }

  /** Tells all who show it. */
  changed(unsaved = true) {
    this.unsaved ||= unsaved;
    this.dispatchEvent(new Event('change'));
  }

  /** Before something is changed. */
  remember() {
    const now = JSON.stringify([this.things, [...this.bad]]);
    if (this.back[this.back.length - 1] !== now) this.back.push(now);
    if (this.back.length > WAYS_BACK) this.back.shift();
  }

  undo() {
    const before = this.back.pop();
    if (!before) return;
    const [things, bad] = JSON.parse(before);
    this.things = things;
    this.bad = new Set(bad);
    this.changed();
  }

  /** Places the active object by hand. @param {Solid} solid */
  place(solid) {
    Object.assign(this.thing, { solid, byHand: true, kind: solid.kind });
    this.changed();
  }

  /** Takes a box drawn in the photo: x, y, width, height. @param {number[]} box */
  async drawn(box) {
    const { thing, frame } = this;
    this.remember();
    thing.boxes[frame.name] = box.map((value) => Math.round(value * 10) / 10);
    this.asksToDraw = null;
    if (Object.keys(thing.boxes).length < LEAST_BOXES) {
      if (this.scene.grounded) thing.solid = standing(frame, box, thing.kind || 'box');
      thing.byHand = false;
      this.changed();
    } else {
      await this.refit(thing);
    }
  }

  /** Lets the boxes tell the solid. @param {Thing} thing */
  async refit(thing) {
    const before = thing.solid;
    this.fitting = thing.name;
    this.changed();
    try {
      const asked = { scene: this.scene.name, object: thing.name, boxes: thing.boxes, ...(thing.kind && { solid: thing.kind }) };
      const found = ofEntry(await fit(asked));
      // Whoever has placed it by hand meanwhile knows better.
      if (thing.solid === before) Object.assign(thing, { solid: found, byHand: false });
      this.trouble('');
    } catch (error) {
      this.trouble(`${thing.name}: ${/** @type {Error} */ (error).message}`);
    }
    this.fitting = '';
    this.changed();
  }

  /** Says what went wrong, or no more. @param {string} words */
  trouble(words) {
    this.dispatchEvent(new CustomEvent('trouble', { detail: words }));
  }

  /** Takes away all that was drawn of the active object. */
  clear() {
    this.remember();
    Object.assign(this.thing, { boxes: {}, solid: null, byHand: false });
    this.changed();
  }

  /** @param {string} photo */
  toggleBad(photo) {
    this.remember();
    if (!this.bad.delete(photo)) this.bad.add(photo);
    this.changed();
  }

  /** What has been placed, for outlines. @returns {Record<string, Entry>} */
  placed() {
    return Object.fromEntries(this.things.flatMap(({ name, solid }) => (solid ? [[name, asEntry(solid, this.scene.name)]] : [])));
  }

  /** What the file will hold. */
  asked() {
    const entries = this.things.flatMap(({ name, kind, boxes, solid, byHand, up, symmetries }) => {
      const more = { up, symmetries };
      if (!byHand && Object.keys(boxes).length >= LEAST_BOXES) return [[name, { ...(kind && { solid: kind }), boxes, ...more }]];
      return solid ? [[name, { ...asEntry(solid, this.scene.name), ...more }]] : [];
    });
    return { scene: this.scene.name, objects: /** @type {Record<string, Entry>} */ (Object.fromEntries(entries)), bad: [...this.bad] };
  }
}

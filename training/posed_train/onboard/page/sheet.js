// @ts-check
// All photos, small, each with the solids and, as they come, the outlines that the colours tell.

import { imageOf, outline } from './api.js';
import { byId, h } from './elements.js';
import { drawOutlines, drawSolid } from './overlay.js';

/** @typedef {import('./geometry.js').Vec2} Vec2 */
/** @typedef {import('./geometry.js').Frame} Frame */
/** @typedef {import('./model.js').Model} Model */
/** @typedef {{button: HTMLButtonElement, canvas: HTMLCanvasElement, frame: Frame, image: HTMLImageElement, visible: boolean}} Tile */

const WAIT_MS = 350;
const AT_ONCE = 2;

export class Sheet {
  /** @param {Model} model @param {() => void} open */
  constructor(model, open) {
    this.model = model;
    this.open = open;
    this.scene = '';
    /** @type {Tile[]} */
    this.tiles = [];
    /** By photo: of which solids they are. @type {Map<string, {of: string, found: Record<string, [number, number][][]>}>} */
    this.outlines = new Map();
    this.asking = 0;
    this.timer = 0;
    this.observer = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        const tile = this.tiles.find(({ button }) => button === target);
        if (!tile) continue;
        tile.visible = isIntersecting;
        if (isIntersecting) this.draw(tile);
      }
      this.ask();
    }, { rootMargin: '200px' });
    model.addEventListener('change', () => this.show());
    this.show();
  }

  /** Outlines of the solids as they are now, in a photo. @param {string} photo */
  outlinesOf = (photo) => {
    const known = this.outlines.get(photo);
    return known && known.of === this.current() ? known.found : null;
  };

  current() {
    return JSON.stringify(this.model.placed());
  }

  show() {
    const { scene, bad, photo } = this.model;
    if (scene.name !== this.scene) this.build();
    this.tiles.forEach((tile, k) => {
      tile.button.classList.toggle('bad', bad.has(tile.frame.name));
      if (k === photo) tile.button.setAttribute('aria-current', 'true');
      else tile.button.removeAttribute('aria-current');
      if (tile.visible) this.draw(tile);
    });
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.ask(), WAIT_MS);
  }

  build() {
    const { scene } = this.model;
    this.scene = scene.name;
    this.outlines.clear();
    this.observer.disconnect();
    this.tiles = scene.frames.map((frame, k) => {
      const canvas = h('canvas', { 'aria-hidden': 'true' });
      const choose = () => {
        this.model.turnTo(k);
        this.open();
      };
      const button = h('button', { type: 'button', class: 'photo', click: choose }, canvas, h('span', {}, frame.name));
      return { button, canvas, frame, image: new Image(), visible: false };
    });
    byId('sheet', HTMLElement).replaceChildren(...this.tiles.map(({ button }) => button));
    for (const { button } of this.tiles) this.observer.observe(button);
  }

  /** @param {Tile} tile */
  draw(tile) {
    const { canvas, frame, image } = tile;
    if (!image.src) {
      image.addEventListener('load', () => this.draw(tile));
      image.src = imageOf(this.scene, frame, true);
    }
    const width = Math.max(1, Math.round(canvas.clientWidth * (window.devicePixelRatio || 1)));
    Object.assign(canvas, { width, height: Math.round((width * frame.height) / frame.width) });
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext('2d'));
    if (image.complete && image.naturalWidth) context.drawImage(image, 0, 0, canvas.width, canvas.height);
    const by = width / frame.width;
    const place = (/** @type {Vec2} */ [u, v]) => /** @type {Vec2} */ ([(u + 0.5) * by, (v + 0.5) * by]);
    const outlines = this.outlinesOf(frame.name);
    for (const thing of this.model.things) {
      if (outlines?.[thing.name]) drawOutlines(context, outlines[thing.name], place, thing.colour);
      drawSolid(context, frame, thing, place, 1);
    }
  }

  /** Outlines of the open photo first, then of those that can be seen. */
  async ask() {
    if (this.asking >= AT_ONCE) return;
    const objects = this.model.placed();
    const of = JSON.stringify(objects);
    if (of === '{}') return;
    const { scene, frame } = this.model;
    const wanted = [frame, ...this.tiles.filter(({ visible }) => visible).map((tile) => tile.frame)];
    const next = wanted.find(({ name }) => this.outlines.get(name)?.of !== of);
    if (!next) return;
    // Said before it is known, so that nobody asks twice.
    this.outlines.set(next.name, { of, found: {} });
    this.asking += 1;
    try {
      this.outlines.set(next.name, { of, found: await outline({ scene: scene.name, photo: next.name, objects }) });
      if (of === this.current()) this.model.dispatchEvent(new Event('outlines'));
      const tile = this.tiles.find(({ frame: { name } }) => name === next.name);
      if (tile?.visible) this.draw(tile);
    } catch (error) {
      this.model.trouble(/** @type {Error} */ (error).message);
    } finally {
      this.asking -= 1;
    }
    void this.ask();
    void this.ask();
  }
}

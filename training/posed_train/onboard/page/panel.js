// @ts-check
// The fields beside the photo: which object, its size, place and axes, and how it looks the same.

import { byId, h, labelled } from './elements.js';
import { axesOfBox } from './overlay.js';
import { turnedAxes, wrapped } from './solid.js';

/** @typedef {import('./model.js').Model} Model */
/** @typedef {import('./solid.js').Solid} Solid */

const DEGREES = 180 / Math.PI;
const UPS = ['z', 'y', 'x', '-z', '-y', '-x'];
const TURNS = [['', 'never'], ['2', 'half a turn'], ['3', 'a third'], ['4', 'a quarter'], ['6', 'a sixth'], ['any', 'any turn']];
/** Fields of a solid, in mm or degrees: how they are read and written.
 * @type {Record<string, {get: (solid: Solid) => number, set: (solid: Solid, value: number) => Solid}>} */
const FIELDS = {
  ...Object.fromEntries(['length', 'width', 'height'].map((name, axis) => [name, {
    get: (/** @type {Solid} */ { size }) => size[axis] * 1000,
    set: (/** @type {Solid} */ solid, /** @type {number} */ value) => ({ ...solid, size: replaced(solid.size, axis, Math.max(value, 2) / 1000) }),
  }])),
  ...Object.fromEntries(['x', 'y', 'z'].map((name, axis) => [name, {
    get: (/** @type {Solid} */ { base }) => base[axis] * 1000,
    set: (/** @type {Solid} */ solid, /** @type {number} */ value) => ({ ...solid, base: replaced(solid.base, axis, value / 1000) }),
  }])),
  turn: {
    get: ({ yaw }) => yaw * DEGREES,
    set: (solid, value) => ({ ...solid, yaw: wrapped(value / DEGREES) }),
  },
};

/** @type {(values: [number, number, number], at: number, value: number) => [number, number, number]} */
const replaced = (values, at, value) => /** @type {[number, number, number]} */ (values.map((old, k) => (k === at ? value : old)));

/** @param {Model} model */
export function panel(model) {
  const root = byId('panel', HTMLElement);
  /** @type {Record<string, HTMLInputElement>} */
  const inputs = {};
  /** @type {Record<string, HTMLSelectElement>} */
  const turns = {};

  /** @param {string} name @param {string} words */
  function field(name, words) {
    inputs[name] = h('input', { type: 'text', inputmode: 'decimal', autocomplete: 'off', change: () => typed(name) });
    return labelled(words, inputs[name]);
  }

  /** @param {string} name */
  function typed(name) {
    const value = Number(inputs[name].value.trim().replace(',', '.').replace('−', '-'));
    const { solid } = model.thing;
    if (!solid || inputs[name].value.trim() === '' || !Number.isFinite(value)) return show();
    model.remember();
    model.place(FIELDS[name].set(solid, value));
  }

  const kind = h('select', {
    change: () => {
      model.remember();
      const { thing } = model;
      thing.kind = /** @type {'' | 'box' | 'cylinder'} */ (kind.value);
      const boxes = Object.keys(thing.boxes).length;
      if (thing.solid && (thing.byHand || boxes < 2) && thing.kind) thing.solid = { ...thing.solid, kind: thing.kind };
      if (!thing.byHand && boxes > 1) void model.refit(thing);
      else model.changed();
    },
  }, h('option', { value: '' }, 'as the boxes tell'), h('option', { value: 'box' }, 'box'), h('option', { value: 'cylinder' }, 'cylinder'));

  const up = h('select', { change: () => changed(() => (model.thing.up = up.value)) }, ...UPS.map((name) => h('option', { value: name }, name.replace('-', '−'))));

  /** @param {() => void} change */
  function changed(change) {
    model.remember();
    change();
    model.changed();
  }

  function readTurns() {
    changed(() => {
      model.thing.symmetries = ['x', 'y', 'z'].flatMap((axis) => {
        const count = turns[axis].value;
        return count === 'any' ? [axis] : count ? [axis + count] : [];
      });
    });
  }

  const turnSelects = ['x', 'y', 'z'].map((axis) => {
    turns[axis] = h('select', { change: readTurns }, ...TURNS.map(([value, words]) => h('option', { value }, words)));
    return labelled(`about ${axis}`, turns[axis]);
  });

  const quarter = h('button', { type: 'button', click: () => {
    const { solid } = model.thing;
    if (!solid) return;
    model.remember();
    model.place(turnedAxes(solid));
  } }, 'Turn the axes by 90°');
  const anew = h('button', { type: 'button', click: () => model.clear() }, 'Start anew');
  const back = h('button', { type: 'button', click: () => model.undo() }, 'Undo');
  const byBoxes = h('button', { type: 'button', click: () => {
    model.remember();
    void model.refit(model.thing);
  } }, 'Fit to the drawn boxes');
  const origin = h('small', { id: 'origin' });
  const named = h('span', { id: 'axes' });
  const objects = h('fieldset', {}, h('legend', {}, 'Object'));
  const heightField = field('z', 'z');

  root.replaceChildren(
    objects,
    h('fieldset', {}, h('legend', {}, 'Box, mm'), labelled('shape', kind),
      h('div', { class: 'row' }, field('length', 'length'), field('width', 'width'), field('height', 'height')),
      h('div', { class: 'row' }, field('x', 'x'), field('y', 'y'), heightField, field('turn', 'turn, degrees')),
      h('div', { class: 'row' }, back, byBoxes, anew), origin),
    h('fieldset', {}, h('legend', {}, 'Its frame'),
      h('p', { class: 'note' }, 'The box is the object’s frame: its middle is the origin. ', named),
      h('div', { class: 'row' }, labelled('axis that points up', up), quarter)),
    h('fieldset', {}, h('legend', {}, 'Looks the same after a turn'), h('div', { class: 'row' }, ...turnSelects),
      h('small', {}, 'Any turn about an axis: it is round (an axis of revolution).')),
  );

  function showObjects() {
    const choices = model.things.map((thing, k) => {
      const radio = h('input', { type: 'radio', name: 'object', value: thing.name, checked: k === model.active, change: () => {
        model.active = k;
        model.asksToDraw = null;
        model.changed(false);
      } });
      const swatch = h('span', { class: 'swatch' });
      swatch.style.background = thing.colour;
      return h('label', { class: 'choice' }, radio, swatch, `${thing.name} ${thing.solid ? '✓' : ''}`);
    });
    objects.replaceChildren(objects.children[0], ...choices);
  }

  function show() {
    const { thing, scene } = model;
    const focused = document.activeElement;
    if (!(focused instanceof HTMLInputElement && focused.type === 'radio' && objects.contains(focused))) showObjects();
    for (const [name, input] of Object.entries(inputs)) {
      input.disabled = !thing.solid;
      const value = thing.solid ? FIELDS[name].get(thing.solid).toFixed(1) : '';
      if (input !== focused) input.value = value;
    }
    heightField.hidden = scene.grounded;
    kind.value = thing.kind;
    up.value = thing.up;
    const along = axesOfBox(thing.up).map((direction) => ['length', 'width', 'height'][direction.findIndex((value) => value !== 0)]);
    named.textContent = `x is along its ${along[0]}, y along its ${along[1]}, z along its ${along[2]}.`;
    for (const axis of ['x', 'y', 'z']) {
      const told = thing.symmetries.find((one) => one.startsWith(axis));
      turns[axis].value = told === undefined ? '' : told.slice(1) || 'any';
    }
    const boxes = Object.keys(thing.boxes).length;
    quarter.disabled = !thing.solid;
    anew.disabled = !thing.solid && !boxes;
    back.disabled = !model.back.length;
    byBoxes.hidden = boxes < 2 || !thing.byHand;
    origin.textContent = model.fitting === thing.name ? 'Fitting…' : !thing.solid ? '' : thing.byHand ? 'Placed by hand: the object gets exactly this box.'
      : boxes > 1 ? `By ${boxes} drawn boxes; the outlines in all photos ${measured(thing.measured_mm)}.` : 'A guess by one drawn box: draw one from another side, or drag its edges.';
  }
  model.addEventListener('change', show);
  show();
}

/**
 * The box that is shown is that of the drawn ones: what `label` made of it may be another.
 * @param {number[]} sides
 */
const measured = (sides) => sides.length ? `measured ${sides.map((side) => side.toFixed(1)).join(' × ')} mm` : 'will measure it';

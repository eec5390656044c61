// @ts-check
// Which camera took an image: a registered one, its numbers, or a guess that is marked as one.

import { cameras, inWords } from './api.js';
import { doubts, fieldOfView, guessed } from './camera.js';
import { h, labelled, numberField } from './elements.js';

/** @typedef {import('./camera.js').Camera} Camera */
/** @typedef {import('./api.js').CameraChoice} CameraChoice */
/** What was chosen: for requests, for drawing, and whether it is only a guess. */
/** @typedef {{choice: CameraChoice, camera: Camera, isGuess: boolean}} Chosen */

const KINDS = [
  ['registered', 'Registered'],
  ['numbers', 'Numbers'],
  ['guess', 'Not calibrated: guess'],
];
const DEFAULT_FIELD_OF_VIEW = '60';

export class CameraField {
  /**
   * @param {string} legend
   * @param {() => void} change
   */
  constructor(legend, change) {
    this.change = () => {
      this.show();
      change();
    };
    /** @type {Record<string, Camera>} */
    this.registered = {};
    /** @type {{width: number, height: number} | null} */
    this.image = null;
    const name = `camera-${Math.random().toString(36).slice(2)}`;
    this.kinds = KINDS.map(([value, words]) => {
      const radio = h('input', { type: 'radio', name, value, change: this.change });
      return { radio, label: h('label', { class: 'choice' }, radio, ` ${words}`) };
    });
    this.select = h('select', { change: this.change });
    const names = /** @type {const} */ (['fx', 'fy', 'cx', 'cy']);
    this.numbers = names.map((field) => ({ name: field, ...numberField(field, this.change) }));
    this.lens = h('select', { change: this.change },
      h('option', { value: 'pinhole' }, 'no distortion'),
      h('option', { value: 'opencv' }, 'OpenCV: k1 k2 p1 p2 k3 …'),
      h('option', { value: 'fisheye' }, 'fisheye: k1 k2 k3 k4'));
    this.coefficients = h('input', { type: 'text', autocomplete: 'off', input: this.change });
    this.coefficientsField = labelled('coefficients', this.coefficients);
    this.degrees = numberField('field of view across, degrees', this.change, DEFAULT_FIELD_OF_VIEW);
    this.parts = {
      registered: labelled('camera', this.select),
      numbers: h('div', { class: 'row' }, ...this.numbers.map(({ field }) => field), labelled('lens', this.lens), this.coefficientsField),
      guess: this.degrees.field,
    };
    this.note = h('p', { class: 'note', 'aria-live': 'polite' });
    this.element = h('fieldset', {}, h('legend', {}, legend), h('div', { class: 'row' }, ...this.kinds.map(({ label }) => label)),
      ...Object.values(this.parts), this.note);
    this.pick('guess');
  }

  /** Asks the server for its cameras; the first is chosen. Once: what was chosen later stays. */
  async load() {
    if (Object.keys(this.registered).length > 0) return;
    try {
      this.registered = await cameras();
    } catch (error) {
      this.note.textContent = inWords(error);
      return;
    }
    const ids = Object.keys(this.registered);
    this.kinds[0].radio.disabled = ids.length === 0;
    if (ids.length === 0) return;
    this.select.replaceChildren(...ids.map((id) => h('option', {}, id)));
    this.pick('registered');
    this.change();
  }

  /** @param {string} kind */
  pick(kind) {
    for (const { radio } of this.kinds) radio.checked = radio.value === kind;
    this.show();
  }

  /** Takes over a camera that is known: the registered one that equals it, or its numbers. @param {Camera} camera */
  set(camera) {
    const same = Object.entries(this.registered).find(([, known]) => JSON.stringify(known) === JSON.stringify(camera));
    if (same) this.select.value = same[0];
    for (const { name, input } of this.numbers) input.value = String(camera[name]);
    this.lens.value = camera.model ?? 'pinhole';
    this.coefficients.value = (camera.distortion ?? []).join(' ');
    this.pick(same ? 'registered' : 'numbers');
    this.change();
  }

  /** The image it belongs to. @param {{width: number, height: number} | null} image */
  belongsTo(image) {
    this.image = image;
    this.show();
  }

  kind() {
    return this.kinds.find(({ radio }) => radio.checked)?.radio.value ?? 'guess';
  }

  /** The camera, or a sentence that says what is missing. @returns {Chosen | string} */
  get() {
    const size = this.image ?? { width: 640, height: 480 };
    if (this.kind() === 'registered') {
      const camera = this.registered[this.select.value];
      return camera ? { choice: this.select.value, camera, isGuess: false } : 'Choose a registered camera.';
    }
    if (this.kind() === 'guess') {
      const degrees = Number(this.degrees.input.value);
      if (!(degrees >= 1 && degrees <= 170)) return 'The field of view must be between 1 and 170 degrees.';
      const { width, height, ...camera } = guessed(degrees, size.width, size.height);
      return { choice: camera, camera, isGuess: true };
    }
    return this.fromNumbers();
  }

  /** @returns {Chosen | string} */
  fromNumbers() {
    const values = this.numbers.map(({ input }) => (input.value.trim() ? Number(input.value) : NaN));
    const missing = this.numbers.filter((_, index) => !Number.isFinite(values[index])).map(({ name }) => name);
    if (missing.length > 0) return `Give numbers for ${missing.join(', ')} of the camera, in pixels of the image.`;
    const [fx, fy, cx, cy] = values;
    const model = /** @type {Camera['model']} */ (this.lens.value);
    /** @type {Camera} */
    const camera = { model, fx, fy, cx, cy };
    if (model !== 'pinhole') {
      const distortion = this.coefficients.value.split(/[\s,;]+/).filter(Boolean).map(Number);
      if (distortion.length === 0 || distortion.some(Number.isNaN)) return 'Give the coefficients of the lens, separated by spaces.';
      camera.distortion = distortion;
    }
    return { choice: camera, camera, isGuess: false };
  }

  show() {
    const kind = this.kind();
    for (const [name, part] of Object.entries(this.parts)) part.hidden = name !== kind;
    this.coefficientsField.hidden = this.lens.value === 'pinhole';
    const chosen = this.get();
    if (typeof chosen === 'string') {
      this.note.textContent = chosen;
      return;
    }
    const size = this.image ?? (chosen.camera.width && chosen.camera.height ? { width: chosen.camera.width, height: chosen.camera.height } : null);
    const words = chosen.isGuess ? ['A guess. Distances are only as right as it is; calibrate the camera before you use a pose.'] : [];
    if (size && !chosen.isGuess) {
      const [across, down] = fieldOfView(chosen.camera, size.width, size.height);
      words.push(`Field of view ${across.toFixed(0)}° × ${down.toFixed(0)}°.`);
    }
    const wrong = this.image ? doubts(chosen.camera, this.image.width, this.image.height) : [];
    this.note.replaceChildren(words.join(' '), ...wrong.map((sentence) => h('strong', {}, ` ${sentence}`)));
  }
}

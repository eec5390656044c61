// @ts-check
// How two cameras stand to each other: a rig, two poses, or a board's scene_camera.json.

import { h, labelled, problem } from './elements.js';
import { fileButton } from './images.js';
import { compose, fromQuaternion, inverse, isRotation } from './geometry.js';
import { inWords } from './api.js';

/** @typedef {import('./geometry.js').Pose} Pose */
/** @typedef {import('./geometry.js').Mat3} Mat3 */
/** @typedef {import('./camera.js').Camera} Camera */

const KINDS = [
  ['rig', 'A rig: one relative pose'],
  ['poses', 'Two poses of the cameras'],
  ['board', 'scene_camera.json of a board'],
];
const FORMS = 'As {"rotation_xyzw": […], "translation_m": […]}, or a 4 × 4 matrix in metres, row by row.';
const EXAMPLE = '{"rotation_xyzw": [0, 0.1, 0, 0.995], "translation_m": [-0.1, 0, 0.02]}';

/** A pose in any of the forms that people have. @type {(text: string) => Pose} */
export function readPose(text) {
  const trimmed = text.trim();
  if (!trimmed) throw new Error('It is empty.');
  const isJson = trimmed.startsWith('{') || trimmed.startsWith('[');
  let value;
  try {
    value = isJson ? JSON.parse(trimmed) : trimmed.split(/[\s,;]+/).map(Number);
  } catch {
    throw new Error('It is no valid JSON.');
  }
  if (Array.isArray(value)) return ofMatrix(value.flat(Infinity));
  if (value.cam_R_w2c && value.cam_t_w2c) return ofBop(value);
  if (value.matrix) return ofMatrix(value.matrix.flat(Infinity));
  const { rotation_xyzw: q, translation_m: t } = value;
  const numbers = (/** @type {unknown} */ list, /** @type {number} */ count) => Array.isArray(list) && list.length === count && list.every(Number.isFinite);
  if (!numbers(q, 4) || !numbers(t, 3)) throw new Error('It needs rotation_xyzw with 4 numbers and translation_m with 3.');
  if (Math.abs(Math.hypot(...q) - 1) > 0.01) throw new Error('Its quaternion does not have length 1.');
  return fromQuaternion(q, t);
}

/** @param {number[]} m @returns {Pose} */
function ofMatrix(m) {
  if (![12, 16].includes(m.length) || !m.every(Number.isFinite)) throw new Error(`A matrix has 16 numbers (or 12 without its last row); these are ${m.length}.`);
  return checked([[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]], [m[3], m[7], m[11]]);
}

/** Camera from world, millimetres. @param {{cam_R_w2c: number[], cam_t_w2c: number[]}} entry @returns {Pose} */
function ofBop({ cam_R_w2c: r, cam_t_w2c: t }) {
  const millimetres = t.map((value) => value / 1e3);
  return checked([[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]], /** @type {[number, number, number]} */ (millimetres));
}

/** @param {Mat3} rotation @param {[number, number, number]} translation */
function checked(rotation, translation) {
  if (!isRotation(rotation)) throw new Error('Its upper left 3 × 3 numbers are no rotation. Is it written row by row?');
  return { rotation, translation };
}

export class RelativePose {
  /**
   * @param {() => void} change
   * @param {(first: Camera, second: Camera) => void} takeCameras
   */
  constructor(change, takeCameras) {
    this.change = change;
    this.takeCameras = takeCameras;
    /** @type {Record<string, {cam_K?: number[], cam_R_w2c: number[], cam_t_w2c: number[]}>} */
    this.scene = {};
    this.kinds = KINDS.map(([value, words]) => {
      const radio = h('input', { type: 'radio', name: 'relative', value, checked: value === 'rig', change: () => this.update() });
      return { radio, label: h('label', { class: 'choice' }, radio, ` ${words}`) };
    });
    const area = () => h('textarea', { rows: '3', spellcheck: 'false', autocomplete: 'off', input: () => this.update() });
    this.rig = area();
    this.first = area();
    this.second = area();
    this.rig.placeholder = EXAMPLE;
    this.direction = h('select', { change: () => this.update() },
      h('option', { value: 'world' }, 'world from camera (a robot’s base from its camera)'),
      h('option', { value: 'camera' }, 'camera from world (a board, OpenCV’s solvePnP)'));
    const ids = () => h('select', { change: () => this.useScene() });
    this.firstId = ids();
    this.secondId = ids();
    this.parts = {
      rig: labelled('second from first', this.rig, `Pose of the first camera in the frame of the second. ${FORMS}`),
      poses: h('div', {}, labelled('which way the poses go', this.direction), labelled('pose of the first camera', this.first, FORMS), labelled('pose of the second camera', this.second)),
      board: h('div', { class: 'row' }, fileButton('Choose scene_camera.json', (file) => void this.readScene(file), '.json,application/json'),
        labelled('first image', this.firstId), labelled('second image', this.secondId)),
    };
    this.said = h('div');
    this.element = h('fieldset', {}, h('legend', {}, 'How the cameras stand to each other'),
      h('div', { class: 'row' }, ...this.kinds.map(({ label }) => label)), ...Object.values(this.parts), this.said);
    this.show();
  }

  kind() {
    return this.kinds.find(({ radio }) => radio.checked)?.radio.value ?? 'rig';
  }

  show() {
    for (const [name, part] of Object.entries(this.parts)) part.hidden = name !== this.kind();
  }

  update() {
    this.show();
    const found = this.get();
    this.said.replaceChildren(...(typeof found === 'string' && this.isStarted() ? [problem(found)] : []));
    this.change();
  }

  /** Whether anything was given, so that words about it are no surprise. */
  isStarted() {
    return { rig: this.rig.value, poses: this.first.value || this.second.value, board: this.firstId.value }[this.kind()];
  }

  /** @param {object} pose */
  setRig(pose) {
    for (const { radio } of this.kinds) radio.checked = radio.value === 'rig';
    this.rig.value = JSON.stringify(pose);
    this.update();
  }

  /** @param {File} file */
  async readScene(file) {
    try {
      this.scene = JSON.parse(await file.text());
      const usable = Object.entries(this.scene).filter(([, entry]) => entry?.cam_R_w2c && entry.cam_t_w2c);
      if (usable.length < 2) throw new Error('It has no two images with cam_R_w2c and cam_t_w2c.');
      for (const select of [this.firstId, this.secondId]) select.replaceChildren(...usable.map(([id]) => h('option', {}, id)));
      this.secondId.selectedIndex = 1;
      this.useScene();
    } catch (error) {
      this.said.replaceChildren(problem(`${file.name}: ${inWords(error)}`));
    }
  }

  useScene() {
    const [first, second] = [this.scene[this.firstId.value], this.scene[this.secondId.value]];
    const camera = (/** @type {number[] | undefined} */ k) => k && /** @type {Camera} */ ({ model: 'pinhole', fx: k[0], fy: k[4], cx: k[2], cy: k[5] });
    const [a, b] = [camera(first?.cam_K), camera(second?.cam_K)];
    if (a && b) this.takeCameras(a, b);
    this.update();
  }

  /** The pose of the first camera in the frame of the second, or what is wrong. @returns {Pose | string} */
  get() {
    const read = (/** @type {string} */ what, /** @type {string} */ text) => {
      try {
        return readPose(text);
      } catch (error) {
        return `${what}: ${inWords(error)}`;
      }
    };
    const from = () => {
      if (this.kind() === 'rig') return read('Second from first', this.rig.value);
      const board = this.kind() === 'board';
      if (board && !this.firstId.value) return 'Choose scene_camera.json.';
      const text = (/** @type {string} */ id) => JSON.stringify(this.scene[id]);
      const first = read('First camera', board ? text(this.firstId.value) : this.first.value);
      if (typeof first === 'string') return first;
      const second = read('Second camera', board ? text(this.secondId.value) : this.second.value);
      if (typeof second === 'string') return second;
      const cameraFromWorld = board || this.direction.value === 'camera';
      return cameraFromWorld ? compose(second, inverse(first)) : compose(inverse(second), first);
    };
    const pose = from();
    if (typeof pose === 'string') return pose;
    const apart = Math.hypot(...pose.translation);
    if (apart < 1e-4) return 'The cameras stand in one place; nothing can be triangulated from there.';
    return apart > 20 ? `The cameras stand ${apart.toFixed(0)} m apart. Are the translations in millimetres? Give metres.` : pose;
  }
}

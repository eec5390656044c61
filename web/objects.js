// @ts-check
// The view Objects: what the server knows of each, and what is missing.

import { inWords, objects, referenceImage } from './api.js';
import { byId, h, problem } from './elements.js';
import { fromQuaternion } from './geometry.js';
import { picture } from './images.js';
import { Sheet } from './overlay.js';
import { symmetry } from './words.js';

/** @typedef {import('./types').components['schemas']} Schemas */

export function objectsView() {
  const list = byId('objects-list', HTMLElement);
  return {
    async load() {
      try {
        const known = await objects();
        list.replaceChildren(...known.map(card));
        if (known.length === 0) list.replaceChildren(problem('The detector knows no object that has a model folder.'));
      } catch (error) {
        list.replaceChildren(problem(inWords(error)));
      }
    },
  };
}

/** @param {Schemas['ObjectReport']} object */
function card(object) {
  const { name, calibrated, reference, reference_problem, training } = object;
  const facts = [
    ['diameter', `${(1e3 * object.diameter_m).toFixed(1)} mm`],
    ['keypoints', String(object.keypoints)],
    ['symmetry', symmetry(object)],
    ['number in BOP files', String(object.obj_id)],
    ['keypoint net', h('code', {}, object.model_sha256)],
    ...(reference ? [['reference', h('code', {}, reference.sha256)]] : []),
  ];
  return h('article', { class: 'card', 'aria-labelledby': `object-${name}` },
    h('h2', { id: `object-${name}` }, name, ' ', h('span', { class: `status ${calibrated ? 'ok' : 'rejected'}` }, calibrated ? 'calibrated' : 'not calibrated')),
    calibrated ? null : missing(name, reference_problem),
    h('dl', {}, ...facts.flatMap(([term, value]) => [h('dt', {}, term), h('dd', {}, value)])),
    ...(reference ? referenceParts(object, reference) : []),
    ...trainingParts(training));
}

/** @param {string} name @param {string | null | undefined} why */
function missing(name, why) {
  return h('div', {},
    h('p', {}, `No pose of this object is answered: ${why ? 'its reference cannot be used.' : 'it has no reference.'}`),
    why && problem(why),
    h('p', {}, 'Make one with an image whose object pose is known, ', h('a', { href: `#reference/${name}` }, 'by clicks in two images'), ', or with'),
    h('pre', {}, `posed calibrate ${name} --scene FOLDER --image NUMBER`));
}

/** @param {Schemas['ObjectReport']} object @param {Schemas['ReferenceReport']} reference */
function referenceParts({ name, diameter_m }, reference) {
  const { sigma_translation_m: mm, sigma_rotation_rad: rad, method, modified_unix_s, views } = reference;
  const when = new Date(1e3 * modified_unix_s).toISOString().slice(0, 16).replace('T', ' ');
  return [
    h('p', {}, `Reference from ${views.length === 1 ? '1 image' : `${views.length} images (${method})`}, written ${when} UTC; its frame is known to ${(1e3 * mm).toFixed(1)} mm and ${((rad * 180) / Math.PI).toFixed(2)}° (one standard deviation).`),
    ...views.map((view, index) => {
      const canvas = h('canvas', { class: 'picture', role: 'img', 'aria-label': `Reference image ${index + 1} of ${name} with the frame of the object` });
      const caption = h('figcaption', {}, views.length > 1 ? `${view.image}: ${view.inlier ? '' : 'left out, '}${view.residual_mm.toFixed(1)} mm and ${view.residual_deg.toFixed(2)}° from the mean` : view.image);
      const figure = h('figure', {}, canvas, caption);
      void drawn(name, diameter_m, view, canvas).catch((error) => figure.replaceChildren(problem(`${view.image}: ${inWords(error)}`)));
      return figure;
    }),
  ];
}

/** @param {string} name @param {number} diameterM @param {Schemas['ReferenceViewReport']} view @param {HTMLCanvasElement} canvas */
async function drawn(name, diameterM, view, canvas) {
  const shown = await picture(await referenceImage(name, view.image), view.image);
  const { rotation_xyzw, translation_m } = view.camera_from_object;
  const sheet = new Sheet(canvas);
  const draw = () => {
    sheet.begin(shown);
    const [x, y, width, height] = view.box_px;
    sheet.line([[x, y], [x + width, y], [x + width, y + height], [x, y + height], [x, y]], '#ffffff', 1.5);
    sheet.axes(view.camera, fromQuaternion(rotation_xyzw, translation_m), diameterM / 2, true);
  };
  new ResizeObserver(draw).observe(canvas);
}

/** Of whatever the trainer wrote, the figures in words. @param {unknown} training */
function trainingParts(training) {
  if (!training || typeof training !== 'object') return [];
  /** @type {[string, unknown][]} */
  const entries = Object.entries(training).flatMap(([name, value]) =>
    value && typeof value === 'object' && !Array.isArray(value)
      ? Object.entries(value).map(([inner, figure]) => /** @type {[string, unknown]} */ ([`${name}: ${inner}`, figure]))
      : [[name, value]]);
  if (entries.length === 0) return [];
  const words = (/** @type {string} */ name) => name.replaceAll('_', ' ').replace(/ percent$/, ', %').replace(/ (mm|deg|px)$/, ', $1');
  const figure = (/** @type {unknown} */ value) => (Array.isArray(value) ? value.join(', ') : typeof value === 'object' ? JSON.stringify(value) : String(value));
  return [h('details', {}, h('summary', {}, 'Training and validation'), h('dl', {}, ...entries.flatMap(([name, value]) => [h('dt', {}, words(name)), h('dd', {}, figure(value))])))];
}

// @ts-check
// An answer: its picture, its table, and how to ask for it elsewhere.

import { poseCall } from './api.js';
import { copyButton, fixed, h } from './elements.js';
import { picture as decoded } from './images.js';
import { RESIDUALS_TIMES, Sheet, drawAnswer } from './overlay.js';
import { REASON, STATUS, STATUS_MEANS } from './words.js';

/** @typedef {import('./types').components['schemas']} Schemas */
/** @typedef {import('./images.js').Picture} Picture */
/** @typedef {import('./camera-field.js').Chosen} Chosen */

const LEGEND = `Lines: axes x, y, z of each object. Box: the detector's; dashed where the status is not ok. Dots: keypoints, each in a ring
 of ${RESIDUALS_TIMES} times its residual; a cross is one that the pose is not computed from. Yellow: the position, 95 %. Small cross: principal point.`;

export class AnswerView {
  /** @param {HTMLElement} element */
  constructor(element) {
    this.canvas = h('canvas', { class: 'picture', role: 'img', 'aria-label': 'The image' });
    this.sheet = new Sheet(this.canvas);
    this.said = h('p', { class: 'summary', role: 'status' });
    this.details = h('div');
    this.legend = h('details', {}, h('summary', {}, 'What is drawn'), h('p', {}, LEGEND));
    element.append(this.canvas, this.legend, this.said, this.details);
    /** @type {Map<string, number>} */
    this.diametersM = new Map();
    /** @type {number | null} */
    this.pointedAt = null;
    /** @type {Picture | null} */
    this.picture = null;
    /** @type {Schemas['Report'] | null} */
    this.report = null;
    /** @type {Chosen | null} */
    this.chosen = null;
    new ResizeObserver(() => this.draw()).observe(element);
    this.canvas.addEventListener('pointermove', (event) => this.point(this.hit(event)));
    this.canvas.addEventListener('pointerleave', () => this.point(null));
  }

  /** An image without an answer yet. @param {Picture | null} picture */
  showImage(picture) {
    this.picture = picture;
    this.report = null;
    this.pointedAt = null;
    this.said.textContent = '';
    this.details.replaceChildren();
    this.draw();
  }

  /**
   * @param {Schemas['Report']} report
   * @param {Picture | null} picture
   * @param {Chosen} chosen
   * @param {number} roundTripMs
   * @param {boolean} allowResize
   */
  async show(report, picture, chosen, roundTripMs, allowResize) {
    // The server may have turned it; all pixels are then those of the turned image.
    if (picture && report.image.exif?.applied) picture = await decoded(picture.blob, picture.name, true);
    Object.assign(this, { report, picture, chosen: scaled(chosen, report), pointedAt: null });
    const { poses, timings_ms: t } = report;
    const guess = chosen.isGuess ? ' The camera is a guess, and so are the distances.' : '';
    this.said.textContent = `${poses.length === 0 ? 'No known object is in view.' : counted(poses)}${guess}${report.truncated ? ' There may be more: a limit was reached.' : ''}`;
    const ms = (/** @type {number} */ value) => `${value.toFixed(value < 10 ? 1 : 0)} ms`;
    this.details.replaceChildren(
      poses.length > 0 ? this.table(poses) : '',
      ...(report.hints ?? []).map((hint) => h('p', { class: 'note' }, hint)),
      h('p', { class: 'note' }, `Server ${ms(t.total)}: queue ${ms(t.queue)}, decoding ${ms(t.decode)}, detector ${ms(t.detect)}, keypoints ${ms(t.keypoints)}, solver ${ms(t.pnp)}. Round trip ${ms(roundTripMs)}.`),
      h('div', { class: 'row' }, ...copies(report, picture?.name ?? 'IMAGE', chosen, allowResize)),
    );
    this.draw();
  }

  /** @param {Schemas['PoseReport'][]} poses */
  table(poses) {
    const heads = ['object', 'status', 'confidence', 'x, y, z (mm)', '± (mm)', 'rotation x, y, z, w', 'residual (px)', 'keypoints'];
    const rows = poses.map((pose, index) => h('tr', {
      tabindex: '0', mouseenter: () => this.point(index), focus: () => this.point(index), mouseleave: () => this.point(null), blur: () => this.point(null),
    }, ...cells(pose)));
    const table = h('table', {}, h('caption', { class: 'visually-hidden' }, 'Poses in the frame of the camera'),
      h('thead', {}, h('tr', {}, ...heads.map((head) => h('th', { scope: 'col' }, head)))), h('tbody', {}, ...rows));
    const why = poses.filter(({ status }) => status !== 'ok').map((pose) =>
      h('li', {}, h('strong', {}, `${pose.object}: ${STATUS[pose.status]}. `), [STATUS_MEANS[pose.status], ...pose.reasons.map((reason) => REASON[reason] ?? reason)].join(' '),
        pose.alternatives?.length ? ` Point at its row to see ${pose.alternatives.length === 1 ? 'the other pose' : 'the other poses'}.` : ''));
    return h('div', {}, h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': 'Poses' }, table), why.length > 0 && h('ul', {}, ...why));
  }

  /** @param {number | null} index */
  point(index) {
    if (index === this.pointedAt) return;
    this.pointedAt = index;
    this.draw();
  }

  /** The pose whose box is under the pointer. @param {PointerEvent} event */
  hit({ offsetX, offsetY }) {
    if (!this.report || !this.picture) return null;
    const by = this.picture.width / this.canvas.clientWidth;
    const [u, v] = [offsetX * by, offsetY * by];
    const inside = this.report.poses.findIndex(({ detection: { box_px: [x, y, w, h] } }) => u >= x && v >= y && u <= x + w && v <= y + h);
    return inside < 0 ? null : inside;
  }

  draw() {
    const { picture, report, chosen } = this;
    this.canvas.hidden = picture === null;
    this.legend.hidden = picture === null || report === null;
    if (!picture) return;
    if (report && chosen) {
      drawAnswer(this.sheet, picture, report.poses, chosen.camera, this.diametersM, this.pointedAt);
      this.canvas.setAttribute('aria-label', `The image with ${counted(report.poses)}`);
    } else this.sheet.begin(picture);
  }
}

/** The camera as the server used it: it may have scaled it. @param {Chosen} chosen @param {Schemas['Report']} report @returns {Chosen} */
function scaled(chosen, { image }) {
  const from = image.camera_scaled_from;
  if (!from) return chosen;
  const { fx, fy, cx, cy } = chosen.camera;
  const [by, down] = [image.width / from[0], image.height / from[1]];
  const camera = { ...chosen.camera, fx: fx * by, fy: fy * down, cx: (cx + 0.5) * by - 0.5, cy: (cy + 0.5) * down - 0.5 };
  return { ...chosen, camera };
}

/** @param {Schemas['PoseReport'][]} poses */
function counted(poses) {
  const ok = poses.filter(({ status }) => status === 'ok').length;
  const objects = poses.length === 1 ? '1 object' : `${poses.length} objects`;
  return ok === poses.length ? `${objects}, ${poses.length === 1 ? 'its status is' : 'each'} ok.` : `${objects}, ${ok} of them ok.`;
}

/** @param {Schemas['PoseReport']} pose */
function cells({ object, status, confidence, camera_from_object: placed, covariance, keypoints, inliers, reprojection_rmse_px }) {
  const cell = (/** @type {import('./elements.js').Child} */ child, kind = 'number') => h('td', { class: kind }, child);
  const first = [h('th', { scope: 'row' }, object), cell(h('span', { class: `status ${status}` }, STATUS[status]), 'word'), cell(confidence.toFixed(2))];
  if (!placed || !covariance) return [...first, ...Array.from({ length: 5 }, () => cell('none'))];
  const deviations = [0, 1, 2].map((axis) => (1e3 * Math.sqrt(covariance[axis][axis])).toFixed(1));
  return [
    ...first,
    cell(placed.translation_m.map((value) => fixed(1e3 * value, 1)).join(', ')),
    cell(deviations.join(', ')),
    cell(placed.rotation_xyzw.map((value) => fixed(value, 3)).join(', ')),
    cell(reprojection_rmse_px?.toFixed(2) ?? ''),
    cell(`${inliers} of ${keypoints?.length}`),
  ];
}

/** @param {Schemas['Report']} report @param {string} file @param {Chosen} chosen @param {boolean} allowResize */
function copies(report, file, { choice }, allowResize) {
  const { path, form } = poseCall(choice, allowResize);
  const [url, asked] = [`${location.origin}${path}`, form && JSON.stringify(form)];
  const quoted = (/** @type {string} */ text) => `'${text.replaceAll("'", `'\\''`)}'`;
  const curl = asked ? `curl -F image=@${quoted(file)} -F request=${quoted(asked)} ${quoted(url)}` : `curl --data-binary @${quoted(file)} ${quoted(url)}`;
  const image = `open(${JSON.stringify(file)}, "rb")`;
  const python = asked
    ? `import requests; print(requests.post(${JSON.stringify(url)}, files={"image": ${image}}, data={"request": ${JSON.stringify(asked)}}, timeout=10).json())`
    : `import requests; print(requests.post(${JSON.stringify(url)}, data=${image}, timeout=10).json())`;
  return [
    copyButton('Copy JSON', () => JSON.stringify(report, null, 2)),
    copyButton('Copy curl', () => curl),
    copyButton('Copy Python', () => python),
  ];
}

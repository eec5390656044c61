// @ts-check
// The view Reference: the pose of an object from points clicked in two images.

import { inWords, limits, objects, putReference } from './api.js';
import { CameraField } from './camera-field.js';
import { byId, fixed, h, labelled, problem } from './elements.js';
import { compose, stated } from './geometry.js';
import { fileButton, onDrop, picture } from './images.js';
import { epipolarLine, offLine, spanned, triangulate } from './pair.js';
import { Picker } from './picker.js';
import { RelativePose } from './relative-pose.js';

/** @typedef {import('./geometry.js').Vec2} Vec2 */
/** @typedef {import('./images.js').Picture} Picture */
/** @typedef {import('./pair.js').Pair} Pair */
/** @typedef {{first: Vec2 | null, second: Vec2 | null}} Click */
/** @typedef {'first' | 'second'} Side */

const MIN_POINTS = 4;
const MAX_POINTS = 16;
const SIDES = /** @type {const} */ (['first', 'second']);
const ROLES = /** @type {const} */ ([['origin', 'origin'], ['on_x', 'on the +x axis'], ['in_xy', 'in the xy plane, towards +y']]);
/** A click this far from its epipolar line is no slip of the hand. */
const FAR_PX = 10;

export function referenceView() {
  const object = byId('reference-object', HTMLSelectElement);
  const save = byId('reference-save', HTMLButtonElement);
  const download = byId('reference-download', HTMLButtonElement);
  const result = byId('reference-result', HTMLElement);
  /** @type {Click[]} */
  let clicks = [];
  let selected = -1;
  let mayWrite = false;
  /** @type {Map<string, number>} */
  let diametersM = new Map();

  const cameras = { first: new CameraField('Camera of the first image', () => update()), second: new CameraField('Camera of the second image', () => update()) };
  const relative = new RelativePose(() => update(), (first, second) => (cameras.first.set(first), cameras.second.set(second)));
  byId('reference-cameras', HTMLElement).append(cameras.first.element, cameras.second.element, relative.element);

  /** @type {(side: Side) => Picker} */
  const picker = (side) => new Picker(side === 'first' ? 'First image' : 'Second image', {
    click: (pixel) => place(side, pixel),
    select: (index) => ((selected = index), update()),
    move: (pixel) => {
      if (!clicks[selected]) return;
      clicks[selected][side] = pixel;
      update();
    },
    box: side === 'first' ? (box) => ((boxText.value = box.join(', ')), update()) : undefined,
  });
  const pickers = { first: picker('first'), second: picker('second') };
  for (const side of SIDES) {
    const area = byId(`reference-${side}`, HTMLElement);
    const take = (/** @type {Blob} */ blob, /** @type {string} */ name) => void show(side, blob, name);
    area.append(h('div', { class: 'row' }, fileButton(`Choose the ${side} image`, (file) => take(file, file.name))), pickers[side].element);
    onDrop(area, (file) => take(file, file.name));
  }

  const boxText = h('input', { type: 'text', autocomplete: 'off', class: 'wide', placeholder: 'x, y, width, height', input: () => update() });
  const drawBox = h('button', { type: 'button', click: () => ((pickers.first.drawsBox = true), (drawBox.textContent = 'Drag over the first image')) }, 'Draw it');
  const sigma = h('input', { type: 'text', inputmode: 'decimal', value: '1', input: () => update() });
  byId('reference-extras', HTMLElement).append(
    h('div', { class: 'row' }, labelled('box of the object in the first image, pixels', boxText, 'Leave it empty if the detector finds the object there.'), drawBox),
    labelled('error of a click, pixels', sigma),
  );

  const roles = Object.fromEntries(ROLES.map(([role]) => [role, h('select', { change: () => update() })]));
  byId('reference-frame', HTMLElement).append(...ROLES.map(([role, words]) => labelled(words, roles[role])));

  /** @param {Side} side @param {Blob} blob @param {string} name */
  async function show(side, blob, name) {
    try {
      const shown = await picture(blob, name);
      pickers[side].show(shown);
      cameras[side].belongsTo(shown);
      clicks = clicks.map((click) => ({ ...click, [side]: null }));
      update();
    } catch {
      tell(problem(`${name} is no image that this browser knows.`));
    }
  }

  /** @param {Side} side @param {Vec2} pixel */
  function place(side, pixel) {
    const current = clicks[selected];
    if (current && !current[side]) current[side] = pixel;
    else if (clicks.length < MAX_POINTS) selected = clicks.push({ first: null, second: null, [side]: pixel }) - 1;
    update();
  }

  /** The two cameras as they stand, or what is missing. @returns {Pair | string} */
  function pair() {
    const [first, second, pose] = [cameras.first.get(), cameras.second.get(), relative.get()];
    for (const found of [first, second, pose]) if (typeof found === 'string') return found;
    return /** @type {Pair} */ ({ first: /** @type {any} */ (first).camera, second: /** @type {any} */ (second).camera, second_from_first: pose });
  }

  function update() {
    const found = pair();
    const known = typeof found === 'string' ? null : found;
    const placed = clicks.map(({ first, second }) => (known && first && second ? triangulate(known, first, second) : null));
    offerRoles();
    const frame = frameOf(placed);
    for (const side of SIDES) {
      pickers[side].points = clicks.map((click) => click[side]);
      pickers[side].selected = selected;
    }
    const length = (diametersM.get(object.value) ?? 0.08) / 2;
    pickers.first.paint = (sheet) => {
      drawnBox(sheet);
      if (frame && known) sheet.axes(known.first, frame, length, true);
    };
    const from = clicks[selected]?.first;
    const line = known && from ? epipolarLine(known, from) : [];
    pickers.second.paint = (sheet) => {
      sheet.line(line, '#ffd43b', 1.5);
      if (frame && known) sheet.axes(known.second, compose(known.second_from_first, frame), length, true);
    };
    for (const side of SIDES) pickers[side].draw();
    showTable(placed, line);
    showReadiness(typeof found === 'string' ? found : null, placed, frame);
  }

  /** @param {import('./overlay.js').Sheet} sheet */
  function drawnBox(sheet) {
    if (!pickers.first.drawsBox) drawBox.textContent = 'Draw it';
    const box = readBox();
    if (!Array.isArray(box)) return;
    const [x, y, w, height] = box;
    sheet.line([[x, y], [x + w, y], [x + w, y + height], [x, y + height], [x, y]], '#ffffff', 1.5, [6, 4]);
  }

  /** Numbers, null for none, or what is wrong. @returns {number[] | null | string} */
  function readBox() {
    const values = boxText.value.split(/[\s,;]+/).filter(Boolean).map(Number);
    if (values.length === 0) return null;
    if (values.length !== 4 || values.some((value) => !Number.isFinite(value)) || values[2] < 8 || values[3] < 8) {
      return 'The box needs x, y, width and height in pixels, at least 8 wide and high.';
    }
    return values;
  }

  function offerRoles() {
    ROLES.forEach(([role], index) => {
      const select = roles[role];
      const chosen = select.options.length > index ? select.selectedIndex : index;
      if (select.options.length !== clicks.length) {
        select.replaceChildren(...clicks.map((_, at) => h('option', { value: at }, `point ${at + 1}`)));
        select.selectedIndex = Math.min(chosen, clicks.length - 1);
      }
    });
  }

  /** @param {(import('./pair.js').Placed | string | null)[]} placed */
  function frameOf(placed) {
    const points = ROLES.map(([role]) => placed[Number(roles[role].value || -1)]);
    const [origin, onX, inXy] = points.map((point) => (point && typeof point !== 'string' ? point.point : null));
    return origin && onX && inXy ? spanned(origin, onX, inXy) : null;
  }

  /** @param {(import('./pair.js').Placed | string | null)[]} placed @param {(Vec2 | null)[]} line */
  function showTable(placed, line) {
    const pixel = (/** @type {Vec2 | null} */ at) => (at ? at.map((value) => fixed(value, 2)).join(', ') : 'click it');
    const rows = clicks.map(({ first, second }, index) => {
      const point = placed[index];
      const fit = typeof point === 'string' ? [h('td', { colspan: '3' }, point)] : point
        ? [point.firstPx, point.secondPx, point.rayMm].map((value) => h('td', { class: 'number' }, value.toFixed(2))) : [h('td', { colspan: '3' }, '')];
      const off = index === selected && second && line.length > 0 ? offLine(line, second) : 0;
      return h('tr', { class: index === selected ? 'selected' : '' },
        h('th', { scope: 'row' }, h('button', { type: 'button', 'aria-pressed': String(index === selected), 'aria-label': `Select point ${index + 1}`, click: () => ((selected = index), update()) }, String(index + 1))),
        h('td', { class: 'number' }, pixel(first)), h('td', { class: 'number' }, pixel(second)), ...fit,
        h('td', {}, h('button', { type: 'button', 'aria-label': `Remove point ${index + 1}`, click: () => remove(index) }, 'Remove'), off > FAR_PX && ` ${off.toFixed(0)} px from the line`));
    });
    byId('reference-points', HTMLTableSectionElement).replaceChildren(...rows);
    const next = clicks[selected];
    const words = clicks.length === 0 ? 'Click a point of the object in the first image, then the same point in the second.'
      : next && !next.second ? `Now click point ${selected + 1} in the second image: it lies on the yellow line.`
        : next && !next.first ? `Now click point ${selected + 1} in the first image.`
          : 'Click the next point in the first image. Drag a point, or click in the magnifier, to place it exactly.';
    byId('reference-next', HTMLElement).textContent = words;
  }

  /** @param {number} index */
  function remove(index) {
    clicks.splice(index, 1);
    selected = Math.min(selected, clicks.length - 1);
    update();
  }

  /** @param {string | null} missing @param {(import('./pair.js').Placed | string | null)[]} placed @param {import('./geometry.js').Pose | null} frame */
  function showReadiness(missing, placed, frame) {
    const complete = placed.filter((point) => point && typeof point !== 'string').length;
    const box = readBox();
    const guess = SIDES.map((side) => cameras[side].get()).some((chosen) => typeof chosen !== 'string' && chosen.isGuess);
    const words = !pickers.first.picture || !pickers.second.picture ? 'Choose both images.'
      : missing ?? (complete < clicks.length ? 'Each point needs its click in both images, and rays that meet.'
        : complete < MIN_POINTS ? `${complete} of at least ${MIN_POINTS} points are complete.`
          : !frame ? 'The origin, the point on +x and the point in the xy plane must be three points that are not on one line.'
            : typeof box === 'string' ? box : '');
    const usable = words === '';
    byId('reference-ready', HTMLElement).textContent =
      usable && guess ? 'A camera is a guess. A reference needs calibrated cameras, or every later pose is wrong.' : words;
    save.disabled = !usable || !mayWrite;
    download.disabled = !usable;
  }

  /** What a request says; a file needs the image's name, too. */
  function asked() {
    const [first, second, pose] = [cameras.first.get(), cameras.second.get(), relative.get()];
    if (typeof first === 'string' || typeof second === 'string' || typeof pose === 'string') throw new Error('The cameras are not complete.');
    const box = readBox();
    return {
      first: { request: first.choice, file: first.camera },
      second: { request: second.choice, file: second.camera },
      rest: {
        second_from_first: stated(pose),
        clicks: clicks.map((click) => ({ first_px: click.first, second_px: click.second })),
        frame: Object.fromEntries(ROLES.map(([role]) => [role, Number(roles[role].value)])),
        sigma_px: Number(sigma.value),
        ...(Array.isArray(box) && { box_px: box }),
      },
    };
  }

  /** @param {...(Node | string)} children */
  const tell = (...children) => result.replaceChildren(...children);

  save.addEventListener('click', async () => {
    const image = pickers.first.picture;
    if (!image) return;
    save.disabled = true;
    tell('Measuring the object in the first image …');
    try {
      const { first, second, rest } = asked();
      const made = await putReference(object.value, image.blob, { clicks: { first_camera: first.request, second_camera: second.request, ...rest } });
      const deg = (made.sigma_rotation_rad * 180) / Math.PI;
      tell(h('p', { class: 'done', role: 'status' },
        `Saved, and in force. The frame of ${object.value} is known to ${(1e3 * made.sigma_translation_m).toFixed(1)} mm and ${deg.toFixed(2)}° (one standard deviation). `,
        h('a', { href: '#objects' }, 'See it under Objects.')));
    } catch (error) {
      tell(problem(inWords(error)));
    }
    update();
  });

  download.addEventListener('click', () => {
    const image = pickers.first.picture;
    if (!image) return;
    const { first, second, rest } = asked();
    if (!rest.box_px) return tell(problem('The file needs the box of the object in the first image: draw it, or type it.'));
    const file = { image: image.name, first_camera: first.file, second_camera: second.file, ...rest };
    const url = URL.createObjectURL(new Blob([JSON.stringify(file, null, 2)], { type: 'application/json' }));
    h('a', { href: url, download: 'clicks.json' }).click();
    setTimeout(() => URL.revokeObjectURL(url), 1000);
    tell(h('p', {}, `Put clicks.json beside ${image.name}, then run`), h('pre', {}, `posed calibrate ${object.value} --clicks clicks.json`));
  });

  byId('reference-new', HTMLButtonElement).addEventListener('click', () => ((selected = -1), update()));
  byId('reference-demo', HTMLButtonElement).addEventListener('click', async () => {
    const of = async (/** @type {string} */ name) => (await fetch(`/page/samples/pair/${name}`)).blob();
    const { camera, second_from_first, box_px } = JSON.parse(await (await of('pair.json')).text());
    await Promise.all(SIDES.map(async (side) => show(side, await of(`${side}.jpg`), `${side}.jpg`)));
    for (const side of SIDES) cameras[side].set(camera);
    boxText.value = (box_px[object.value] ?? []).join(', ');
    relative.setRig(second_from_first);
  });

  return {
    /** @param {string} [wanted] */
    async load(wanted) {
      try {
        const [known, { recalibration }] = await Promise.all([objects(), limits(), ...SIDES.map((side) => cameras[side].load())]);
        mayWrite = recalibration;
        diametersM = new Map(known.map(({ name, diameter_m }) => [name, diameter_m]));
        const before = wanted ?? object.value;
        object.replaceChildren(...known.map(({ name }) => h('option', {}, name)));
        if (known.some(({ name }) => name === before)) object.value = before;
        byId('reference-off', HTMLElement).hidden = mayWrite;
        tell();
      } catch (error) {
        tell(problem(inWords(error)));
      }
      update();
    },
  };
}

// @ts-check
// The view Try: an image, a camera, the poses.

import { Refusal, inWords, objects, poses } from './api.js';
import { AnswerView } from './answer.js';
import { CameraField } from './camera-field.js';
import { byId, h, problem } from './elements.js';
import { DeviceCamera, fileButton, onDrop, pasted, picture } from './images.js';
import { live } from './live.js';

/** @typedef {import('./images.js').Picture} Picture */
/** @typedef {import('./types').components['schemas']} Schemas */

const TYPING_MS = 250;

export function tryView() {
  const view = byId('try', HTMLElement);
  const answer = new AnswerView(byId('try-answer', HTMLElement));
  const said = byId('try-problem', HTMLElement);
  const figures = byId('try-figures', HTMLElement);
  const device = new DeviceCamera();
  /** @type {(() => void) | null} */
  let stop = null;
  /** @type {{blob: Blob, name: string, picture: Picture | null} | null} */
  let current = null;
  let pending = new AbortController();
  let typing = 0;

  const camera = new CameraField('Camera', askSoon);
  const resized = h('input', { type: 'checkbox', change: askSoon });
  byId('try-camera', HTMLElement).append(camera.element, h('label', { class: 'choice' }, resized, ' The image is the full frame of the camera, resized'));

  /** @param {string} words */
  const tell = (words) => said.replaceChildren(...(words ? [problem(words)] : []));

  /** @param {Blob} blob @param {string} name @param {import('./camera.js').Camera} [known] */
  async function take(blob, name, known) {
    end();
    tell('');
    // What the browser cannot show is posted all the same: the server says what is wrong with it.
    const shown = await picture(blob, name).catch(() => null);
    current = { blob, name, picture: shown };
    answer.showImage(shown);
    camera.belongsTo(shown);
    if (known) camera.set(known);
    await ask();
  }

  /** After the last key of several. */
  function askSoon() {
    clearTimeout(typing);
    typing = setTimeout(ask, TYPING_MS);
  }

  async function ask() {
    clearTimeout(typing);
    if (!current || stop) return;
    const chosen = camera.get();
    if (typeof chosen === 'string') return tell(chosen);
    // The server does not work for callers that have left.
    pending.abort();
    pending = new AbortController();
    const { signal } = pending;
    const start = performance.now();
    view.setAttribute('aria-busy', 'true');
    try {
      const report = await poses(current.blob, chosen.choice, resized.checked, signal);
      if (signal.aborted) return;
      tell('');
      await answer.show(report, current.picture, chosen, performance.now() - start, resized.checked);
    } catch (error) {
      if (signal.aborted) return;
      answer.showImage(current.picture);
      tell(inWords(error));
    } finally {
      if (!signal.aborted) view.removeAttribute('aria-busy');
    }
  }

  function end() {
    pending.abort();
    view.removeAttribute('aria-busy');
    stop?.();
    stop = null;
    device.stop();
    figures.textContent = '';
    liveButton.textContent = 'Live';
    liveButton.setAttribute('aria-pressed', 'false');
  }

  /** Starts the camera of this device; false if there is none. */
  async function started() {
    end();
    tell('');
    try {
      await device.start();
      return true;
    } catch (error) {
      tell(inWords(error));
      return false;
    }
  }

  async function shoot() {
    if (!(await started())) return;
    const { blob, name } = await device.frame();
    await take(blob, name);
  }

  async function goLive() {
    if (stop) return end();
    if (!(await started())) return;
    liveButton.textContent = 'Stop';
    liveButton.setAttribute('aria-pressed', 'true');
    current = null;
    /** @type {Picture | null} */
    let before = null;
    stop = live(oneFrame, async ({ report, frame, chosen }, { perSecond, latencyMs }) => {
      await answer.show(report, frame, chosen, latencyMs, resized.checked);
      // Frames are large, and the browser collects them late.
      before?.bitmap.close();
      before = frame;
      figures.textContent = `Live: ${perSecond.toFixed(1)} images/s, ${latencyMs.toFixed(0)} ms from frame to answer.`;
    }, (words) => {
      tell(words);
      if (words) figures.textContent = 'Live: waiting.';
    });
  }

  /** @param {AbortSignal} signal */
  async function oneFrame(signal) {
    const frame = await device.frame();
    if (camera.image?.width !== frame.width || camera.image.height !== frame.height) camera.belongsTo(frame);
    const chosen = camera.get();
    if (typeof chosen === 'string') throw new Refusal(chosen, 400);
    const report = await poses(frame.blob, chosen.choice, resized.checked, signal);
    return { report, frame, chosen };
  }

  const liveButton = h('button', { type: 'button', 'aria-pressed': 'false', click: () => void goLive() }, 'Live');
  byId('try-sources', HTMLElement).append(
    fileButton('Choose an image', (file) => void take(file, file.name)),
    h('button', { type: 'button', click: () => void shoot() }, 'Take a picture'),
    liveButton,
  );
  onDrop(document.body, (file) => void (view.hidden || take(file, file.name)));
  document.addEventListener('paste', (event) => {
    const file = pasted(event);
    if (file && !view.hidden) void take(file, file.name || 'pasted.png');
  });
  document.addEventListener('visibilitychange', () => void (document.hidden && stop && end()));

  return {
    async load() {
      const [known] = await Promise.all([objects().catch((error) => (tell(inWords(error)), [])), camera.load()]);
      answer.diametersM = new Map(known.map(({ name, diameter_m }) => [name, diameter_m]));
      await offerSamples(known.map(({ name }) => name), take);
    },
    leave: () => void (stop && end()),
  };
}

const SAMPLES = ['sample-1.jpg', 'sample-2.jpg'];

/** Samples of objects that this server knows. @param {string[]} known @param {(blob: Blob, name: string, camera: import('./camera.js').Camera) => Promise<void>} take */
async function offerSamples(known, take) {
  const [camera, poses] = await Promise.all(['demo.camera.json', 'poses.json'].map(async (name) => (await fetch(`/page/samples/${name}`)).json()));
  const useful = SAMPLES.filter((name) => poses[name].some((/** @type {{object: string}} */ { object }) => known.includes(object)));
  const button = (/** @type {string} */ name, /** @type {number} */ index) => h('button', {
    type: 'button', class: 'thumbnail', click: async () => take(await (await fetch(`/page/samples/${name}`)).blob(), name, camera),
  }, h('img', { src: `/page/samples/${name}`, alt: '', width: '160', height: '120', loading: 'lazy' }), `Sample ${index + 1}`);
  byId('try-samples', HTMLElement).replaceChildren(...useful.map(button));
}

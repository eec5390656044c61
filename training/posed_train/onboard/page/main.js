// @ts-check
// Ties the page together.

import { label, readJob, readProject, save } from './api.js';
import { Editor } from './editor.js';
import { byId, h } from './elements.js';
import { Model } from './model.js';
import { panel } from './panel.js';
import { Sheet } from './sheet.js';

const ASK_MS = 700;
const problem = byId('problem', HTMLElement);
const state = byId('state', HTMLElement);

/** @param {string} words */
function tell(words) {
  problem.hidden = !words;
  problem.className = 'problem';
  problem.textContent = words;
}

async function start() {
  const model = new Model(await readProject());
  document.title = `posed: label ${model.project.name}`;
  byId('title', HTMLElement).textContent = `Label ${model.project.name}`;
  const canvas = byId('photo', HTMLCanvasElement);
  const sheet = new Sheet(model, () => {
    canvas.scrollIntoView({ block: 'nearest' });
    canvas.focus({ preventScroll: true });
  });
  const editor = new Editor(canvas, model, sheet.outlinesOf);
  panel(model);
  model.addEventListener('outlines', () => editor.draw());
  model.addEventListener('trouble', (event) => tell(/** @type {CustomEvent<string>} */ (event).detail));
  chooseScene(model);
  photos(model, editor, canvas);
  saving(model);
}

/** @param {Model} model */
function chooseScene(model) {
  const select = byId('scene', HTMLSelectElement);
  byId('scene-field', HTMLElement).hidden = model.project.scenes.length < 2;
  select.append(...model.project.scenes.map(({ name, frames }) => h('option', { value: name }, `${name} (${frames.length} photos)`)));
  select.addEventListener('change', async () => {
    if (model.unsaved) await save(model.asked());
    // What was saved is what is opened when one comes back.
    model.project = await readProject();
    model.open(select.value);
  });
}

/** @param {Model} model @param {Editor} editor @param {HTMLCanvasElement} canvas */
function photos(model, editor, canvas) {
  const [draw, bad, name, hint] = [byId('draw', HTMLElement), byId('bad', HTMLElement), byId('photo-name', HTMLElement), byId('hint', HTMLElement)];
  const step = (/** @type {number} */ by) => {
    model.turnTo(model.photo + by);
  };
  byId('previous', HTMLElement).addEventListener('click', () => step(-1));
  byId('next', HTMLElement).addEventListener('click', () => step(1));
  byId('whole', HTMLElement).addEventListener('click', () => editor.whole());
  bad.addEventListener('click', () => model.toggleBad(model.frame.name));
  draw.addEventListener('click', () => {
    model.asksToDraw = !model.drawing;
    model.changed(false);
  });
  canvas.addEventListener('keydown', ({ key }) => {
    if (key === 'ArrowLeft' || key === 'ArrowRight') step(key === 'ArrowLeft' ? -1 : 1);
  });
  addEventListener('keydown', (event) => {
    const typing = event.target instanceof HTMLInputElement && event.target.type === 'text';
    if (event.key.toLowerCase() === 'z' && (event.ctrlKey || event.metaKey) && !typing) {
      event.preventDefault();
      model.undo();
    }
  });
  function show() {
    const { thing, frame, scene, photo } = model;
    name.textContent = `${frame.name} (${photo + 1} of ${scene.frames.length})`;
    const { drawing } = model;
    draw.setAttribute('aria-pressed', String(drawing));
    draw.toggleAttribute('disabled', !thing.solid);
    bad.setAttribute('aria-pressed', String(model.bad.has(frame.name)));
    canvas.classList.toggle('drawing', drawing);
    hint.textContent = drawing
      ? `Draw a box around the ${thing.name}: press at one corner, let go at the other. Then do so in a photo from another side.`
      : 'Drag edges of the box; the dot moves it, the ring turns it. Wheel: zoom. Beside the box: drag the photo. Look in all photos below whether it fits.';
  }
  model.addEventListener('change', show);
  show();
}

/** @param {Model} model */
function saving(model) {
  const [keep, run, result] = [byId('save', HTMLButtonElement), byId('label', HTMLButtonElement), byId('result', HTMLElement)];
  let running = false;

  function show() {
    const some = Object.keys(model.asked().objects).length > 0;
    keep.disabled = !model.unsaved;
    run.disabled = running || !some;
    if (!running) state.textContent = model.unsaved ? 'not saved' : '';
  }

  /** @param {(asked: ReturnType<Model['asked']>) => Promise<{file: string}>} how */
  async function keepBy(how) {
    tell('');
    result.replaceChildren();
    try {
      const { file } = await how(model.asked());
      model.unsaved = false;
      show();
      state.textContent = `saved: ${file}`;
      return true;
    } catch (error) {
      tell(/** @type {Error} */ (error).message);
      return false;
    }
  }

  keep.addEventListener('click', () => void keepBy(save));
  run.addEventListener('click', async () => {
    if (await keepBy(label)) void follow();
  });

  async function follow() {
    running = true;
    const since = Date.now();
    show();
    for (;;) {
      state.textContent = `labelling all photos: ${Math.round((Date.now() - since) / 1000)} s`;
      await new Promise((resolve) => setTimeout(resolve, ASK_MS));
      const job = await readJob().catch((error) => ({ running: false, text: '', error: error.message }));
      if (job.running) continue;
      running = false;
      show();
      if (job.error) tell(job.error);
      else if (job.text) {
        const next = `Look at pictures/labels-${model.scene.name}.jpg; next: posed-train check ${model.project.name}`;
        result.replaceChildren(h('p', { class: 'done', role: 'status' }, `${job.text}\n${next}`));
      }
      return;
    }
  }

  model.addEventListener('change', show);
  addEventListener('beforeunload', (event) => {
    if (model.unsaved) event.preventDefault();
  });
  show();
  void readJob().then((job) => (job.running ? follow() : undefined));
}

start().catch((error) => tell(error.message));

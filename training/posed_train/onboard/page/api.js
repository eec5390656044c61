// @ts-check
// What the page asks the command.

/** @typedef {import('./geometry.js').Frame} Frame */
/** As the file of `label --box` has it. @typedef {{
 *   solid?: 'box' | 'cylinder', boxes?: Record<string, number[]>, base_mm?: number[], yaw_deg?: number, size_mm?: number[],
 *   scene?: string, up?: string, symmetries?: string[],
 * }} Entry */
/** @typedef {{name: string, grounded: boolean, frames: Frame[], drawn: Record<string, Entry>, bad: string[]}} Scene */
/** @typedef {{name: string, up: string, symmetries: string[], solid: string, size_mm: number[]}} Item */
/** @typedef {{name: string, objects: Item[], scenes: Scene[]}} Project */
/** @typedef {{running: boolean, text: string, error: string}} Job */

/** @param {string} path @param {object} [body] @returns {Promise<any>} */
async function ask(path, body) {
  const options = body && { method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify(body) };
  /** @type {Response} */
  let answer;
  try {
    answer = await fetch(path, options || {});
  } catch {
    throw new Error('posed-train label does not answer: is it still running?');
  }
  const value = await answer.json();
  if (!answer.ok) throw new Error(value.error);
  return value;
}

/** @returns {Promise<Project>} */
export const readProject = () => ask('/api/project');
/** @returns {Promise<Entry>} */
export const fit = (/** @type {{scene: string, object: string, solid?: string, boxes: Record<string, number[]>}} */ asked) => ask('/api/fit', asked);
/** @returns {Promise<Record<string, [number, number][][]>>} */
export const outline = (/** @type {{scene: string, photo: string, objects: Record<string, Entry>}} */ asked) => ask('/api/outline', asked);
/** @returns {Promise<{file: string}>} */
export const save = (/** @type {{scene: string, objects: Record<string, Entry>, bad: string[]}} */ asked) => ask('/api/save', asked);
/** @returns {Promise<{file: string}>} */
export const label = (/** @type {{scene: string, objects: Record<string, Entry>, bad: string[]}} */ asked) => ask('/api/label', asked);
/** @returns {Promise<Job>} */
export const readJob = () => ask('/api/label');
/** @param {string} scene @param {Frame} frame @param {boolean} small */
export const imageOf = (scene, frame, small) => `/image/${scene}/${frame.id}${small ? '/small' : ''}`;

// @ts-check
// Requests to the server this page came from.

/** @typedef {import('./types').components['schemas']} Schemas */
/** @typedef {Schemas['Report']} Report */
/** @typedef {Schemas['ObjectReport']} ObjectReport */
/** @typedef {Schemas['StatusReport']} StatusReport */
/** @typedef {Schemas['LimitsReport']} LimitsReport */
/** @typedef {import('./camera.js').Camera} Camera */

const TOKEN = 'posed-token';

/** The token that requests carry; for this tab only. */
export const token = {
  get: () => sessionStorage.getItem(TOKEN) ?? '',
  set: (/** @type {string} */ value) => (value ? sessionStorage.setItem(TOKEN, value) : sessionStorage.removeItem(TOKEN)),
};

/** What the server refused, in its own words; status 0 if it did not answer at all. */
export class Refusal extends Error {
  /**
   * @param {string} message
   * @param {number} status
   * @param {number} [retryAfterS]
   */
  constructor(message, status, retryAfterS = 0) {
    super(message);
    this.status = status;
    this.retryAfterS = retryAfterS;
  }
}

/** What went wrong, for people. @type {(error: unknown) => string} */
export const inWords = (error) => (error instanceof Error ? error.message : String(error));

/** @type {Set<() => void>} */
const strangers = new Set();
/** Calls back when the server wants a token. @type {(call: () => void) => void} */
export const onUnauthenticated = (call) => void strangers.add(call);

/**
 * @param {string} path
 * @param {RequestInit} [init]
 * @returns {Promise<Response>}
 */
export async function request(path, init = {}) {
  const headers = new Headers(init.headers);
  if (token.get()) headers.set('authorization', `Bearer ${token.get()}`);
  let response;
  try {
    response = await fetch(path, { ...init, headers });
  } catch (error) {
    if (init.signal?.aborted) throw error;
    throw new Refusal('The server does not answer.', 0);
  }
  if (response.ok) return response;
  const body = await response.json().catch(() => null);
  if (response.status === 401) strangers.forEach((call) => call());
  const message = body?.error?.message ?? `The server answered with status ${response.status}.`;
  throw new Refusal(message, response.status, Number(response.headers.get('retry-after') ?? 0));
}

/**
 * @template T
 * @param {string} path
 * @returns {Promise<T>}
 */
const get = async (path) => (await request(path)).json();

export const objects = () => /** @type {Promise<ObjectReport[]>} */ (get('/v1/objects'));
export const cameras = () => /** @type {Promise<Record<string, Camera>>} */ (get('/v1/cameras'));
export const limits = () => /** @type {Promise<LimitsReport>} */ (get('/v1/limits'));
export const status = () => /** @type {Promise<StatusReport>} */ (get('/v1/status'));

/** @type {(object: string, image: string) => Promise<Blob>} */
export const referenceImage = async (object, image) =>
  (await request(`/v1/objects/${encodeURIComponent(object)}/reference/${encodeURIComponent(image)}`)).blob();

/** A camera as a request states it: an id, or parameters. @typedef {string | Camera} CameraChoice */

/**
 * How an image is posted: options in the query where they fit, else a form.
 * @param {CameraChoice} camera
 * @param {boolean} allowResize
 */
export function poseCall(camera, allowResize) {
  const query = new URLSearchParams();
  if (typeof camera === 'string') query.set('camera', camera);
  else if (camera.model === 'pinhole' && !camera.width) {
    for (const name of /** @type {const} */ (['fx', 'fy', 'cx', 'cy'])) query.set(name, String(camera[name]));
  } else {
    return { path: '/v1/poses', form: { camera, ...(allowResize && { allow_resize: true }) } };
  }
  if (allowResize) query.set('allow_resize', 'true');
  return { path: `/v1/poses?${query}`, form: null };
}

/**
 * @param {Blob} image
 * @param {CameraChoice} camera
 * @param {boolean} allowResize
 * @param {AbortSignal} [signal]
 * @returns {Promise<Report>}
 */
export async function poses(image, camera, allowResize, signal) {
  const { path, form } = poseCall(camera, allowResize);
  const body = form ? formOf(image, form) : image;
  return (await request(path, { method: 'POST', body, signal })).json();
}

/** @type {(object: string, image: Blob, asked: object) => Promise<Schemas['ReferenceReport']>} */
export const putReference = async (object, image, asked) =>
  (await request(`/v1/objects/${encodeURIComponent(object)}/reference`, { method: 'PUT', body: formOf(image, asked) })).json();

/** @type {(image: Blob, asked: object) => FormData} */
function formOf(image, asked) {
  const form = new FormData();
  form.append('image', image);
  form.append('request', JSON.stringify(asked));
  return form;
}

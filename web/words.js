// @ts-check
// The server's statuses, reasons and outcomes as sentences.

/** @typedef {import('./types').components['schemas']} Schemas */

/** @type {Record<Schemas['Status'], string>} */
export const STATUS = {
  ok: 'ok',
  ambiguous: 'ambiguous',
  low_confidence: 'low confidence',
  rejected: 'rejected',
};

/** @type {Record<Schemas['Status'], string>} */
export const STATUS_MEANS = {
  ok: 'The evidence agrees with this pose and with no other.',
  ambiguous: 'Another pose explains the image about as well.',
  low_confidence: 'The best pose found, but the evidence is thin.',
  rejected: 'The evidence contradicts this pose. Do not act on it.',
};

/** @type {Record<Schemas['Reason'], string>} */
export const REASON = {
  few_inliers: 'Too few keypoints agree with it.',
  high_residual: 'The keypoints are further from it than their covariances allow.',
  planar_ambiguity: 'A second, very different pose fits the keypoints about as well.',
  two_answers: 'The network sees most keypoints in two places, which make two poses.',
  box_mismatch: 'It is not where the detector found the object.',
  weak_keypoints: 'The network is unsure of most keypoints.',
  no_pose: 'No pose puts the keypoints in front of the camera.',
  uncertain_pose: 'It is uncertain; see its deviations.',
  too_near: 'The object is nearer than it is large. Does the camera belong to this image?',
  camera_suspect: 'The principal point is far from the middle of the image. Does the camera belong to this image?',
  grey_image: 'The image has no colours, but the networks learned from colours.',
  dark_image: 'The image is nearly black.',
  improbable: 'Too many poses like this one are wrong; see its confidence.',
  not_finite: 'The network returned values that are no numbers.',
  views_disagree: 'Another view contradicts it.',
  single_view: 'It rests on one view of several.',
  weak_baseline: 'All views look from nearly one direction.',
};

/** @type {Record<string, string>} */
const OUTCOME = {
  ok: 'answered',
  cancelled: 'left by the caller',
  replaced: 'replaced by a newer frame',
  queue_full: 'refused: no room (429)',
  invalid_image: 'refused: damaged or unusable image (400)',
  invalid_request: 'refused: invalid request (400)',
  unsupported_format: 'refused: no image format that is known (415)',
  too_large: 'refused: too large (413)',
  timed_out: 'out of time (504)',
  unauthenticated: 'refused: no valid token (401)',
  forbidden: 'refused: not allowed (403)',
  not_calibrated: 'refused: object not calibrated (409)',
  unknown_camera: 'refused: unknown camera (404)',
  unknown_object: 'refused: unknown object (404)',
  internal: 'failed in the server (500)',
  unavailable: 'refused: no worker (503)',
};

/** @type {(name: string) => string} */
export const outcome = (name) => OUTCOME[name] ?? name;

/** @type {(bytes: number) => string} */
export const mebibytes = (bytes) => `${Math.round(bytes / 2 ** 20)} MiB`;

/** @type {(object: Schemas['ObjectReport']) => string} */
export function symmetry({ orientations, revolution_axis }) {
  const turns = orientations > 1 ? `looks the same in ${orientations} orientations` : '';
  if (!revolution_axis) return turns || 'none';
  const about = `looks the same turned about (${revolution_axis.map((v) => +v.toFixed(2)).join(', ')})`;
  return turns ? `${about}, and ${turns}` : about;
}

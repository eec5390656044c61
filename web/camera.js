// @ts-check
// Cameras with OpenCV's lens models: pixels of points, rays of pixels. Pixel centres are at whole numbers.

/** @typedef {import('./types').components['schemas']['Camera']} Camera */
/** @typedef {import('./geometry.js').Vec2} Vec2 */
/** @typedef {import('./geometry.js').Vec3} Vec3 */

/** Farther from the axis (as a tangent) no model here means anything. */
const MAX_RADIUS = 30;
const STEP = 1e-6;

/** Where a lens moves a point of the plane z = 1, whatever its domain. @type {(camera: Camera, point: Vec2) => Vec2} */
function moved({ model, distortion }, [x, y]) {
  const [k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0] = distortion ?? [];
  if (model === 'fisheye') {
    const r = Math.hypot(x, y);
    const t = Math.atan(r);
    const t2 = t * t;
    // The coefficients are k1 k2 k3 k4, in this order.
    const by = r < 1e-8 ? 1 : (t * (1 + t2 * (k1 + t2 * (k2 + t2 * (p1 + t2 * p2))))) / r;
    return [x * by, y * by];
  }
  if (model !== 'opencv') return [x, y];
  const r2 = x * x + y * y;
  const radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
  return [
    x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + s2 * r2),
    y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + s4 * r2),
  ];
}

/** Rows of the derivative of `moved`. @type {(camera: Camera, point: Vec2) => [Vec2, Vec2]} */
function slope(camera, [x, y]) {
  const [right, left] = [moved(camera, [x + STEP, y]), moved(camera, [x - STEP, y])];
  const [below, above] = [moved(camera, [x, y + STEP]), moved(camera, [x, y - STEP])];
  const by = 1 / (2 * STEP);
  return [
    [(right[0] - left[0]) * by, (below[0] - above[0]) * by],
    [(right[1] - left[1]) * by, (below[1] - above[1]) * by],
  ];
}

/** @type {WeakMap<Camera, number>} */
const domains = new WeakMap();

/** How far from the axis the lens model is one to one. @type {(camera: Camera) => number} */
function domain(camera) {
  const known = domains.get(camera);
  if (known !== undefined) return known;
  let end = MAX_RADIUS;
  if (camera.model !== 'pinhole') {
    for (let step = 1; step <= 3000; step++) {
      const radius = Math.tan((step / 3000) * Math.atan(MAX_RADIUS));
      if (slope(camera, [radius, 0])[0][0] <= 0) {
        end = radius;
        break;
      }
    }
  }
  domains.set(camera, end);
  return end;
}

/** @type {(camera: Camera, point: Vec2) => Vec2 | null} */
function distort(camera, point) {
  if (!(Math.hypot(...point) < domain(camera))) return null;
  const [[a, b], [c, d]] = slope(camera, point);
  return a * d - b * c > 0 ? moved(camera, point) : null;
}

/** The pixel of a point in the frame of the camera; null where there is none. @type {(camera: Camera, point: Vec3) => Vec2 | null} */
export function project(camera, [x, y, z]) {
  if (!(z > 0)) return null;
  const at = distort(camera, [x / z, y / z]);
  return at && [camera.fx * at[0] + camera.cx, camera.fy * at[1] + camera.cy];
}

/** The point of the plane z = 1 that is seen in a pixel, by damped Newton. @type {(camera: Camera, pixel: Vec2) => Vec2 | null} */
export function unproject(camera, [u, v]) {
  /** @type {Vec2} */
  const target = [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy];
  if (camera.model === 'pinhole') return target;
  /** @type {Vec2} */
  let point = [...target];
  const length = Math.hypot(...point);
  const limit = 0.95 * domain(camera);
  if (length > limit) point = [(point[0] * limit) / length, (point[1] * limit) / length];
  for (let round = 0; round < 50; round++) {
    const at = distort(camera, point);
    if (!at) return null;
    const [dx, dy] = [target[0] - at[0], target[1] - at[1]];
    const error = Math.hypot(dx, dy);
    if (error < 1e-10) return point;
    const [[a, b], [c, d]] = slope(camera, point);
    const det = a * d - b * c;
    const step = [(d * dx - b * dy) / det, (a * dy - c * dx) / det];
    /** @type {Vec2 | null} */
    let next = null;
    for (let half = 1; half > 1e-6 && !next; half /= 2) {
      /** @type {Vec2} */
      const tried = [point[0] + step[0] * half, point[1] + step[1] * half];
      const there = distort(camera, tried);
      if (there && Math.hypot(target[0] - there[0], target[1] - there[1]) < error) next = tried;
    }
    if (!next) return error < 1e-7 ? point : null;
    point = next;
  }
  return null;
}

/** Of an image of this size, in degrees: across and down. @type {(camera: Camera, width: number, height: number) => Vec2} */
export function fieldOfView({ fx, fy }, width, height) {
  const degrees = (/** @type {number} */ side, /** @type {number} */ focal) => (2 * Math.atan(side / 2 / focal) * 180) / Math.PI;
  return [degrees(width, fx), degrees(height, fy)];
}

/** A pinhole camera that sees so many degrees across. @type {(degrees: number, width: number, height: number) => Camera} */
export function guessed(degrees, width, height) {
  const focal = width / 2 / Math.tan((degrees * Math.PI) / 360);
  return { model: 'pinhole', width, height, fx: focal, fy: focal, cx: (width - 1) / 2, cy: (height - 1) / 2 };
}

/** What looks wrong about a camera for an image of this size, in words. @type {(camera: Camera, width: number, height: number) => string[]} */
export function doubts(camera, width, height) {
  const { fx, fy, cx, cy } = camera;
  const found = [];
  const off = (/** @type {number} */ at, /** @type {number} */ side) => Math.abs(at / side - 0.5);
  if (camera.width && camera.height && (camera.width !== width || camera.height !== height)) {
    found.push(`It is calibrated for ${camera.width} × ${camera.height} pixels, but the image has ${width} × ${height}.`);
  }
  if (Math.max(off(cx, width), off(cy, height)) > 0.15) {
    const swapped = Math.max(off(cy, width), off(cx, height)) < 0.1;
    found.push(
      swapped
        ? 'The principal point is far from the middle of the image; cx and cy seem to be swapped.'
        : 'The principal point (the small cross) is far from the middle of the image. Do the numbers belong to this image size?',
    );
  }
  if (Math.abs(fx / fy - 1) > 0.1) found.push('fx and fy differ by more than 10 %. Most cameras have square pixels.');
  const [across] = fieldOfView(camera, width, height);
  if (camera.model === 'pinhole' && (across > 130 || across < 5)) {
    found.push(`The field of view is ${across.toFixed(0)}° across. The focal length seems to belong to another image size.`);
  }
  return found;
}

// @ts-check
// Images as people hand them over. They are posted as they are, and shown at the size of a screen.

import { h } from './elements.js';

/** A picture for the screen: `bitmap` may be smaller than `width` x `height`, which are those of the file. */
/** @typedef {{blob: Blob, name: string, bitmap: ImageBitmap, width: number, height: number}} Picture */

const MAX_SHOWN_PX = 2048;

/**
 * @param {Blob} blob
 * @param {string} name
 * @param {boolean} [turned] whether its EXIF orientation is applied
 * @returns {Promise<Picture>}
 */
export async function picture(blob, name, turned = false) {
  /** @type {ImageBitmapOptions} */
  const options = { imageOrientation: turned ? 'from-image' : 'none' };
  const whole = await createImageBitmap(blob, options);
  const { width, height } = whole;
  const shrink = MAX_SHOWN_PX / Math.max(width, height);
  if (shrink >= 1) return { blob, name, bitmap: whole, width, height };
  const resize = { resizeWidth: Math.round(width * shrink), resizeHeight: Math.round(height * shrink), resizeQuality: /** @type {const} */ ('medium') };
  const bitmap = await createImageBitmap(whole, resize);
  whole.close();
  return { blob, name, bitmap, width, height };
}

/**
 * A button for files that also takes what is dropped on an area.
 * @param {string} words
 * @param {(file: File) => void} take
 * @param {string} [accept]
 */
export function fileButton(words, take, accept = 'image/*') {
  const input = h('input', {
    type: 'file', accept, class: 'visually-hidden',
    change: () => {
      const file = input.files?.[0];
      // The same file again is a new choice.
      input.value = '';
      if (file) take(file);
    },
  });
  return h('label', { class: 'button' }, input, words);
}

/** Files that are dropped on an element. @type {(area: HTMLElement, take: (file: File) => void) => void} */
export function onDrop(area, take) {
  area.addEventListener('dragover', (event) => {
    event.preventDefault();
    area.classList.add('dropping');
  });
  area.addEventListener('dragleave', () => area.classList.remove('dropping'));
  area.addEventListener('drop', (event) => {
    event.preventDefault();
    area.classList.remove('dropping');
    const file = event.dataTransfer?.files[0];
    if (file) take(file);
  });
}

/** A file that was pasted. @type {(event: ClipboardEvent) => File | undefined} */
export const pasted = (event) => [...(event.clipboardData?.files ?? [])].find((file) => file.type.startsWith('image/'));

/** The camera of this device. */
export class DeviceCamera {
  constructor() {
    this.video = h('video', { muted: true, playsinline: true });
    this.video.muted = true;
    this.canvas = h('canvas');
    /** @type {MediaStream | null} */
    this.stream = null;
  }

  /** Starts it, or says why not. */
  async start() {
    if (!navigator.mediaDevices) {
      throw new Error('The browser gives its camera only to pages from HTTPS or from localhost. Start posed with --tls-certificate and --tls-key.');
    }
    try {
      this.stream = await navigator.mediaDevices.getUserMedia({ video: { facingMode: 'environment', width: { ideal: 1280 } } });
    } catch (error) {
      const denied = error instanceof DOMException && error.name === 'NotAllowedError';
      throw new Error(denied ? 'The browser does not allow this page to use the camera.' : 'The browser finds no camera that works.');
    }
    this.video.srcObject = this.stream;
    await this.video.play();
  }

  stop() {
    this.stream?.getTracks().forEach((track) => track.stop());
    this.stream = null;
    this.video.srcObject = null;
  }

  /** The newest frame, as a JPEG file. @returns {Promise<Picture>} */
  async frame() {
    const { videoWidth: width, videoHeight: height } = this.video;
    Object.assign(this.canvas, { width, height });
    this.canvas.getContext('2d')?.drawImage(this.video, 0, 0);
    const bitmap = await createImageBitmap(this.canvas);
    const blob = await new Promise((done) => this.canvas.toBlob(done, 'image/jpeg', 0.92));
    if (!(blob instanceof Blob)) throw new Error('The browser cannot encode a frame.');
    return { blob, name: 'frame.jpg', bitmap, width, height };
  }
}

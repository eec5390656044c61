// @ts-check
// As many frames as the server answers, the newest only: the next is taken when the last is answered.

import { Refusal, inWords } from './api.js';

/** Waits after refusals double up to this, milliseconds. */
const MAX_WAIT_MS = 5000;
const MIN_WAIT_MS = 250;
/** Figures are over so many answers. */
const WINDOW = 10;

/**
 * @template T
 * @param {(signal: AbortSignal) => Promise<T>} ask takes the newest frame and has it answered
 * @param {(answer: T, figures: {perSecond: number, latencyMs: number}) => void} show
 * @param {(words: string) => void} trouble says why it waits; empty once it goes on
 * @returns {() => void} what stops it
 */
export function live(ask, show, trouble) {
  const stopped = new AbortController();
  const { signal } = stopped;
  void run();
  return () => stopped.abort();

  async function run() {
    let wait = 0;
    /** @type {{at: number, took: number}[]} */
    let answers = [];
    while (!signal.aborted) {
      const start = performance.now();
      try {
        const answer = await ask(signal);
        if (signal.aborted) return;
        const now = performance.now();
        answers = [...answers, { at: now, took: now - start }].slice(-WINDOW);
        const first = answers[0];
        const perSecond = (answers.length * 1e3) / (now - first.at + first.took);
        const latencyMs = answers.reduce((sum, { took }) => sum + took, 0) / answers.length;
        if (wait > 0) trouble('');
        wait = 0;
        show(answer, { perSecond, latencyMs });
      } catch (error) {
        if (signal.aborted) return;
        answers = [];
        const busy = error instanceof Refusal && error.status === 429;
        wait = Math.min(MAX_WAIT_MS, Math.max(MIN_WAIT_MS, 2 * wait, busy ? 1e3 * error.retryAfterS : 0));
        const when = `Trying again in ${(wait / 1e3).toFixed(wait < 1e3 ? 2 : 0)} s.`;
        trouble(busy ? `The server is busy: ${inWords(error)}. Slowing down. ${when}` : `${inWords(error)} ${when}`);
        await new Promise((done) => {
          const timer = setTimeout(done, wait);
          signal.addEventListener('abort', () => (clearTimeout(timer), done(null)), { once: true });
        });
      }
    }
  }
}

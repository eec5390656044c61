// @ts-check
// The view Status: how the server is doing, each second.

import { inWords, status } from './api.js';
import { byId, h, problem } from './elements.js';
import { mebibytes, outcome } from './words.js';

/** @typedef {import('./types').components['schemas']} Schemas */

const EVERY_MS = 1000;

export function statusView() {
  const facts = byId('status-facts', HTMLElement);
  const trouble = byId('status-trouble', HTMLElement);
  let turn = 0;

  async function follow() {
    const mine = ++turn;
    while (mine === turn) {
      try {
        const now = await status();
        if (mine !== turn) return;
        trouble.replaceChildren(...(now.ready ? [] : [problem(`Not ready: ${now.trouble ?? 'no reason given'}.`)]));
        facts.replaceChildren(...rows(now));
      } catch (error) {
        if (mine !== turn) return;
        trouble.replaceChildren(problem(`${inWords(error)} Trying again each second.`));
      }
      await new Promise((done) => setTimeout(done, EVERY_MS));
    }
  }

  return { load: follow, leave: () => void turn++ };
}

/** @param {Schemas['StatusReport']} now */
function rows({ ready, queue, workers, last_minute: last, models, memory }) {
  const ms = (/** @type {number} */ value) => `${value.toFixed(0)} ms`;
  const latency = last.latency_ms;
  const outcomes = Object.entries(last.outcomes).map(([name, count]) => h('li', {}, `${count} ${outcome(name)}`));
  const pairs = /** @type {[string, Node | string][]} */ ([
    ['ready', ready ? 'yes' : 'no'],
    ['images in the queue', `${queue.images} of at most ${queue.max_images}`],
    ['bytes of requests', `${mebibytes(queue.body_bytes)} of at most ${mebibytes(queue.max_body_bytes)}`],
    ['answers in the last minute', `${last.requests_per_second.toFixed(2)} per second`],
    ['latency in the last minute', latency ? `${ms(latency.p50)} median, ${ms(latency.p90)} for 9 of 10, ${ms(latency.p99)} for 99 of 100` : 'no answer yet'],
    ['outcomes in the last minute', outcomes.length > 0 ? h('ul', {}, ...outcomes) : 'no request for poses'],
    ['workers', `${workers.ready} ready, ${workers.restarts} restarts`],
    ['networks run on', models.provider],
    ['memory', `${mebibytes(memory.resident_bytes)} of at most ${mebibytes(memory.bound_bytes)}`],
    ['detector', models.detector ? h('code', {}, models.detector) : 'none that objects share'],
  ]);
  return pairs.flatMap(([term, value]) => [h('dt', {}, term), h('dd', {}, value)]);
}

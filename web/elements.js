// @ts-check
// Making and finding elements.

/** @typedef {Node | string | number | null | undefined | false} Child */

/**
 * An element. Attributes that are functions are listeners; `true` stands for an empty attribute, what is absent for none.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {Record<string, unknown>} [attributes]
 * @param {...Child} children
 * @returns {HTMLElementTagNameMap[T]}
 */
export function h(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === 'function') element.addEventListener(name, /** @type {EventListener} */ (value));
    else if (value === true) element.setAttribute(name, '');
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, String(value));
  }
  element.append(...children.filter((child) => child !== null && child !== undefined && child !== false).map(asNode));
  return element;
}

/** @param {Child} child */
const asNode = (child) => (child instanceof Node ? child : String(child));

/**
 * The element with an id, which must be there.
 * @template {Element} T
 * @param {string} id
 * @param {new () => T} kind
 * @returns {T}
 */
export function byId(id, kind) {
  const element = document.getElementById(id);
  if (!(element instanceof kind)) throw new Error(`no ${kind.name} #${id}`);
  return element;
}

let labels = 0;

/** A control with its label before it. @type {(words: string, control: HTMLElement, hint?: string) => HTMLElement} */
export function labelled(words, control, hint) {
  control.id ||= `control-${++labels}`;
  const label = h('label', { for: control.id }, words);
  if (!hint) return h('div', { class: 'field' }, label, control);
  const note = h('small', { id: `${control.id}-hint` }, hint);
  control.setAttribute('aria-describedby', note.id);
  return h('div', { class: 'field' }, label, control, note);
}

/** A field for a number. @type {(words: string, change: () => void, value?: string) => {field: HTMLElement, input: HTMLInputElement}} */
export function numberField(words, change, value = '') {
  const input = h('input', { type: 'text', inputmode: 'decimal', autocomplete: 'off', value, input: change });
  return { field: labelled(words, input), input };
}

/** What failed, in words, where it happened. @type {(words: string) => HTMLElement} */
export const problem = (words) => h('p', { class: 'problem', role: 'alert' }, words);

/** A button that copies text. @type {(words: string, text: () => string) => HTMLButtonElement} */
export function copyButton(words, text) {
  const button = h('button', {
    type: 'button',
    click: async () => {
      button.textContent = (await copied(text())) ? 'Copied' : 'Not allowed here';
      setTimeout(() => (button.textContent = words), 1500);
    },
  }, words);
  return button;
}

/** @param {string} text */
async function copied(text) {
  if (navigator.clipboard) return navigator.clipboard.writeText(text).then(() => true, () => false);
  // Without HTTPS a browser has only the old way.
  const area = h('textarea', { class: 'hidden-text', 'aria-hidden': 'true' }, text);
  document.body.append(area);
  area.select();
  const done = document.execCommand('copy');
  area.remove();
  return done;
}

/** A number for people. @type {(value: number, digits: number) => string} */
export const fixed = (value, digits) => value.toFixed(digits).replace('-', '−');

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
  element.append(...children.flatMap((child) => (child instanceof Node || child ? [child] : child === 0 ? ['0'] : [])).map(asNode));
  return element;
}

/** @param {Exclude<Child, null | undefined | false>} child */
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

/** A control below its label. @type {(words: string, control: HTMLElement) => HTMLElement} */
export function labelled(words, control) {
  control.id ||= `control-${++labels}`;
  return h('div', { class: 'field' }, h('label', { for: control.id }, words), control);
}

// @ts-check
// Which view is shown, and the token.

import { onUnauthenticated, token } from './api.js';
import { byId } from './elements.js';
import { objectsView } from './objects.js';
import { referenceView } from './reference.js';
import { statusView } from './status.js';
import { tryView } from './try.js';

/** A view: what to do when it is shown, and when it is left. @typedef {{load: (part?: string) => unknown, leave?: () => void}} View */
/** @type {Record<string, View>} */
const VIEWS = { try: tryView(), objects: objectsView(), reference: referenceView(), status: statusView() };

let shown = '';

function route() {
  const [wanted, part] = location.hash.slice(1).split('/').map(decodeURIComponent);
  const name = wanted in VIEWS ? wanted : 'try';
  if (name !== shown) VIEWS[shown]?.leave?.();
  shown = name;
  for (const view of Object.keys(VIEWS)) {
    byId(view, HTMLElement).hidden = view !== name;
    const link = document.querySelector(`nav a[href="#${view}"]`);
    if (view === name) link?.setAttribute('aria-current', 'page');
    else link?.removeAttribute('aria-current');
  }
  document.title = `posed: ${byId(`${name}-title`, HTMLElement).textContent}`;
  void VIEWS[name].load(part);
}

const form = byId('token', HTMLFormElement);
const field = byId('token-value', HTMLInputElement);
field.value = token.get();
form.hidden = !token.get();
form.addEventListener('submit', (event) => {
  event.preventDefault();
  token.set(field.value.trim());
  route();
});
onUnauthenticated(() => (form.hidden = false));

addEventListener('hashchange', route);
route();

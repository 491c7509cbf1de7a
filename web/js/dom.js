// Small helpers over the DOM. No markup strings anywhere: text is always text.

const PROPERTIES = new Set([
  'value', 'checked', 'disabled', 'hidden', 'indeterminate', 'selected', 'open', 'required',
  'readOnly', 'multiple', 'max', 'srcObject'
]);
const SVG = 'http://www.w3.org/2000/svg';

function assign(node, props) {
  for (const [name, value] of Object.entries(props ?? {})) {
    if (value === null || value === undefined || value === false && !PROPERTIES.has(name)) continue;
    if (name.startsWith('on'))
      node.addEventListener(name.slice(2), value);
    else if (PROPERTIES.has(name) && !(node instanceof SVGElement))
      node[name] = value;
    else
      node.setAttribute(name, value === true ? '' : String(value));
  }
}

/**
 * An HTML element. `on…` props are listeners, a few are properties, the rest attributes;
 * null, undefined and false children are left out.
 * @param {string} tag
 * @param {Record<string, any>|null} [props]
 * @param {...any} children nodes, strings, numbers or nested arrays of them
 * @returns {HTMLElement}
 */
export function h(tag, props, ...children) {
  const node = document.createElement(tag);
  assign(node, props);
  node.append(...flat(children));
  return node;
}

/** The same for SVG. @returns {SVGElement} */
export function s(tag, props, ...children) {
  const node = document.createElementNS(SVG, tag);
  assign(node, props);
  node.append(...flat(children));
  return node;
}

function flat(children) {
  return children.flat(Infinity)
      .filter((c) => c !== null && c !== undefined && c !== false)
      .map((c) => (c instanceof Node ? c : String(c)));
}

/** Replaces what `node` holds. */
export function fill(node, ...children) {
  node.replaceChildren(...flat(children));
  return node;
}

/** Sets text only when it differs, so that selections and live regions are left alone. */
export function text(node, value) {
  if (node.textContent !== String(value)) node.textContent = String(value);
}

const rows = new WeakMap();

/**
 * Makes the children of `parent` follow `items`, keeping the node of an item whose key stays.
 * @template T
 * @param {HTMLElement} parent holds nothing else
 * @param {T[]} items
 * @param {(item: T) => string} keyOf
 * @param {(item: T) => {node: HTMLElement, update?: (item: T) => void, remove?: () => void}} create
 */
export function follow(parent, items, keyOf, create) {
  const old = rows.get(parent) ?? new Map();
  const now = new Map();
  items.forEach((item, index) => {
    const key = keyOf(item);
    const row = old.get(key) ?? create(item);
    old.delete(key);
    now.set(key, row);
    row.update?.(item);
    if (parent.children[index] !== row.node)
      parent.insertBefore(row.node, parent.children[index] ?? null);
  });
  for (const row of old.values()) {
    row.node.remove();
    row.remove?.();
  }
  rows.set(parent, now);
}

/** Calls `work` now and every `ms`, until the signal aborts. */
export function every(ms, work, signal) {
  const timer = setInterval(work, ms);
  signal.addEventListener('abort', () => clearInterval(timer), {once: true});
  work();
}

/** Resolves after `ms`, or at once when the signal aborts. */
export function sleep(ms, signal) {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, ms);
    signal?.addEventListener('abort', () => {
      clearTimeout(timer);
      resolve();
    }, {once: true});
  });
}

/**
 * An image element whose bytes come from `load` (a token may be needed) once it is in sight; what that
 * hands to its second argument is shown until then.
 */
export function lazyImage(load, props, signal) {
  const image = h('img', {alt: '', draggable: 'false', ...props});
  const frame = h('span', {class: 'thumb', 'data-state': 'loading'}, image);
  const seen = new IntersectionObserver(async (entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    seen.disconnect();
    const show = (blob) => {
      showBlob(image, blob, signal);
      frame.dataset.state = 'ready';
    };
    try {
      show(await load(signal, show));
    } catch { frame.dataset.state = 'error'; }
  }, {rootMargin: '200px'});
  seen.observe(frame);
  signal.addEventListener('abort', () => seen.disconnect(), {once: true});
  return frame;
}

/**
 * Points `image` at a blob, in place of the one before; frees the address when the view goes; nothing
 * once it is gone.
 */
export function showBlob(image, blob, signal) {
  if (signal.aborted) return;
  const before = image.getAttribute('src');
  image.src = URL.createObjectURL(blob);
  if (before) return URL.revokeObjectURL(before);
  signal.addEventListener('abort', () => URL.revokeObjectURL(image.src), {once: true});
}

/** Hands a blob to the browser as a file. */
export function saveBlob(blob, name) {
  const address = URL.createObjectURL(blob);
  const link = h('a', {href: address, download: name});
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

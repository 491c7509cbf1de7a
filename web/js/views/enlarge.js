// One picture of several, as large as the window has room for.
import {h, showBlob, text} from '../dom.js';
import {problemBox} from '../ui.js';

/**
 * Shows picture `at` of `count` over the page, with ways to the next and to the one before (also the
 * arrow keys); Escape, or a click beside it, closes.
 * @param {{count: number, at: number, words: (i: number) => string,
 *     picture: (i: number, stop: AbortSignal) => Promise<Blob>}} what
 * @param {AbortSignal} signal of the view, with which it goes
 */
export function enlarge({count, at, words, picture}, signal) {
  const stop = new AbortController();
  const image = h('img', {alt: ''});
  const frame = h('div', {class: 'enlarged-frame', 'data-state': 'loading'}, image);
  const title = h('span', {role: 'status'});
  const move = (step, label, sign) =>
      h('button', {type: 'button', 'aria-label': label, disabled: count < 2, onclick: () => show(at + step)},
        sign);
  const dialog = h(
      'dialog', {
        class: 'dialog enlarged',
        'aria-label': 'Photograph',
        onclose: () => {
          stop.abort();
          dialog.remove();
        },
        onclick: (event) => {
          if (event.target === dialog) dialog.close();
        },
        onkeydown: (event) => {
          if (event.key === 'ArrowLeft') show(at - 1);
          if (event.key === 'ArrowRight') show(at + 1);
        }
      },
      frame,
      h('div', {class: 'row'}, move(-1, 'The one before', '‹'), move(1, 'The next one', '›'), title,
        h('button', {type: 'button', class: 'close', autofocus: true, onclick: () => dialog.close()},
          'Close')));

  async function show(wanted) {
    at = (wanted + count) % count;
    const now = at;
    image.alt = words(now);
    text(title, `${words(now)} · ${now + 1} of ${count}`);
    frame.dataset.state = 'loading';
    try {
      const blob = await picture(now, stop.signal);
      if (now !== at || stop.signal.aborted) return;  // another one was asked for meanwhile
      showBlob(image, blob, stop.signal);
      frame.replaceChildren(image);
      await image.decode();
      if (now !== at) return;
      frame.dataset.state = 'ready';
    } catch (error) {
      if (now !== at || stop.signal.aborted) return;
      frame.replaceChildren(problemBox(error));
      frame.dataset.state = 'error';
    }
  }
  signal.addEventListener('abort', () => dialog.close(), {once: true, signal: stop.signal});
  document.body.append(dialog);
  dialog.showModal();
  show(at);
}

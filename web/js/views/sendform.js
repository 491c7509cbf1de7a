// The form around what is sent in: what it says of it, its fields, and buttons that give way to a
// meter and Cancel while it is on its way.
import {fill, h, text} from '../dom.js';
import {meter, showFaults, toast} from '../ui.js';

/**
 * @param {{words: string, fields: any[], back: () => void, isReady?: () => boolean,
 *     send: (bar: any, stop: AbortSignal, cancel: () => void) => Promise<void>}} how `words`: on the
 *     button that sends
 * @param {any} above the buttons
 * @param {any} below
 */
export function sendForm({words, fields, back, isReady = () => true, send}, above, below = null) {
  const problem = h('div');
  const progress = h('div');
  const buttons = h('div', {class: 'row end'});
  const refusal = h('p', {class: 'quiet', role: 'status'});
  const showFault = (error) => showFaults(fields, problem, error);
  async function begin() {
    const stop = new AbortController();
    const bar = meter('Upload');
    showFault(null);
    fill(progress, bar.node);
    fill(buttons, h('button', {type: 'button', onclick: () => stop.abort()}, 'Cancel'));
    try {
      await send(bar, stop.signal, () => stop.abort());
    } catch (error) {
      if (!node.isConnected && error.name !== 'AbortError') toast(error);  // its view was left
      fill(progress);
      showFault(error.name === 'AbortError' ? null : error);
      ready();
    }
  }
  const submit = h('button', {type: 'submit', class: 'primary'}, words);
  const ready = () =>
      fill(buttons, h('button', {type: 'button', onclick: back}, 'Back'), submit);
  ready();
  /** Nothing is sent that would be for nothing; `why`: in words, '': it may be sent. */
  const refuse = (why) => {
    submit.disabled = Boolean(why);
    text(refusal, why);
  };
  const node = h(
      'form', {
        onsubmit: (event) => {
          event.preventDefault();
          if (isReady()) begin();
        }
      },
      h('div', {class: 'sending'}, above, problem, progress, refusal, buttons), below);
  return {node, showFault, refuse};
}

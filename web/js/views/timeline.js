// Time along a path: a scrubber, and the keys under it, which are dragged to other times.
import {follow, h, text} from '../dom.js';
import {duration} from '../path.js';

const clock = (seconds) => `${seconds.toFixed(2)} s`;

/**
 * @param {{path: () => any, seek: (time: number) => void, shift: (id: string, time: number) =>
 *     void,
 *   show: (id: string) => void, selected: () => string|null}} host times in seconds from the first
 *   key
 */
export function createTimeline(host) {
  const scrub = h('input', {
    type: 'range',
    min: 0,
    max: 1,
    step: 'any',
    value: 0,
    class: 'scrub',
    'aria-label': 'Time along the path, seconds'
  });
  const at = h('output', {class: 'clock'}, clock(0));
  const track = h('div', {class: 'track'});
  const node =
      h('div', {class: 'timeline', hidden: true}, h('div', {class: 'lane'}, scrub, track), at);
  const start = () => host.path().keys[0]?.time ?? 0;
  const whole = () => duration(host.path()) || 1;

  scrub.addEventListener('input', () => {
    text(at, clock(Number(scrub.value)));
    host.seek(Number(scrub.value));
  });

  function mark(first) {
    const button = h('button', {type: 'button', class: 'mark'}, h('span', {'aria-hidden': 'true'}));
    let dragged = false;
    let held = null;  // the time and the scale where a drag began: a key at an end moves both
    const timeAt = (event) =>
        held.time + ((event.clientX - held.x) / track.getBoundingClientRect().width) * held.whole;
    button.addEventListener('pointerdown', (event) => {
      button.setPointerCapture(event.pointerId);
      dragged = false;
      const {time} = host.path().keys.find((item) => item.id === first.id);
      held = {time, x: event.clientX, whole: whole()};
    });
    button.addEventListener('pointermove', (event) => {
      if (!button.hasPointerCapture(event.pointerId)) return;
      if (!dragged && Math.abs(event.movementX) < 1) return;
      dragged = true;
      host.shift(first.id, timeAt(event));
      text(at, clock(host.path().keys.find((item) => item.id === first.id).time - start()));
    });
    button.addEventListener('click', () => dragged || host.show(first.id));
    button.addEventListener('keydown', (event) => {
      const step = {ArrowLeft: -0.1, ArrowRight: 0.1}[event.key];
      if (!step) return;
      event.preventDefault();
      const key = host.path().keys.find((item) => item.id === first.id);
      host.shift(first.id, key.time + step);
    });
    const update = (key) => {
      const {keys} = host.path();
      const number = keys.findIndex((item) => item.id === key.id) + 1;
      button.style.left = `${(100 * (key.time - start())) / whole()}%`;
      button.dataset.selected = String(host.selected() === key.id);
      button.setAttribute('aria-label', `Key ${number} at ${clock(key.time)}; arrow keys move it`);
      button.title = `Key ${number}, ${clock(key.time)}`;
    };
    return {node: button, update};
  }

  return {
    node,
    /** After a change of the path. */
    update() {
      const {keys} = host.path();
      node.hidden = keys.length < 2;
      scrub.max = whole();
      follow(track, keys, (key) => key.id, mark);
    },
    /** Shows a time without moving the camera. */
    set(time) {
      scrub.value = time;
      text(at, clock(time));
    },
    get time() { return Number(scrub.value); },
  };
}

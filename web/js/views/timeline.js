// Time along a path: a scrubber, and the keys under it, which are dragged to other times.
import {follow, h, text} from '../dom.js';
import {duration, momentOf} from '../path.js';
import {announce} from '../ui.js';

const HIDDEN_PX = 3;  // nearer, one mark hides another
const STILL_PX = 3;   // a press that moves no further is a click

const clock = (seconds) => `${seconds.toFixed(2)} s`;

/**
 * @param {{path: () => any, seek: (time: number) => void, shift: (id: string, time: number, drag?:
 *     object) => void, show: (id: string) => void, remove: (id: string) => void, selected: () =>
 *     string|null}} host times in seconds from the first key; `drag` is one object for all of a drag
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
  const whole = () => duration(host.path()) || 1;

  scrub.addEventListener('input', () => {
    text(at, clock(Number(scrub.value)));
    host.seek(Number(scrub.value));
  });

  const indexOf = (id) => host.path().keys.findIndex((key) => key.id === id);
  const momentOfKey = (id) => momentOf(host.path(), indexOf(id));
  /** At constant speed the way says when a key between the ends is passed: its time only orders it. */
  const isFixed = (id) =>
      host.path().constantSpeed && host.path().keys.slice(1, -1).some((key) => key.id === id);

  /** The keys whose marks lie at a place of the window, in their order: the nearest, and those it hides. */
  function keysAt(x) {
    const {left, width} = track.getBoundingClientRect();
    const path = host.path();
    const placed =
        path.keys.map((key, index) => ({key, at: left + (width * momentOf(path, index)) / whole()}));
    const nearest = placed.reduce((a, b) => (Math.abs(b.at - x) < Math.abs(a.at - x) ? b : a));
    return placed.filter(({at}) => Math.abs(at - nearest.at) <= HIDDEN_PX).map(({key}) => key);
  }

  function mark(first) {
    const button = h('button', {type: 'button', class: 'mark'}, h('span', {'aria-hidden': 'true'}));
    let drag = null;  // where it began, and the scale there: a key at an end moves both
    button.addEventListener('pointerdown', (event) => {
      if (event.button) return;
      button.setPointerCapture(event.pointerId);
      drag = {x: event.clientX, whole: whole(), keys: keysAt(event.clientX), key: null};
    });
    button.addEventListener('pointermove', (event) => {
      if (!drag || !button.hasPointerCapture(event.pointerId)) return;
      const by = event.clientX - drag.x;
      if (!drag.key && Math.abs(by) < STILL_PX) return;
      drag.key ??= by > 0 ? drag.keys.at(-1) : drag.keys[0];  // of a heap, the one that can go there
      const {id, time} = drag.key;
      if (isFixed(id)) return;
      host.shift(id, time + (by / track.getBoundingClientRect().width) * drag.whole, drag);
      text(at, clock(momentOfKey(id)));
    });
    button.addEventListener('lostpointercapture', () => text(at, clock(Number(scrub.value))));
    button.addEventListener('click', (event) => {
      if (!event.detail)
        host.show(first.id);  // by the keyboard
      else if (!drag?.key)
        host.show((drag?.keys ?? [first])[0].id);
    });
    button.addEventListener('keydown', (event) => {
      const step = {ArrowLeft: -0.1, ArrowRight: 0.1}[event.key];
      const place = [...track.children].indexOf(button);
      if (event.key === 'Delete') {
        host.remove(first.id);
        track.children[Math.min(place, track.children.length - 1)]?.focus();
      }
      if (!step) return;
      event.preventDefault();
      if (isFixed(first.id)) return;
      host.shift(first.id, host.path().keys[indexOf(first.id)].time + (event.shiftKey ? 10 : 1) * step);
      announce(`Key ${place + 1} at ${clock(momentOfKey(first.id))}`);
    });
    const update = (key) => {
      const number = indexOf(key.id) + 1;
      const moment = clock(momentOfKey(key.id));
      button.style.left = `${(100 * momentOfKey(key.id)) / whole()}%`;
      button.dataset.selected = String(host.selected() === key.id);
      button.dataset.fixed = String(isFixed(key.id));
      button.setAttribute(
          'aria-label',
          `Key ${number} at ${moment}${
              isFixed(key.id) ? ', by constant speed' : '; arrow keys move it'}, Delete removes it`);
      button.title = `Key ${number}, ${moment}${isFixed(key.id) ? ', by constant speed' : ''}`;
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

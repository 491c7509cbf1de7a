// A small line chart in SVG: PSNR over seconds of training.
import {fill, s} from './dom.js';

/**
 * Round tick positions covering [low, high], at most `count` + 1 of them.
 * @returns {number[]}
 */
export function ticks(low, high, count) {
  const span = high - low || 1;
  const raw = span / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const unit = [1, 2, 5, 10].find((m) => m * power >= raw * 0.999) * power;
  const result = [];
  for (let i = Math.ceil(low / unit - 1e-9); i * unit <= high + 1e-9 * unit; i++)
    result.push(Number((i * unit).toPrecision(12)));
  return result;
}

/** The value axis: whole decibels around the points, at least 2 dB tall. */
export function valueRange(points) {
  const values = points.map((p) => p.y);
  let low = Math.floor(Math.min(...values));
  let high = Math.ceil(Math.max(...values) + 0.15);
  if (high - low < 2) {
    low -= 1;
    high = low + 3;
  }
  return [low, high];
}

const MARGIN = {
  left: 34,
  right: 14,
  top: 26,
  bottom: 34
};

/**
 * Draws into `host`; the size follows its box where none is given. Other trainings' points are
 * drawn behind, each with its name.
 * @param {HTMLElement} host
 * @param {{x: number, y: number, step: number}[]} points by x, ascending
 * @param {{limitX: number, running: boolean, now: number, past?: Past, size?: {width: number,
 *     height: number}, others?: {name: string, points: {x: number, y: number, step: number}[]}[]}}
 *     options limitX and now in seconds, 0 = unknown
 * @typedef {{marks: {train_seconds: number, step: number}[], at: number|null, look: (seconds:
 *     number) => void}} Past what of the training can be looked at, what is, and how to
 */
export function drawChart(host, points, {limitX, running, now, past, size, others = []}) {
  const width = size?.width ?? Math.max(220, host.clientWidth);
  const height = size?.height ?? Math.max(140, host.clientHeight);
  const inner = {w: width - MARGIN.left - MARGIN.right, h: height - MARGIN.top - MARGIN.bottom};
  const ends = others.map((other) => other.points.at(-1)?.x ?? 0);
  const xHigh = Math.max(limitX || 0, now || 0, points.at(-1)?.x ?? 0, ...ends, running ? 10 : 1);
  const all = [...points, ...others.flatMap((other) => other.points)];
  const [yLow, yHigh] = all.length ? valueRange(all) : [10, 35];
  const X = (x) => MARGIN.left + (x / xHigh) * inner.w;
  const Y = (y) => MARGIN.top + (1 - (y - yLow) / (yHigh - yLow)) * inner.h;
  const last = points.at(-1);
  const root = s('svg', {
    viewBox: `0 0 ${width} ${height}`,
    width,
    height,
    role: past?.marks.length ? 'group' : 'img',
    'aria-label': summary(points),
    class: 'chart'
  });
  for (const y of ticks(yLow, yHigh, Math.max(2, Math.floor(inner.h / 34)))) {
    root.append(
        s('line', {class: 'grid', x1: MARGIN.left, x2: width - MARGIN.right, y1: Y(y), y2: Y(y)}),
        s('text', {class: 'tick', x: MARGIN.left - 7, y: Y(y) + 4, 'text-anchor': 'end'}, y));
  }
  for (const x of ticks(0, xHigh, Math.max(2, Math.floor(inner.w / 64)))) {
    root.append(
        s('line', {
          class: 'grid',
          x1: X(x),
          x2: X(x),
          y1: height - MARGIN.bottom,
          y2: height - MARGIN.bottom + 4
        }),
        s('text', {class: 'tick', x: X(x), y: height - MARGIN.bottom + 16, 'text-anchor': 'middle'},
          x));
  }
  root.append(
      s('line', {
        class: 'axis',
        x1: MARGIN.left,
        x2: width - MARGIN.right,
        y1: height - MARGIN.bottom,
        y2: height - MARGIN.bottom
      }),
      s('text', {class: 'unit', x: width - MARGIN.right, y: height - 4, 'text-anchor': 'end'},
        'seconds of training'),
      s('text', {class: 'unit', x: 4, y: 11}, 'PSNR, dB'));
  if (now && running)
    root.append(
        s('line',
          {class: 'now', x1: X(now), x2: X(now), y1: MARGIN.top, y2: height - MARGIN.bottom}));
  const lineOf = (some) =>
      some.map((p, i) => `${i ? 'L' : 'M'}${X(p.x).toFixed(1)},${Y(p.y).toFixed(1)}`).join('');
  others.forEach((other, i) => {
    const [title, end] = [s('title', null, other.name), other.points.at(-1)];
    root.append(
        s('path', {class: `line other other-${i}`, d: lineOf(other.points)}, title),
        s('circle', {class: `end other-${i}`, cx: X(end.x), cy: Y(end.y), r: 3}, title.cloneNode(true)));
  });
  if (points.length) {
    root.append(s('path', {class: 'line', d: lineOf(points)}));
    if (points.length < 80)
      points.forEach(
          (p) => root.append(s('circle', {class: 'dot', cx: X(p.x), cy: Y(p.y), r: 2.2})));
    const end = X(last.x) > width - 80;
    root.append(
        s('circle', {class: 'last', cx: X(last.x), cy: Y(last.y), r: 4}),
        s('text', {
          class: 'value',
          x: X(last.x) + (end ? -9 : 9),
          y: Math.max(Y(last.y) - 8, 11),
          'text-anchor': end ? 'end' : 'start'
        },
          last.y.toFixed(2)));
  } else {
    root.append(
        s('text', {
          class: 'nothing',
          x: MARGIN.left + inner.w / 2,
          y: MARGIN.top + inner.h / 2,
          'text-anchor': 'middle'
        },
          running ? 'The first figure comes with the first evaluation' : 'No figures recorded'));
  }
  const held = host.contains(document.activeElement) ? document.activeElement.dataset.at : null;
  fill(host, root);
  if (!points.length) return;
  showProbe(host, root, points, X, Y, height);
  if (past) root.append(...past.marks.map((mark) => markOf(mark, past, X, Y(valueAt(points, mark.train_seconds)))));
  if (held) root.querySelector(`[data-at="${held}"]`)?.focus();
}

/** The curve's value at x: between the points, beyond them the nearest one's. */
export function valueAt(points, x) {
  const next = points.findIndex((p) => p.x >= x);
  if (next < 0) return points.at(-1).y;
  if (next === 0) return points[0].y;
  const [a, b] = [points[next - 1], points[next]];
  return a.y + ((x - a.x) / (b.x - a.x || 1)) * (b.y - a.y);
}

/** What was kept of the training, to be looked at. */
function markOf({train_seconds: seconds, step}, {at, look}, X, y) {
  const x = X(seconds);
  const words = `Look at it after ${seconds.toFixed(1)} s of training, step ${step}`;
  const choose = (event) => {
    if (event.type === 'keydown' && event.key !== 'Enter' && event.key !== ' ') return;
    event.preventDefault();
    look(seconds);
  };
  return s(
      'g', {
        class: 'moment',
        role: 'button',
        tabindex: 0,
        'data-at': seconds,
        'aria-label': words,
        'aria-pressed': String(at === seconds),
        onclick: choose,
        onkeydown: choose
      },
      s('title', null, words), s('circle', {class: 'reach', cx: x, cy: y, r: 12}),
      s('path', {d: `M${x},${y - 6}l6,6l-6,6l-6,-6z`}));
}

const pointers = new WeakMap();  // host -> where the pointer is, kept over redrawing

/** Shows the point nearest to the pointer. */
function showProbe(host, root, points, X, Y, height) {
  const mark = s('g', {class: 'probe'});
  root.append(mark);
  const draw = () => {
    const at = pointers.get(host);
    if (at === undefined) {
      fill(mark);
      return;
    }
    const near =
        points.reduce((best, p) => (Math.abs(X(p.x) - at) < Math.abs(X(best.x) - at) ? p : best));
    const x = X(near.x);
    const flip = x > host.clientWidth / 2;
    fill(
        mark, s('line', {x1: x, x2: x, y1: MARGIN.top, y2: height - MARGIN.bottom}),
        s('circle', {cx: x, cy: Y(near.y), r: 4}),
        s('text', {
          x: x + (flip ? -8 : 8),
          y: height - MARGIN.bottom - 8,
          'text-anchor': flip ? 'end' : 'start'
        },
          `${near.y.toFixed(2)} dB · ${near.x.toFixed(1)} s · step ${near.step}`));
  };
  root.addEventListener('pointerleave', () => {
    pointers.delete(host);
    draw();
  });
  root.addEventListener('pointermove', (event) => {
    pointers.set(host, event.clientX - root.getBoundingClientRect().left);
    draw();
  });
  draw();
}

/** The chart in a sentence. */
export function summary(points) {
  if (!points.length) return 'PSNR over seconds of training: no figures yet';
  const [first, last] = [points[0], points.at(-1)];
  return `PSNR over seconds of training: from ${first.y.toFixed(1)} dB at ${
      first.x.toFixed(0)} s to ${last.y.toFixed(2)} dB at ${last.x.toFixed(0)} s`;
}

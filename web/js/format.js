// Numbers as people read them. Missing values become an en dash.

const NONE = '–';
const known = (x) => typeof x === 'number' && Number.isFinite(x);

/** "28.31 dB" */
export const decibel = (x, digits = 2) => (known(x) ? `${x.toFixed(digits)} dB` : NONE);
/** A PSNR to expect and how far off it may be: "30.4 dB ± 0.5 expected" */
export const expectedPsnr = (psnr, spread) => (known(psnr) ?
    `${decibel(psnr, 1)}${known(spread) ? ` ± ${spread.toFixed(1)}` : ''} expected` :
    'accuracy not known');
/** Grouped by thin spaces: "12 400" */
export const whole = (x) =>
    (known(x) ? Math.round(x).toString().replace(/\B(?=(\d{3})+$)/g, '\u202f') : NONE);
export const fixed = (x, digits) => (known(x) ? x.toFixed(digits) : NONE);

/** Three significant digits and a decimal prefix: "3.41 M" */
export function compact(x) {
  if (!known(x)) return NONE;
  const size = Math.abs(x);
  for (const [unit, name] of [[1e9, 'G'], [1e6, 'M'], [1e3, 'k']]) {
    if (size >= unit) return `${Number((x / unit).toPrecision(3))}\u202f${name}`;
  }
  return String(Number(x.toPrecision(3)));
}

export function bytes(x) {
  if (!known(x)) return NONE;
  for (const [unit, name] of [[2 ** 30, 'GiB'], [2 ** 20, 'MiB'], [2 ** 10, 'KiB']]) {
    if (x >= unit) return `${(x / unit).toFixed(x < 10 * unit ? 1 : 0)} ${name}`;
  }
  return `${x} B`;
}

/** "41 s", "3 min 20 s", "1 h 05 min" */
export function seconds(x) {
  if (!known(x)) return NONE;
  if (x < 10) return `${Number(x.toFixed(1))} s`;
  const all = Math.round(x);
  if (all < 60) return `${all} s`;
  if (all < 3600) return `${Math.floor(all / 60)} min ${String(all % 60).padStart(2, '0')} s`;
  return `${Math.floor(all / 3600)} h ${String(Math.floor(all / 60) % 60).padStart(2, '0')} min`;
}

/** "2.4 ms", "240 ms", "2.4 s" */
export const milliseconds = (x) => (!known(x) ? NONE :
                                        x >= 1000 ? seconds(x / 1000) :
                                                    `${x < 10 ? x.toFixed(1) : Math.round(x)} ms`);
export const percent = (x) => (known(x) ? `${Math.round(100 * x)} %` : NONE);

/** A point in time (ISO text or ms since 1970) beside now: "3 min ago". */
export function ago(when, now = Date.now()) {
  const time = typeof when === 'number' ? when : Date.parse(when);
  if (!known(time)) return NONE;
  const past = Math.max(0, (now - time) / 1000);
  if (past < 45) return 'just now';
  if (past < 3600) return `${Math.max(1, Math.round(past / 60))} min ago`;
  if (past < 86400) return `${Math.round(past / 3600)} h ago`;
  return new Date(time).toISOString().slice(0, 10);
}

export const plural = (count, one, many = `${one}s`) =>
    `${whole(count)} ${count === 1 ? one : many}`;

// How fine a path's frames are: three ways out of the scene's curve, and how long each takes.
import {h, text} from '../dom.js';
import {decibel, seconds} from '../format.js';
import {frameCount} from '../path.js';
import {choice} from '../ui.js';

/**
 * The quickest way that loses no more: dB of PSNR against photographs; without photographs, at least
 * so many dB beside the full picture.
 */
const LOSSES = [['quick', 1, 34], ['good', 0.2, 42]];
const UNMEASURED = {
  quick: {tolerance: 0.12},
  good: {tolerance: 0.03},
  best: {}
};
/** Cones along a pixel's side, where an aperture or a shutter spreads them; 8 is what best takes. */
const SPREAD = {
  quick: 2,
  good: 4,
  best: 8
};
const NAMES = Object.keys(SPREAD);

const isNear = (point, full, loss, least) => point.psnr !== null && full.psnr !== null ?
    full.psnr - point.psnr <= loss :
    (point.psnr_full ?? Infinity) >= least;

/**
 * @param {any} curve the scene's, or null
 * @returns {{name: string, setting: any, msPerPixel: number|null, psnr: number|null}[]} quickest
 *     first
 */
export function qualitiesOf(curve) {
  if (!curve)
    return NAMES.map((name) => ({name, setting: UNMEASURED[name], msPerPixel: null, psnr: null}));
  const full = curve.points.at(-1);
  const chosen = LOSSES.map(
      ([name, loss, least]) =>
          [name, curve.points.find((point) => isNear(point, full, loss, least))]);
  return [...chosen, ['best', full]].map(([name, point]) => ({
                                           name,
                                           setting: point === full ? {} : point.setting,
                                           msPerPixel: point.ms_median / (curve.width * curve.height),
                                           psnr: point.psnr
                                         }));
}

const spreads = (path) => path.keys.some(({optics}) => optics?.aperture || optics?.shutter);

/** The same for a path through a lens: what counts is how many cones a pixel has. */
function throughLens(qualities, cones) {
  const full = qualities.at(-1).msPerPixel;
  return qualities.map(({name}) => ({
                         name,
                         setting: name === 'best' ? {} : {supersample: SPREAD[name]},
                         msPerPixel: full === null ? null : (full * SPREAD[name] ** 2) / cones,
                         psnr: null
                       }));
}

/** Of a whole path, "about 12 s"; empty where nothing is known. */
const timeOf = (path, msPerPixel) => {
  const all = ((msPerPixel ?? 0) * frameCount(path) * path.width * path.height) / 1000;
  return all ? `about ${seconds(Math.max(1, Math.round(all)))}` : '';
};

/**
 * @param {any} scene
 * @returns {{node: HTMLElement, setting: () => any, update: (path: any, seenMsPerPixel: number) =>
 *     void, curve: any}} `setting` goes into a job's options; `seenMsPerPixel` is what the full
 *     picture shown last took, for a scene without a curve
 */
export function createQuality(scene) {
  const words = Object.fromEntries(NAMES.map((name) => [name, h('small')]));
  const item = choice('Quality', NAMES.map((name) => [name, [name, words[name]]]), 'best');
  const note = h('p', {class: 'quiet'});
  const node = h('div', {class: 'qualities'}, item.node, note);
  const cones = scene.effects?.find((effect) => effect.name === 'cones')?.on ? 4 : 1;
  let curve = null;
  let now = qualitiesOf(null);
  return {
    node,
    setting: () => now.find(({name}) => name === item.control.value).setting,
    set curve(next) { curve = next; },
    update(path, seenMsPerPixel) {
      const many = spreads(path);
      node.hidden = !path.keys.length;
      now = qualitiesOf(curve);
      if (!curve) now.at(-1).msPerPixel = seenMsPerPixel || null;
      if (many) now = throughLens(now, cones);
      for (const {name, msPerPixel, psnr} of now)
        text(
            words[name],
            [timeOf(path, msPerPixel), psnr === null ? '' : decibel(psnr, 1)].filter(Boolean).join(
                ' · '));
      text(
          note,
          many  ? 'Through a lens or a shutter the fewer cones, the more grain: 4, 16 or 64 a pixel.' :
          curve ? `By the scene’s curve: quick may lose ${LOSSES[0][1]} dB, good ${LOSSES[1][1]} dB.` :
                  'What each takes is told once the scene’s curve is measured.');
    }
  };
}

// What a picture can show, and what a path is made into.
import {h} from './dom.js';

/** The names of the API and what they are called here, for a choice. */
export const OUTPUTS = [
  ['rgb', 'colour'], ['depth', 'depth'], ['alpha', 'opacity'], ['normal', 'normals'],
  ['cost', 'cost', 'Samples a pixel'], ['level', 'level', 'Of the pyramid'],
  ['footprint', 'footprint', 'Of a pixel']
];
export const FILMS = [['h264', 'MP4 H.264'], ['av1', 'MP4 AV1'], ['vp9', 'WebM VP9'], ['gif', 'GIF']];
export const FRAMES = [
  ['png', 'PNG'], ['png16', 'PNG of 16 bits'], ['jpeg', 'JPEG'], ['exr', 'EXR with depth and normals']
];
/** What one of them is called. */
export const called = (names, key) => names.find(([name]) => name === key)?.[1] ?? key;

/**
 * Colours between words: what they stand for at either end.
 * @param {string} colours a class: which ones @param {string} low @param {string} high @param
 *     {string} label the same without seeing them
 */
export const colourScale = (colours, low, high, label) =>
    h('span', {class: 'legend', role: 'img', 'aria-label': `Colours: ${label}`}, low,
      h('span', {class: `legend-bar ${colours}`}), high);

/**
 * What the colours of a heat map or of a depth stand for. @param {string} scale the header
 * X-Ripnerf-Scale, "0 50 samples"; empty: nothing to tell @param {string} output of the API
 */
export function legend(scale, output) {
  const [low, most, ...unit] = scale.split(' ');
  if (!most) return null;
  const words = unit.join(' ');
  const high = `${most} ${most === '1' ? words.replace(/s$/, '') : words}`;
  return output === 'depth' ?
      colourScale(
          'depth-bar', low, `${high} · black: none`,
          `bright ${low}, dark ${high}, black where nothing is`) :
      colourScale(
          'heat-bar', low, `${high} · black: 0`, `dark ${low}, bright ${high}, black where it is 0`);
}

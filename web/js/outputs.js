// What a picture can show.
import {h} from './dom.js';

/** The names of the API and what they are called here, for a choice. */
export const OUTPUTS = [
  ['rgb', 'colour'], ['depth', 'depth'], ['alpha', 'opacity'], ['normal', 'normals'],
  ['cost', 'cost: samples a pixel'], ['level', 'level of the pyramid'],
  ['footprint', 'footprint of a pixel']
];

/**
 * What the colours of a heat map stand for. @param {string} scale the header X-Ripnerf-Scale,
 * "0 50 samples"; empty: nothing to tell
 */
export function legend(scale) {
  const [low, high, ...unit] = scale.split(' ');
  if (!high) return null;
  return h('span', {class: 'legend', role: 'img', 'aria-label': `Colours: dark ${low}, bright ${high} ${unit.join(' ')}`},
      low, h('span', {class: 'legend-bar'}), `${high} ${unit.join(' ')}`);
}

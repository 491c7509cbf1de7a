// A scene as a file for elsewhere: what it can be exported as, and what came of it.
import {api, token} from '../api.js';
import {h, saveBlob} from '../dom.js';
import {may, putJob} from '../store.js';
import {bytes, fixed, plural} from '../format.js';
import {action} from '../ui.js';
import {go, link} from '../router.js';

const KINDS = [
  ['For viewing', {as: 'scene'}, 'Without the optimiser, in as few bits as lose 0.05 dB at most'],
  ['Mesh, .ply', {as: 'mesh', format: 'ply'}, 'Triangles with colours at their corners'],
  ['Mesh, .obj', {as: 'mesh', format: 'obj'}, 'Triangles with colours at their corners']
];

/** Buttons that have the scene exported; each leads to its job. */
export function exportButtons(scene) {
  if (!scene.checkpoints.length || !may('render')) return null;
  return h(
      'div', {class: 'row wrap', role: 'group', 'aria-label': 'Export'},
      h('span', {class: 'quiet'}, 'Export'),
      KINDS.map(
          ([words, options, hint]) =>
              action(words, async () => {
                const job = putJob(await api.submit({type: 'export', scene: scene.id, options}));
                go(link.job(job.id));
              }, {kind: 'small', title: hint})));
}

/** What the planes of a file for viewing are kept as. */
export const planesOf = (bits) => bits === 32 ? 'planes as trained' :
    bits === 16                               ? 'planes in 16 bits a value' :
                                                `planes in ${bits} bits a value by blocks`;

/** In one line. */
export const exportWords = (r) => r.bits ?
    `${r.file}: ${bytes(r.bytes)}, ${fixed(r.loss, 3)} dB less` :
    `${r.file}: ${plural(r.triangles, 'triangle')}`;

/** What an export job made, and the file. */
export function exportResult(job) {
  const {result: r} = job;
  const path = `v1/jobs/${encodeURIComponent(job.id)}/export`;
  const name = `${job.scene_name ?? job.id}.${r.file.split('.').at(-1)}`;
  const file = token.get() ?
      action('Download', async () => saveBlob(await api.download(path), name), {kind: 'primary'}) :
      h('a', {class: 'button primary', href: path, download: name}, 'Download');
  const about = r.bits ?
      [
        h('p', null,
          `${planesOf(r.bits)}, ${bytes(r.bytes)}: ${fixed(r.psnr, 2)} dB on ${
              plural(r.views, `${r.split} view`)}, ${fixed(r.loss, 3)} dB less than the scene.`),
        h('p', {class: 'quiet'}, h('code', null, `ripnerf import ${name} --name N`),
          ' makes a scene of it, here or elsewhere, to be looked at; it is not trained further.')
      ] :
      h('p', null,
        `${plural(r.vertices, 'vertex', 'vertices')}, ${plural(r.triangles, 'triangle')}, ${
            bytes(r.bytes)}.`);
  return h('div', null, about, h('div', {class: 'row'}, file));
}

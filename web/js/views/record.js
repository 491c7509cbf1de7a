// A scene's record: differences from the paper, evaluations, checkpoints, deletion.
import {api, token} from '../api.js';
import {fill, h, saveBlob} from '../dom.js';
import {
  find,
  isActive,
  may,
  mayChange,
  means,
  putJob,
  refreshSoon,
  state,
  watch
} from '../store.js';
import {ago, bytes, decibel, fixed, milliseconds, plural, seconds, whole} from '../format.js';
import {action, confirmFirst, facts, meter, panel, progressWords, recordedProblem, toast} from '../ui.js';
import {reportOf} from '../report.js';
import {go, link} from '../router.js';
import {exportButtons, planesOf} from './exports.js';

/** Folded: it is long, and few who look at a scene ask for it. */
export function differencesPanel(scene) {
  const {differences} = scene;
  return panel(
      'Compared with the paper', null,
      differences.length ?
          h('details', null, h('summary', null, plural(differences.length, 'difference')),
            h('p', {class: 'quiet'},
              'With the gain where it was measured, in test PSNR of lego after 15 s:'),
            h('ul', {class: 'differences'},
              differences.map(
                  (item) =>
                      h('li', null, item.what,
                        item.measured ? h('span', {class: 'gain'}, item.measured) : null)))) :
          h('p', {class: 'quiet'},
            scene.config ? 'No difference: this is the published method.' :
                           'Known when training begins.'));
}

/**
 * Finished evaluations, one under way, and the way to start one.
 * @param {any} scene @param {(split: string, index: number) => void} look at a view beside its
 *     photograph, where there is one @param {AbortSignal} signal
 */
export function qualityPanel(scene, look, signal) {
  const list = h('div');
  const bar = meter('Evaluation');
  const now = h('div');
  let known = '';
  const load = async () => {
    const items = await api.evaluations(scene.id, signal).catch(() => null);
    if (items && !signal.aborted)
      fill(
          list,
          items.length ?
              items.slice(0, 3).map(
                  (item, i) => evaluation(item, i ? null : worstViews(item.result, look))) :
              h('p', {class: 'quiet'}, 'Not evaluated yet: PSNR and SSIM on the test views.'));
  };
  watch(({jobs}) => {
    const own = jobs.filter((job) => job.type === 'eval' && means(job.scene, scene));
    const active = own.find(isActive);
    const failed = own[0]?.state === 'failed' ? own[0] : null;
    if (active) {
      fill(now, bar.node);
      bar.set(active.progress?.fraction ?? null, progressWords(active));
    } else
      fill(now, failed?.problem ? recordedProblem(failed.problem) : null);
    const key = own.map((job) => `${job.id}${job.state}`).join();
    if (key !== known) {
      known = key;
      load();
    }
  }, signal);
  load();
  const views =
      h('select', {'aria-label': 'Views to evaluate'}, h('option', {value: 8}, '8 views'),
        h('option', {value: 0}, 'all views'));
  const start = action(
      'Evaluate', async () => putJob(await api.submit({
                    type: 'eval',
                    scene: scene.id,
                    options: {split: splitOf(scene), views: Number(views.value)}
                  })),
      {kind: 'small'});
  return panel(
      'Quality',
      {'data-order': 2, tools: may('render') ? h('div', {class: 'row'}, views, start) : null}, now,
      list);
}

const splitOf = (scene) => {
  const views = find(state.datasets, scene.dataset)?.views;
  return !views || views.test ? 'test' : views.val ? 'val' : 'train';
};

const WORST = 3;

/** The views of the newest evaluation that came out worst, to be looked at. */
function worstViews({per_view: views, protocol: {split}}, look) {
  const worst = views.filter((view) => view.scale === 0 && view.psnr !== null)
                    .sort((a, b) => a.psnr - b.psnr)
                    .slice(0, WORST);
  return worst.length ?
      h('p', {class: 'row wrap worst'}, h('span', {class: 'quiet'}, 'Worst views'),
        worst.map(
            ({index, psnr}) =>
                (look ? h('button',
                          {type: 'button', class: 'small', onclick: () => look(split, index)},
                          `${split}:${index} ${decibel(psnr, 1)}`) :
                        h('span', null, `${split}:${index} ${decibel(psnr, 1)}`)))) :
      null;
}

function evaluation({job, finished_at: when, result}, worst) {
  const p = result.protocol;
  return h(
      'div', {class: 'evaluation'},
      h('p', null, h('strong', null, decibel(result.psnr)),
        ` ± ${fixed(result.psnr_spread, 2)} · SSIM ${fixed(result.ssim, 4)} · `,
        h('a', {href: link.job(job)}, `${plural(result.views, 'view')} of ${p.split}`)),
      result.scales.length > 1 ?
          h('p', {class: 'quiet'},
            result.scales.map((s) => `1/${2 ** s.scale}: ${decibel(s.psnr)}`).join(' · ')) :
          null,
      h('p', {class: 'quiet'},
        `step ${whole(p.step)}, ${milliseconds(result.render_ms_median)} a picture, ${ago(when)}`),
      worst);
}

export function aboutPanel(scene) {
  const {config} = scene;
  const file = `${scene.name}.safetensors`;
  const path = `v1/scenes/${encodeURIComponent(scene.id)}/checkpoint`;
  const checkpoint = !scene.checkpoints.length ?
      null :
      token.get() ?
      action('Download checkpoint', async () => saveBlob(await api.download(path), file)) :
      h('a', {class: 'button', href: path, download: file}, 'Download checkpoint');
  return panel(
      'Record', {
        tools:
            h('div', {class: 'row'},
              may('render') ?
                  action(
                      'Report',
                      async () => {
                        saveBlob(await reportOf(scene.id), `${scene.name}-report.html`);
                        toast('The report is saved: one file, which prints.');
                      },
                      {kind: 'small', title: 'One HTML file with pictures, figures and curves'}) :
                  null,
              mayChange(scene) ? h('button', {
                type: 'button',
                class: 'small bare',
                onclick: () => confirmFirst(
                    `Delete the scene ${scene.name} with its checkpoints?`, 'Delete',
                    async () => {
                      await api.removeScene(scene.id);
                      refreshSoon();
                      go(link.home());
                    })
              },
                                   'Delete') :
                                 null)
      },
      facts([
        [
          'Dataset',
          scene.dataset ? h('a', {href: link.dataset(scene.dataset_name)}, scene.dataset_name) :
                          'none here'
        ],
        ['For viewing', viewingOf(scene)],
        [
          'Preset',
          config ? `${config.preset}, seed ${config.seed}, trained on ${config.train_split}` : null
        ],
        [
          'Field',
          config ? `${config.planes} planes (${config.orientation}) of ${config.base}²${
                       config.grow_to > config.base ? `, growing to ${config.grow_to}²` :
                                                      ''}, ${plural(config.channels, 'channel')}, ${
                       plural(config.levels, 'level')}, ${config.footprint}` :
                   null
        ],
        [
          'Networks',
          config ? `width ${config.width}, ${config.base_layers} + ${
                       config.head_layers} layers, shading a ${config.shading}` :
                   null
        ],
        ['PSNR is of', scene.held_out], ['Kernels', scene.kernels],
        [
          'Memory',
          scene.memory_bytes ? `${bytes(scene.memory_bytes)}${scene.loaded ? ', loaded' : ''}` :
                               null
        ],
        [
          'Trained',
          scene.steps ? `${whole(scene.steps)} steps, ${seconds(scene.train_seconds)}` : null
        ],
        [
          'Checkpoints',
          scene.checkpoints.length ?
              scene.checkpoints.slice(0, 4).map(
                  (c) =>
                      h('span', {class: 'line'},
                        `step ${whole(c.step)}, ${bytes(c.size_bytes)}, ${ago(c.created_at)}`)) :
              'none yet'
        ],
        [
          'Parameters',
          scene.parameters_sha256 ? h('code', {title: `SHA-256 ${scene.parameters_sha256}`},
                                      scene.parameters_sha256.slice(0, 16), '…') :
                                    null
        ]
      ]),
      checkpoint ? h('div', {class: 'row'}, checkpoint) : null, exportButtons(scene));
}

/** Of a scene that came as a file: what it is, and what that lost. */
function viewingOf({viewing: v}) {
  if (!v) return null;
  return [
    `${planesOf(v.bits)}; it is not trained further`,
    `${decibel(v.psnr)} on ${plural(v.views, `${v.split} view`)}, ${
        fixed(v.loss, 3)} dB less than the scene that it is of`
  ].map((line) => h('span', {class: 'line'}, line));
}

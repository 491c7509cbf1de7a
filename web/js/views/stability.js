// How sound a scene's numbers are: what training counted, the steps that were not finite with their
// rays, and the doctor, which computes again with higher precision.
import {api} from '../api.js';
import {fill, h} from '../dom.js';
import {isActive, isOver, may, means, putJob, trainingOf, watch} from '../store.js';
import {plural, whole} from '../format.js';
import {action, meter, panel, progressWords, recordedProblem, scroller} from '../ui.js';
import {link} from '../router.js';

/** What training counts, in the order of how much it takes to mend. */
const COUNTERS = [
  [
    'rays', 'Rays left out',
    'Colour or gradient of these was no finite number; the step went on without them.'
  ],
  ['steps_rejected', 'Steps rejected', 'The update was not finite: nothing was changed.'],
  ['rollbacks', 'Rollbacks', 'Training returned to its last good parameters, at half the rate.']
];
const KINDS = {
  rays: 'rays left out',
  rejected: 'step rejected',
  rollback: 'rollback'
};

const counter = (nonfinite) => ([key, title, meaning]) =>
    h('div', {'data-bad': String(nonfinite[key] > 0)},
      h('dt', null, title, h('span', {class: 'note'}, meaning)),
      h('dd', null, whole(nonfinite[key])));

const NUMBERS = new Set(['Pixel', 'Number', 'Bound']);
const headRow = (...names) =>
    h('thead', null,
      h('tr', null,
        names.map(
            (name) => h('th', {scope: 'col', class: NUMBERS.has(name) ? 'number' : null}, name))));

/** A ray that was not finite: its photograph leads to the picture from there. */
const rayRow = (scene) => (ray) =>
    h('tr', null,
      h('th', {scope: 'row'},
        may('render') ? h('a', {href: link.scene(scene.name, `?view=${ray.split}:${ray.index}`)},
                          `${ray.split}:${ray.index}`) :
                        `${ray.split}:${ray.index}`),
      h('td', {class: 'number'}, `${ray.x}, ${ray.y}${ray.scale ? ` at 1/${2 ** ray.scale}` : ''}`),
      h('td', null, ray.fault));

function incidentItem(scene, replay) {
  return ({file, incident}) => {
    const {rays, parameters} = incident;
    return h(
        'li', null,
        h('p', null, h('strong', null, `Step ${whole(incident.step)}: ${KINDS[incident.kind]}`),
          ` · ${plural(incident.nonfinite_rays, 'ray')}, ${
              plural(
                  incident.nonfinite_parameters, 'parameter')} not finite · ${incident.kernels} `,
          may('render') ? action(
                              'Replay', () => replay(file),
                              {kind: 'small', title: 'Computes these rays again'}) :
                          null),
        rays.length ?
            h('details', null,
              h('summary', null,
                `Its rays${
                    rays.length < incident.nonfinite_rays ? `, the first ${rays.length}` : ''}`),
              scroller(
                  `Rays of step ${incident.step}`, {class: 'tall'},
                  h('table', {class: 'table'}, headRow('Photograph', 'Pixel', 'Not finite'),
                    h('tbody', null, rays.map(rayRow(scene)))))) :
            null,
        parameters.length ?
            h('p', {class: 'quiet'}, 'Parameters: ',
              parameters.map(({index, value}) => `${index} (${value})`).join(', ')) :
            null);
  };
}

const figure = (x) => (x === null ? '–' : String(Number(x.toPrecision(3))));
const outcome = (item) => (item.skipped ? 'skipped' : item.passed ? 'holds' : 'fails');

const rank = (item) => (item.skipped ? 2 : item.passed ? 1 : 0);
const failures = (cases) => cases.filter((item) => !rank(item)).length;

/** What a doctor job found, in a few words. @param {any} report its result */
export function doctorWords({cases}) {
  const failed = failures(cases);
  const skipped = cases.filter((item) => item.skipped).length;
  return [
    failed ? `${failed} of ${plural(cases.length, 'bound')} do not hold` :
             `All of ${plural(cases.length - skipped, 'bound')} hold`,
    skipped ? `${skipped} skipped` : ''
  ].filter(Boolean)
      .join(', ');
}

/** The same, and each case, what fails first. @param {any} report its result */
export function doctorReport(report) {
  const cases = [...report.cases].sort((a, b) => rank(a) - rank(b));
  const failed = failures(cases);
  return h(
      'div', {class: 'doctor', 'data-bad': String(failed > 0)},
      h('p', {class: failed ? 'bad' : 'good'}, `${doctorWords(report)}.`),
      h('details', {open: failed > 0}, h('summary', null, 'Each number beside its bound'),
        scroller(
            'Cases of the doctor', {class: 'tall'},
            h('table', {class: 'table'},
              h('caption', null, `Largest errors over random inputs, seed ${report.seed}`),
              headRow('Case', 'Kernels', 'Number', 'Bound', 'Result'),
              h('tbody', null,
                cases.map(
                    (item) =>
                        h('tr', {'data-bad': String(!rank(item))},
                          h('th', {scope: 'row', title: item.where}, item.name),
                          h('td', null, item.kernels || 'all'),
                          h('td', {class: 'number'}, `${figure(item.worst)} ${item.unit}`),
                          h('td', {class: 'number'},
                            item.bound === null ? 'shown only' : figure(item.bound)),
                          h('td', null, outcome(item)))))))));
}

/** The newest examination: under way, or what it found. */
function createDoctor(scene, signal) {
  const bar = meter('Examining');
  const node = h('div', {role: 'status'});
  let shown = '';
  watch(({jobs}) => {
    const job = jobs.find((one) => one.type === 'doctor' && means(one.scene, scene));
    if (!job) return;
    bar.set(null, progressWords(job) || job.state);
    const key = `${job.id} ${job.state}`;
    if (key === shown) return;
    shown = key;
    if (isActive(job))
      fill(node, bar.node);
    else if (job.result)
      fill(node, doctorReport(job.result));
    else
      fill(node, job.problem ? recordedProblem(job.problem) : null);
  }, signal);
  return node;
}

/** @param {any} scene @param {AbortSignal} signal */
export function stabilityPanel(scene, signal) {
  const counters = h('dl', {class: 'counters'});
  const incidents = h('ul', {class: 'plain incidents'});
  const words = h('p', {class: 'quiet'});
  const examine = (options) => async () =>
      putJob(await api.submit({type: 'doctor', scene: scene.id, ...options}));
  const replay = (file) => examine({options: {incident: file}})();
  const button = action('Run the doctor', examine({}), {
    kind: 'small',
    title: 'Some seconds: every kernel set here, and rays of this scene, beside float64'
  });
  let known = '';

  async function load() {
    const {count, items} = await api.incidents(scene.id, signal);
    fill(incidents, items.map(incidentItem(scene, replay)));
    fill(
        words,
        count > items.length ? `The latest ${items.length} of ${plural(count, 'incident')}.` :
            count ? '' :
                    'No step of this training was anything but finite.');
  }

  watch(() => {
    const training = trainingOf(scene);
    const nonfinite = training?.progress?.nonfinite;
    const key = JSON.stringify([nonfinite, training && isOver(training)]);
    if (key === known) return;
    known = key;
    fill(counters, nonfinite ? COUNTERS.map(counter(nonfinite)) : null);
    load().catch(() => {});  // the next change asks again
  }, signal);
  return panel(
      'Stability', {tools: may('render') ? button : null, 'data-order': 3}, counters, incidents,
      words, createDoctor(scene, signal));
}

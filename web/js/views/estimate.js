// What a training will take, before it starts.
import {api} from '../api.js';
import {fill, h} from '../dom.js';
import {bytes, decibel, percent, plural, seconds} from '../format.js';
import {find, isActive, putJob, state, watch} from '../store.js';
import {action, meter, problemBox, progressWords, recordedProblem} from '../ui.js';

/** An estimate in sentences. */
export function estimateWords(e) {
  const known = e.psnr !== null;
  const passed = e.passings.filter((p) => known && p.seconds !== null)
                     .map((p) => `${decibel(p.psnr, 0)} after ${seconds(p.seconds)}`);
  return [
    passed.length ? `${passed.join(', ')}.` : '',
    `Ends after ${seconds(e.seconds)} of training${
        known ? ` at ${decibel(e.psnr, 1)} ± ${e.psnr_spread.toFixed(1)}` : ''}.`,
    `${bytes(e.memory_bytes)} of memory, ${bytes(e.disk_bytes)} on disk.`,
    e.past.estimates ?
        `${plural(e.past.estimates, 'estimate')} here so far: off by ${decibel(e.past.psnr_off, 1)}${
            e.past.seconds_off === null ? '' : ` and ${percent(e.past.seconds_off)} of the time`}.` :
        'No estimate was checked by a training here yet.'
  ].filter(Boolean);
}

/** What an estimate's job shows. */
export const estimateResult = (e) =>
    h('ul', {class: 'estimate'}, estimateWords(e).map((words) => h('li', null, words)));

/**
 * A button and what came of it. @param {any} dataset @param {() => any} options of the training
 * @param {(error: any) => void} refused @returns {{button: HTMLElement, node: HTMLElement}}
 */
export function estimatePanel(dataset, options, refused) {
  const node = h('div', {role: 'status'});
  const bar = meter('Estimating');
  let stop = new AbortController();
  const button = action('Estimate', async () => {
    stop.abort();
    stop = new AbortController();
    fill(node);
    let job;
    try {
      job = putJob(await api.submit({type: 'estimate', dataset: dataset.id, options: options()}));
    } catch (error) {
      refused(error);
      return;
    }
    follow(job.id, stop);
  }, {title: 'Trains for some seconds, keeps nothing, and tells what it would take'});

  function follow(id, own) {
    watch(() => {
      const job = find(state.jobs, id);
      if (!job) return;
      if (isActive(job)) {
        bar.set(job.progress?.fraction ?? null, progressWords(job) || job.state);
        if (!bar.node.isConnected) fill(node, bar.node);
        return;
      }
      own.abort();
      fill(
          node, job.result ? estimateResult(job.result) :
              job.problem  ? recordedProblem(job.problem) :
                             problemBox(new Error(`The estimate ${job.state}`)));
    }, own.signal);
  }
  return {button, node};
}

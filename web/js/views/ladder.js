// A ladder: its arms as they stand, and its report.
import {api, token} from '../api.js';
import {fill, h, saveBlob} from '../dom.js';
import {find, state, watch} from '../store.js';
import {decibel, fixed, milliseconds, plural, seconds} from '../format.js';
import {action, empty, panel, problemBox, scroller} from '../ui.js';

const number = (figure, show) =>
    h('td', {class: 'number'}, figure.count ? show(figure.mean) : '',
      figure.count > 1 ?
          h('span', {class: 'quiet'}, ` ± ${fixed((figure.high - figure.low) / 2, 2)}`) :
          null);

function armRow(arm) {
  return h(
      'tr', null, h('th', {scope: 'row'}, arm.label), number(arm.psnr, decibel),
      number(arm.margin, (value) => fixed(value, 2)), number(arm.ssim, (value) => fixed(value, 4)),
      number(arm.train_seconds, seconds), number(arm.render_ms, milliseconds));
}

function table(report) {
  const {cells} = report.ladder;
  const done = cells.filter((cell) => cell.state === 'done').length;
  const head = ['Arm', 'PSNR', 'Over the first', 'SSIM', 'Training', 'A picture'];
  return scroller(
      'Arms', null,
      h('table', {class: 'table'},
        h('caption', null, `${done} of ${plural(cells.length, 'training')}, means over seeds`),
        h('thead', null,
          h('tr', null,
            head.map((name, i) => h('th', {scope: 'col', class: i ? 'number' : null}, name)))),
        h('tbody', null, report.arms.map(armRow))));
}

/** Where no token is needed the report opens as a page of its own; else it is fetched and saved. */
function reportTools(job) {
  const path = `v1/jobs/${encodeURIComponent(job.id)}/report`;
  const save = (format) => action(
      `Save ${format.toUpperCase()}`,
      async () => saveBlob(await api.download(`${path}?format=${format}`), `${job.id}.${format}`),
      {kind: 'small'});
  const open =
      h('a', {class: 'button small', href: path, target: '_blank', rel: 'noopener'},
        'Open the report');
  return h('div', {class: 'row'}, token.get() ? save('html') : open, save('csv'), save('json'));
}

/** @param {any} job @param {AbortSignal} signal */
export function ladderPanel(job, signal) {
  const box = h('div', {class: 'ladder'});
  let shown = '';
  watch(() => {
    const now = find(state.jobs, job.id) ?? job;
    const key = `${now.state} ${now.progress?.done} ${now.progress?.stage}`;
    if (key === shown) return;
    shown = key;
    api.report(job.id, signal)
        .then((report) => fill(box, table(report), reportTools(job)))
        .catch((error) => {
          if (!signal.aborted)
            fill(box, error.status === 404 ? empty('Nothing is trained yet') : problemBox(error));
        });
  }, signal);
  return panel('Arms', null, box);
}

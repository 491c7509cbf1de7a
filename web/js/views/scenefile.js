// A scene that was exported for viewing, on its way in.
import {api} from '../api.js';
import {fill, h} from '../dom.js';
import {bytes} from '../format.js';
import {putJob, state} from '../store.js';
import {field, meter, nameField, showFaults} from '../ui.js';
import {safeName} from '../folder.js';

export const isSceneFile = (name) => /\.ripscene$/i.test(name);

/**
 * @param {File} file
 * @param {{back: () => void, follow: (job: any) => void, signal: AbortSignal}} host
 */
export function sceneFileForm(file, {back, follow, signal}) {
  const name = nameField(safeName(file.name.replace(/\.ripscene$/i, '')));
  const dataset = field(
      'Photographs', h('select', null, h('option', {value: ''}, 'none'),
                       state.datasets.map((one) => h('option', {value: one.id}, one.name))),
      {hint: 'A dataset here, of the same photographs, that the scene may be compared with'});
  const problem = h('div');
  const progress = h('div');
  const buttons = h('div', {class: 'row end'});
  async function send() {
    const called = name.control.value.trim();
    if (state.scenes.some((one) => one.name === called))
      return name.fault('there is a scene of that name');
    const stop = new AbortController();
    const bar = meter('Upload');
    showFaults([name], problem, null);
    fill(progress, bar.node);
    fill(buttons, h('button', {type: 'button', onclick: () => stop.abort()}, 'Cancel'));
    try {
      const job = await api.sendScene(
          called, dataset.control.value, file,
          (sent) => bar.set(sent / file.size, `sent ${bytes(sent)} of ${bytes(file.size)}`),
          AbortSignal.any([stop.signal, signal]));
      follow(putJob(job));
    } catch (error) {
      fill(progress);
      showFaults([name], problem, error.name === 'AbortError' ? null : error);
      ready();
    }
  }
  const ready = () => fill(
      buttons, h('button', {type: 'button', onclick: back}, 'Back'),
      h('button', {type: 'submit', class: 'primary'}, 'Upload and open'));
  ready();
  return h(
      'form', {
        onsubmit: (event) => {
          event.preventDefault();
          send();
        }
      },
      h('p', null, h('strong', null, 'A scene for viewing'), `, ${bytes(file.size)}`), name.node,
      state.datasets.length ? dataset.node : null, problem, progress, buttons);
}

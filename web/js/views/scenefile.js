// A scene that was exported for viewing, on its way in.
import {api} from '../api.js';
import {h} from '../dom.js';
import {bytes} from '../format.js';
import {putJob, state} from '../store.js';
import {field, nameField} from '../ui.js';
import {safeName} from '../folder.js';
import {sendForm} from './sendform.js';

export const isSceneFile = (name) => /\.ripscene$/i.test(name);

/**
 * @param {File} file
 * @param {{back: () => void, follow: (job: any) => void, signal: AbortSignal}} host
 */
export function sceneFileForm(file, {back, follow, signal}) {
  const name = nameField(safeName(file.name.replace(/\.ripscene$/i, '')));
  const called = () => name.control.value.trim();
  const dataset = field(
      'Photographs', h('select', null, h('option', {value: ''}, 'none'),
                       state.datasets.map((one) => h('option', {value: one.id}, one.name))),
      {hint: 'A dataset here, of the same photographs, that the scene may be compared with'});
  function isReady() {
    const isNew = !state.scenes.some((one) => one.name === called());
    if (!isNew) name.fault('there is a scene of that name');
    return isNew;
  }
  const send = async (bar, stop) => follow(putJob(await api.sendScene(
      called(), dataset.control.value, file,
      (sent) => bar.set(sent / file.size, `sent ${bytes(sent)} of ${bytes(file.size)}`),
      AbortSignal.any([stop, signal]))));
  return sendForm({words: 'Upload and open', fields: [name], back, isReady, send}, [
    h('p', null, h('strong', null, 'A scene for viewing'), `, ${bytes(file.size)}`), name.node,
    state.datasets.length ? dataset.node : null
  ]).node;
}

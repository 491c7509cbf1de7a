// Add a dataset: drop or choose a folder, see what would be sent, send it, watch the import.
import {api, Problem} from '../api.js';
import {entriesOfDrop, entriesOfInput, planUpload, safeName} from '../folder.js';
import {fill, h} from '../dom.js';
import {find, isActive, putJob, state, watch} from '../store.js';
import {bytes, plural} from '../format.js';
import {
  action,
  choice,
  endOf,
  field,
  meter,
  panel,
  problemBox,
  progressWords,
  recordedProblem,
  showFaults
} from '../ui.js';
import {tarOf} from '../tar.js';
import {link} from '../router.js';

/** @param {AbortSignal} signal */
export function uploadPanel(signal) {
  const body = h('div');
  const node = panel('Add a dataset', null, body);
  const begin = (problem) =>
      fill(body, chooser(take), problem ? problemBox(problem) : null, directoryForm(follow));
  async function take(entries) {
    fill(
        body,
        h('p', {class: 'quiet', role: 'status'}, `Reading ${plural(entries.length, 'file')}…`));
    let plan;
    try {
      plan = await planUpload(entries, await api.formats(signal));
    } catch (error) { return begin(error); }
    if (plan.problem)
      begin({title: 'Not a dataset', detail: plan.problem, message: plan.problem});
    else
      fill(body, planForm(plan, {back: () => begin(), follow}));
  }
  function follow(job) { fill(body, importing(job, begin, signal)); }
  dropTarget(node, take, signal);
  begin();
  return node;
}

function chooser(take) {
  const input = h('input', {
    type: 'file',
    id: 'folder-input',
    class: 'unseen',
    webkitdirectory: true,
    multiple: true,
    onchange: () => input.files.length && take(entriesOfInput(input.files))
  });
  return h(
      'div', {class: 'drop'}, h('p', {class: 'drop-title'}, 'Drop a dataset’s folder here'),
      h('p', {class: 'quiet'}, 'photographs and their poses, in any layout that the daemon reads'),
      input, h('label', {class: 'button', 'for': 'folder-input'}, 'Choose a folder'));
}

function dropTarget(node, take, signal) {
  const over = (on) => (event) => {
    event.preventDefault();
    node.classList.toggle('over', on);
  };
  node.addEventListener('dragenter', over(true), {signal});
  node.addEventListener('dragover', over(true), {signal});
  node.addEventListener('dragleave', over(false), {signal});
  node.addEventListener('drop', (event) => {
    over(false)(event);
    entriesOfDrop(event.dataTransfer.items).then(take);
  }, {signal});
}

/** Import options that both ways share. */
function importOptions() {
  const size = field(
      'Longest side', h('input', {type: 'number', min: 8, max: 16384, placeholder: 'as it is'}),
      {unit: 'px', pointer: '/options/max_size'});
  const scales = field(
      'Scales', h('input', {type: 'number', min: 1, max: 8, placeholder: '1'}),
      {pointer: '/options/scales', hint: 'Each half the size of the one before'});
  const alpha = choice(
      'Scaling of alpha', [['premultiplied', 'premultiplied'], ['straight', 'as the benchmark']],
      'premultiplied', {pointer: '/options/alpha'});
  const split = field(
      'Test: every N-th view',
      h('input', {type: 'number', min: 1, max: 100000, placeholder: 'as in the files'}),
      {pointer: '/options/split'});
  const bounds = field(
      'Bounds',
      h('input',
        {type: 'text', placeholder: 'from the dataset', spellcheck: 'false', autocomplete: 'off'}),
      {pointer: '/options/bounds', hint: 'Centre and radius: x,y,z,r'});
  const format = field(
      'Layout', h('select', null, h('option', {value: ''}, 'as recognised')),
      {pointer: '/options/format'});
  api.formats().then(
      (items) => format.control.append(
          ...items.map((item) => h('option', {value: item.name}, item.title))), () => {});
  const masks = field(
      'Masks', h('input', {
        type: 'text',
        placeholder: 'as in the files',
        spellcheck: 'false',
        autocomplete: 'off'
      }),
      {pointer: '/options/masks', hint: 'Folder below the dataset’s; black is left out'});
  const values = () => {
    const options = {};
    if (format.control.value) options.format = format.control.value;
    if (masks.control.value.trim()) options.masks = masks.control.value.trim();

    if (size.control.value) options.max_size = Number(size.control.value);
    if (scales.control.value) options.scales = Number(scales.control.value);
    if (alpha.control.value !== 'premultiplied') options.alpha = alpha.control.value;
    if (split.control.value) options.split = `every:${split.control.value}`;
    if (bounds.control.value.trim()) options.bounds = bounds.control.value.replaceAll(' ', '');
    return options;
  };
  const node = h(
      'details', null, h('summary', null, 'Import options'),
      h('div', {class: 'form-grid'}, size.node, scales.node, split.node, bounds.node,
          format.node, masks.node, alpha.node));
  return {node, values, fields: [size, scales, alpha, split, bounds, format, masks]};
}

const nameField = (value) => field(
    'Name', h('input', {
      type: 'text',
      value,
      required: true,
      maxLength: 64,
      spellcheck: 'false',
      autocomplete: 'off'
    }),
    {pointer: '/name'});

function planForm(plan, {back, follow}) {
  const name = nameField(plan.name);
  const options = importOptions();
  const problem = h('div');
  const progress = h('div');
  const buttons = h('div', {class: 'row end'});
  const splits = Object.entries(plan.views).map(([split, count]) => `${count} ${split}`).join(', ');
  async function send() {
    const stop = new AbortController();
    const bar = meter('Upload');
    const tar = tarOf(plan.entries);
    const started = performance.now();
    showFaults([name, ...options.fields], problem, null);
    fill(progress, bar.node);
    fill(buttons, h('button', {type: 'button', onclick: () => stop.abort()}, 'Cancel'));
    try {
      const job = await api.upload(
          {
            name: name.control.value.trim(),
            ...(plan.poses && {poses: plan.poses}),
            ...options.values()
          },
          tar, (sent) => {
            const rate = sent / Math.max(0.05, (performance.now() - started) / 1000);
            bar.set(
                sent / tar.size,
                sent < tar.size ? `sent ${bytes(sent)} of ${bytes(tar.size)} · ${bytes(rate)}/s` :
                                  'sent; the daemon takes it in');
          }, stop.signal);
      follow(putJob(job));
    } catch (error) {
      fill(progress);
      showFaults([name, ...options.fields], problem, error.name === 'AbortError' ? null : error);
      ready();
    }
  }
  const ready = () => fill(
      buttons, h('button', {type: 'button', onclick: back}, 'Back'),
      h('button', {type: 'submit', class: 'primary'}, 'Upload and import'));
  ready();
  return h(
      'form', {
        onsubmit: (event) => {
          event.preventDefault();
          send();
        }
      },
      h('p', null, h('strong', null, plan.layout), splits && ` · views: ${splits}`),
      plan.poses ?
          h('p', {class: 'quiet'},
            'The daemon looks for the poses with COLMAP, where it is installed. That takes ' +
                'seconds to minutes a photograph.') :
          null,
      h('p', {class: 'quiet'},
        `${plural(plan.entries.length, 'file')}, ${bytes(plan.bytes)} to send`,
        plan.left ? `; ${plural(plan.left, 'file')} that the JSON does not name stay here` : '',
        '.'),
      plan.missing.length ?
          h('div', {class: 'problem warn'},
            h('p', {class: 'problem-title'},
              `${plural(plan.missing.length, 'image')} named but not in the folder`),
            h('ul', null,
              plan.missing.slice(0, 5).map((path) => h('li', null, h('code', null, path))),
              plan.missing.length > 5 ? h('li', null, `and ${plan.missing.length - 5} more`) :
                                        null)) :
          null,
      name.node, options.node, problem, progress, buttons);
}

function directoryForm(follow) {
  const directory = field(
      'Folder on the daemon’s machine',
      h('input', {type: 'text', required: true, spellcheck: 'false', placeholder: '/data/lego'}),
      {pointer: '/directory'});
  const name = nameField('');
  const options = importOptions();
  const problem = h('div');
  const roots = state.info?.roots ?? [];
  directory.control.addEventListener('change', () => {
    name.control.value ||=
        safeName(directory.control.value.split('/').filter(Boolean).at(-1) ?? '');
  });
  async function submit() {
    const values = options.values();
    try {
      const body = {
        name: name.control.value.trim(),
        directory: directory.control.value.trim(),
        ...(Object.keys(values).length ? {options: values} : {})
      };
      follow(putJob(await api.addDirectory(body)));
    } catch (error) {
      showFaults([directory, name, ...options.fields], problem, error);
      if (!(error instanceof Problem)) return;
    }
  }
  return h(
      'details', {class: 'alternative'}, h('summary', null, 'Or a folder on the daemon’s machine'),
      h('form', {
        onsubmit: (event) => {
          event.preventDefault();
          submit();
        }
      },
        h('p', {class: 'quiet'},
          roots.length ?
              [
                'It must lie under ',
                roots.map((root, i) => [i ? ', ' : '', h('code', null, root)]), '.'
              ] :
              [
                'The daemon was started without ', h('code', null, '--dataset-root'),
                ': it reads no folders of its own machine.'
              ]),
        directory.node, name.node, options.node, problem,
        h('div', {class: 'row end'}, h('button', {type: 'submit'}, 'Import'))));
}

/** The import job's progress, then what to do next. */
function importing(job, begin, signal) {
  const box = h('div', {role: 'status'});
  const bar = meter('Import');
  let over = null;
  const cancel = action('Cancel', async () => putJob(await api.act(job.id, 'cancel')));
  watch(() => {
    const now = find(state.jobs, job.id) ?? job;
    if (over === now.state) return;
    if (isActive(now)) {
      bar.set(
          now.progress?.fraction ?? null,
          `${now.state === 'queued' ? 'queued' : 'reading and checking images'} · ${
              progressWords(now)}`);
      if (box.firstChild !== bar.node) fill(box, bar.node, h('div', {class: 'row end'}, cancel));
      return;
    }
    over = now.state;
    const more =
        h('button', {type: 'button', onclick: () => begin()},
          now.state === 'succeeded' ? 'Add another' : 'Choose again');
    const name = now.dataset_name ?? now.dataset;
    if (now.state === 'succeeded')
      fill(
          box, h('p', {class: 'good'}, `${name} is imported.`),
          h('div', {class: 'row'},
            h('a', {class: 'button primary', href: link.dataset(name)}, 'Look at it and train'),
            more));
    else
      fill(
          box,
          now.problem ? recordedProblem(now.problem) : h('p', null, `The import ${endOf(now)}.`),
          h('div', {class: 'row'}, more));
  }, signal);
  return box;
}

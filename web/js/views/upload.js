// Add a dataset: drop or choose a folder or an archive, see what would be sent, send it, watch the
// import. A scene that was exported is taken in here too.
import {api, Problem, Unreachable} from '../api.js';
import {entriesOfArchive, isArchive} from '../archive.js';
import {checkPhotographs} from '../photocheck.js';
import {sendInParts} from '../sending.js';
import {entriesOfDrop, entriesOfInput, planUpload, safeName} from '../folder.js';
import {fill, h, text} from '../dom.js';
import {find, isActive, noteUpload, putJob, refreshSoon, state, watch} from '../store.js';
import {bytes, plural, seconds} from '../format.js';
import {
  action,
  choice,
  confirmFirst,
  endOf,
  field,
  meter,
  nameField,
  panel,
  problemBox,
  progressWords,
  recordedProblem,
  showFaults
} from '../ui.js';
import {tarOf} from '../tar.js';
import {link} from '../router.js';
import {createPreview} from './preview.js';
import {isSceneFile, sceneFileForm} from './scenefile.js';
import {sendForm} from './sendform.js';

/** @param {AbortSignal} signal */
export function uploadPanel(signal) {
  const body = h('div');
  const node = panel('Add a dataset', null, body);
  const begin = (problem) =>
      fill(body, chooser(take), problem ? problemBox(problem) : null, directoryForm(follow));
  async function take(chosen) {
    const alone = chosen.length === 1 ? chosen[0].file : null;
    if (alone && isSceneFile(alone.name))
      return fill(body, sceneFileForm(alone, {back: () => begin(), follow, signal}));
    const words = h('p', {class: 'quiet', role: 'status'});
    const tell = (count) => text(words, `Reading ${plural(count, 'file')}…`);
    tell(chosen.length);
    fill(body, words);
    let plan;
    try {
      const entries =
          alone && isArchive(alone.name) ? await entriesOfArchive(alone, tell) : chosen;
      plan = await planUpload(entries, (await api.formats(signal)).items);
    } catch (error) { return begin(error); }
    if (plan.problem)
      begin({title: 'Not a dataset', detail: plan.problem, message: plan.problem});
    else
      fill(body, planForm(plan, {back: () => begin(), follow, signal}));
  }
  function follow(job, known = 0) { fill(body, importing(job, known, begin, signal)); }
  dropTarget(node, take, signal);
  begin();
  return node;
}

function chooser(take) {
  const choose = (id, words, props) => [
    h('input', {
      type: 'file',
      id,
      class: 'unseen',
      ...props,
      onchange: (event) => event.target.files.length && take(entriesOfInput(event.target.files))
    }),
    h('label', {class: 'button', 'for': id}, words)
  ];
  return h(
      'div', {class: 'drop'}, h('p', {class: 'drop-title'}, 'Drop a dataset’s folder here'),
      h('p', {class: 'quiet'},
        'Photographs with their cameras, from COLMAP, nerfstudio, Blender and others; ' +
            'photographs or a film alone, where the daemon has COLMAP; an archive of these; a .ripscene. ',
        h('a', {href: 'web/guide/index.html#datasets'}, 'What is read')),
      h('div', {class: 'row wrap'},
        choose('folder-input', 'Choose a folder', {webkitdirectory: true, multiple: true}),
        choose('file-input', 'Choose files',
               {multiple: true, accept: 'image/*,.zip,.tar,.tgz,.gz,.ripscene,video/*'})));
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
      'premultiplied', {
        pointer: '/options/alpha',
        hint: 'How transparent edges are averaged; the published benchmark’s are darker'
      });
  const split = field(
      'Test: every N-th view',
      h('input', {type: 'number', min: 1, max: 100000, placeholder: 'as in the files'}),
      {pointer: '/options/split'});
  const bounds = field(
      'Bounds',
      h('input',
        {type: 'text', placeholder: 'from the dataset', spellcheck: 'false', autocomplete: 'off'}),
      {pointer: '/options/bounds', hint: 'Centre and radius: x,y,z,r'});
  const up = field(
      'Up', h('input', {
        type: 'text',
        placeholder: 'by the cameras or GPS',
        spellcheck: 'false',
        autocomplete: 'off'
      }),
      {pointer: '/options/up', hint: 'A direction x,y,z or an axis: z, -y'});
  const crop = field(
      'Crop',
      h('input', {type: 'text', placeholder: 'none', spellcheck: 'false', autocomplete: 'off'}),
      {pointer: '/options/crop', hint: 'Corners of the box that matters: x,y,z,x,y,z'});
  const format = field(
      'Layout', h('select', null, h('option', {value: ''}, 'as recognised')),
      {pointer: '/options/format'});
  api.formats().then(
      ({items}) => format.control.append(
          ...items.map((item) => h('option', {value: item.name}, item.title))), () => {});
  const masks = field(
      'Masks', h('input', {
        type: 'text',
        placeholder: 'as in the files',
        spellcheck: 'false',
        autocomplete: 'off'
      }),
      {pointer: '/options/masks', hint: 'Folder below the dataset’s; black is left out'});
  const backdrop = choice(
      'Backdrop', [['cut', 'cut off'], ['keep', 'a part of the scene']], 'cut', {
        pointer: '/options/backdrop',
        hint: 'One colour that all photographs stand on'
      });
  const values = () => {
    const options = {};
    if (format.control.value) options.format = format.control.value;
    if (masks.control.value.trim()) options.masks = masks.control.value.trim();

    if (size.control.value) options.max_size = Number(size.control.value);
    if (scales.control.value) options.scales = Number(scales.control.value);
    if (backdrop.control.value !== 'cut') options.backdrop = backdrop.control.value;
    if (alpha.control.value !== 'premultiplied') options.alpha = alpha.control.value;
    if (split.control.value) options.split = `every:${split.control.value}`;
    for (const [name, {control}] of Object.entries({bounds, up, crop})) {
      if (control.value.trim()) options[name] = control.value.replaceAll(' ', '');
    }
    return options;
  };
  const node = h(
      'details', null, h('summary', null, 'Import options'),
      h('div', {class: 'form-grid'}, size.node, scales.node, split.node, bounds.node,
          up.node, crop.node, format.node, masks.node, alpha.node,
          backdrop.node));
  /** What a row of the report's choices says; told as a change by hand is. */
  const take = (choice) => {
    size.control.value = choice.max_size ?? '';
    scales.control.value = choice.scales ?? '';
    split.control.value = choice.split?.split(':')[1] ?? '';
    node.dispatchEvent(new Event('change'));
  };
  return {node, values, take, fields: [size, scales, alpha, split, bounds, up, crop, format, masks, backdrop]};
}

const REFUSED = 'An import would be refused for what is told of the dataset here. It can be sent with ' +
    'other options, or chosen again once it is mended.';

function planForm(plan, {back, follow, signal}) {
  const name = nameField(plan.name);
  const options = importOptions();
  const splits = Object.entries(plan.views).map(([split, count]) => `${count} ${split}`).join(', ');
  const bad = badList(plan, signal);
  const looking = new AbortController();
  const stopLooking = () => looking.abort();
  signal.addEventListener('abort', stopLooking, {once: true});
  const preview = createPreview(
      plan, {
        ...options,
        looks: bad.looks,
        onFault: (error) => form.showFault(error),
        onRefused: (isRefused) => form.refuse(isRefused ? REFUSED : '')
      },
      looking.signal);
  async function send(bar, stop, cancel) {
    const entries = plan.entries.filter(({path}) => !bad.leftOut().has(path));
    const tar = tarOf(entries);
    const dataset = name.control.value.trim();
    const settings = {...(plan.poses && {poses: plan.poses}), ...options.values()};
    const note = (sent) => noteUpload(dataset, {share: sent / tar.size, signal, cancel});
    let show = rateWords(tar.size);
    note(0);
    try {
      const job = await sendInParts(tar, dataset, {
        onProgress: (sent) => {
          note(sent);
          bar.set(sent / tar.size, show(sent));
        },
        onWait: (error) => {
          show = rateWords(tar.size);
          bar.set(null, waitWords(error));
        },
        take: (upload) => api.addUpload(
            {
              name: dataset,
              upload,
              ...(Object.keys(settings).length ? {options: settings} : {})
            },
            stop),
        signal: stop
      });
      follow(putJob(job), plan.missing.length);
      stopLooking();
    } finally {
      noteUpload(dataset, null);
    }
  }
  const leave = () => {
    stopLooking();
    back();
  };
  const form = sendForm(
      {words: 'Upload and import', fields: [name, ...options.fields], back: leave, send}, [
        h('p', null, h('strong', null, plan.layout), splits && ` · views: ${splits}`),
        plan.poses ?
            h('p', {class: 'quiet'},
              'The daemon looks for the poses with COLMAP, where it is installed. That takes ' +
                  'seconds to minutes a photograph.') :
            null,
        h('p', {class: 'quiet'},
          `${plural(plan.entries.length, 'file')}, ${bytes(plan.bytes)} to send`,
          plan.left ? `; ${plural(plan.left, 'file')} that the dataset does not need stay here` : '',
          '.'),
        plan.missing.length ?
            h('div', {class: 'problem warn'},
              h('p', {class: 'problem-title'},
                `${plural(plan.missing.length, 'image')} named but not in the folder`),
              h('ul', null,
                plan.missing.slice(0, 5).map((path) => h('li', null, h('code', null, path))),
                plan.missing.length > 5 ? h('li', null, `and ${plan.missing.length - 5} more`) :
                                          null),
              h('p', null, 'The dataset is made without them.')) :
            null,
        bad.node, name.node, options.node
      ],
      preview.node);
  return form.node;
}

/** What of a failure that passes is told while it is waited for. */
const waitWords = (error) => error instanceof Unreachable ?
    'The connection is lost. It goes on where it was, once the daemon answers.' :
    `${error.message}. It goes on where it was, by itself.`;

/** "sent 3 MB of 9 MB · 2 MB/s, 3 s left": the rate since sending began, or went on. */
function rateWords(size) {
  const started = performance.now();
  let first = null;
  return (sent) => {
    first ??= sent;
    const rate = (sent - first) / Math.max(0.05, (performance.now() - started) / 1000);
    if (sent >= size) return 'sent; the daemon takes it in';
    const told = rate ? ` · ${bytes(rate)}/s, ${seconds(Math.ceil((size - sent) / rate))} left` : '';
    return `sent ${bytes(sent)} of ${bytes(size)}${told}`;
  };
}

/** Photographs that cannot be read, as they are found; which of them to leave out is asked. */
function badList({entries}, signal) {
  const items = h('ul', {class: 'plain'});
  const title = h('p', {class: 'problem-title'});
  const found = h('div', {class: 'problem warn', role: 'status', hidden: true}, title, items,
                  h('p', null, 'What is ticked is left out. Untick what the daemon shall look at.'));
  const checking = h('p', {class: 'quiet'});
  const boxes = new Map();
  const looks = checkPhotographs(entries, {
    onBad: (path, why) => {
      const id = `bad-${boxes.size}`;
      const box = h('input', {type: 'checkbox', id, checked: true});
      boxes.set(path, box);
      items.append(h('li', null, box, ' ',
                     h('label', {'for': id}, h('code', null, path), ` ${why}`)));
      text(title, `${plural(boxes.size, 'photograph')} cannot be read`);
      found.hidden = false;
    },
    onProgress: (done, total) =>
        text(checking, `${done < total ? `${done} of ` : ''}${plural(total, 'photograph')} looked at`),
    signal
  });
  return {
    node: h('div', null, checking, found),
    looks,
    leftOut: () => new Set([...boxes].filter(([, box]) => box.checked).map(([path]) => path))
  };
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

/** Whether to keep a dataset that more photographs had to be left out of than was known. */
async function askAboutLost(name, known, begin) {
  const {report} = await api.dataset(name);
  const lost = Object.values(report.unusable).reduce((sum, count) => sum + count, 0);
  if (lost <= known) return;
  const faults = report.problems.filter((item) => item.severity === 'error')
                     .slice(0, 3)
                     .map((item) => `${item.where}: ${item.text}`);
  confirmFirst(
      `${plural(lost, 'photograph')} cannot be used and ${
          lost === 1 ? 'was' : 'were'} left out of ${name}. ${faults.join(' · ')}`,
      'Delete it', async () => {
        await api.removeDataset(name);
        refreshSoon();
        begin();
      });
}

/** The import job's progress, then what to do next; `known`: photographs that are known to be missing. */
function importing(job, known, begin, signal) {
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
    const name = now.scene_name ?? now.dataset_name ?? now.dataset;
    const [next, where] = now.scene_name ? ['Look at it', link.scene(name)] :
                                           ['Look at it and train', link.dataset(name)];
    if (now.state === 'succeeded' && !now.scene_name)
      askAboutLost(name, known, begin).catch(() => {});  // it is kept, then
    if (now.state === 'succeeded')
      fill(
          box, h('p', {class: 'good'}, `${name} is imported.`),
          h('div', {class: 'row'}, h('a', {class: 'button primary', href: where}, next), more));
    else
      fill(
          box,
          now.problem ? recordedProblem(now.problem) : h('p', null, `The import ${endOf(now)}.`),
          h('div', {class: 'row'}, more));
  }, signal);
  return box;
}

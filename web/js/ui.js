// Parts that several views share: state chips, problems, meters, fields, buttons, announcements.
import {fill, h, text} from './dom.js';
import {Unreachable} from './api.js';
import * as format from './format.js';
import {state, watch} from './store.js';

let serial = 0;
const freshId = (word) => `${word}-${++serial}`;

/** A record's state as a word with a mark; colour is never the only sign. */
export function chip(state) {
  const node = h('span', {class: 'chip'}, state);
  setChip(node, state);
  return node;
}
export function setChip(node, state) {
  node.dataset.state = state;
  text(node, state);
}

/** A problem's title, detail and every field it points at. @param {Error} error */
export function problemBox(error, {again} = {}) {
  const told = error.detail ?? '';
  const places = (e) => told.includes(e.pointer) || e.detail?.startsWith('#/');  // within a file
  const faults = (error.errors ?? []).filter((e) => !places(e) || !told.includes(e.detail));
  const node = h(
      'div', {class: 'problem', role: 'alert'},
      h('p', {class: 'problem-title'}, error.title ?? 'That did not work'),
      h('p', null, error.detail || (error.title === error.message ? null : error.message)),
      faults.length ?
          h('ul', null,
            faults.map((e) => h('li', null, h('code', null, e.pointer), ' ', e.detail))) :
          null,
      again ? h('button', {type: 'button', onclick: again}, 'Try again') : null);
  if (error instanceof Unreachable) onReturn(node, again ?? (() => node.remove()));
  return node;
}

/** Calls `again` when the daemon, which was away, is back, if `node` is still to be seen then. */
function onReturn(node, again) {
  const stop = new AbortController();
  let away = state.connection.status !== 'online';
  watch(({connection}) => {
    away ||= connection.status === 'offline';
    if (!away || connection.status !== 'online') return;
    stop.abort();
    if (node.isConnected) again();
  }, stop.signal);
}

/** The problem that a record carries. */
export const recordedProblem = (problem) => problemBox(
    {title: problem.title, detail: problem.detail, errors: problem.errors ?? [], message: ''});

/** A rendering that takes longer is preceded by a photograph. */
export const STANDS_IN_MS = 400;

/** A progress bar with its own words below. `set(fraction|null, words)` */
export function meter(label) {
  const bar = h('progress', {max: 1, 'aria-label': label});
  const words = h('span', {class: 'meter-words'});
  const node = h('div', {class: 'meter'}, bar, words);
  const set = (fraction, description) => {
    if (typeof fraction === 'number')
      bar.value = fraction;
    else
      bar.removeAttribute('value');
    text(words, description);
  };
  return {node, set};
}

/** A labelled control; `pointer` is where the daemon's errors name it ("/options/planes"). */
export function field(label, control, {hint, pointer, unit} = {}) {
  const id = control.id || freshId('field');
  control.id = id;
  const note = h('span', {class: 'note', id: `${id}-note`}, hint ?? '');
  control.setAttribute('aria-describedby', note.id);
  const node =
      h('div', {class: 'field'}, h('label', {'for': id}, label),
        unit ? h('span', {class: 'with-unit'}, control, h('span', {class: 'unit'}, unit)) : control,
        note);
  return {node, control, pointer, fault: (why) => setFault(node, control, note, why, hint)};
}

/** What something new shall be called. */
export const nameField = (value) => field(
    'Name', h('input', {
      type: 'text',
      value,
      required: true,
      maxLength: 64,
      spellcheck: 'false',
      autocomplete: 'off'
    }),
    {pointer: '/name'});

/** One of a few: radio buttons that look like one control. */
export function choice(label, options, value, {pointer, hint} = {}) {
  const name = freshId('choice');
  const note = h('span', {class: 'note'}, hint ?? '');
  const inputs = options.map(
      ([key]) =>
          h('input',
            {type: 'radio', name, value: key, checked: key === value, id: `${name}-${key}`}));
  const node =
      h('fieldset', {class: 'field choice'}, h('legend', null, label),
        h('div', {class: 'segments'},
          options.map(
              ([key, words, title], i) =>
                  [inputs[i], h('label', {'for': `${name}-${key}`, title}, words)])),
        note);
  const control = {
    get value() { return inputs.find((input) => input.checked)?.value ?? ''; },
    set value(key) {
      for (const input of inputs) input.checked = input.value === key;
    },
    onChange: (listener) => node.addEventListener('change', listener),
  };
  return {node, control, pointer, fault: (why) => setFault(node, null, note, why, hint)};
}

function setFault(node, control, note, why, hint) {
  node.classList.toggle('faulty', Boolean(why));
  if (control?.setAttribute) control.setAttribute('aria-invalid', String(Boolean(why)));
  text(note, why ?? hint ?? '');
  const folded = why && node.closest('details');
  if (folded) folded.open = true;
}

const plainPointer = (pointer) => pointer.replace(/^#/, '');

/** Marks the fields that a problem points at; what points elsewhere stays in the box. */
export function showFaults(fields, box, error) {
  const rest = [];
  for (const item of fields) item.fault(null);
  for (const fault of error?.errors ?? []) {
    const hit =
        fields.find((item) => item.pointer && plainPointer(fault.pointer).startsWith(item.pointer));
    if (hit)
      hit.fault(fault.detail);
    else
      rest.push(fault);
  }
  const all = error && rest.length < (error.errors?.length ?? 0) ?
      Object.assign(
          Object.create(error), {errors: rest, title: error.title, detail: error.detail}) :
      error;
  fill(box, all ? problemBox(all) : null);
}

/** That the daemon was away is the banner's to say; of what a button asked for, its name is told. */
const unanswered = (button, error) => error instanceof Unreachable ?
    Object.assign(new Error('The daemon is away; once it is back, try it again if it was not done.'), {
      title: `“${button.getAttribute('aria-label') ?? button.textContent}” had no answer.`
    }) :
    error;

/** A button that works on something: disabled meanwhile, its failure told. */
export function action(label, work, {kind = '', title, onError = toast} = {}) {
  const node =
      h('button', {
        type: 'button',
        class: kind,
        title,
        onclick: async () => {
          if (node.getAttribute('aria-disabled') === 'true') return;
          node.setAttribute('aria-disabled', 'true');
          try {
            await work();
          } catch (error) {
            if (error.name !== 'AbortError') onError(onError === toast ? unanswered(node, error) : error);
          } finally { node.removeAttribute('aria-disabled'); }
        }
      },
        label);
  return node;
}

/** Asks first: `verb` does it, `leave` does nothing. */
export function confirmFirst(question, verb, work, {leave = 'Keep', kind = 'danger'} = {}) {
  const dialog = h('dialog', {class: 'dialog', 'aria-label': question});
  const close = () => {
    dialog.close();
    dialog.remove();
  };
  const box = h('div');
  fill(
      dialog, h('p', null, question), box,
      h('div', {class: 'row end'},
        h('button', {type: 'button', onclick: close, autofocus: true}, leave),
        action(verb, async () => {
          await work();
          close();
        }, {kind, onError: (error) => fill(box, problemBox(error))})));
  document.body.append(dialog);
  dialog.addEventListener('cancel', () => dialog.remove());
  dialog.showModal();
}

/**
 * Copies words, and says so. A browser has no clipboard for a page that came over plain HTTP from
 * another machine: there the words are shown, chosen, to be copied by hand.
 */
export async function copyWords(words, said) {
  try {
    await navigator.clipboard.writeText(words);
  } catch {
    return showWords(words, said);
  }
  toast(said.copied);
}

function showWords(words, said) {
  const shown = h('input', {type: 'text', readOnly: true, value: words, 'aria-label': said.what});
  const dialog = h(
      'dialog', {class: 'dialog', 'aria-label': said.what, onclose: () => dialog.remove()},
      h('h2', null, said.what), h('p', null, 'Copy it from here: this page may not use the clipboard.'),
      shown, said.more ? h('p', {class: 'quiet'}, said.more) : null,
      h('div', {class: 'row end'},
        h('button', {type: 'button', onclick: () => dialog.close()}, 'Close')));
  document.body.append(dialog);
  dialog.showModal();
  shown.select();
}

/** Says something to a screen reader without moving the focus. */
export function announce(words) { text(document.getElementById('announcer'), words); }

/** A message that goes away by itself; errors stay longer. */
export function toast(error) {
  const box = document.getElementById('toasts');
  if (error instanceof Unreachable) return;  // the banner says it
  const node =
      h('div', {class: error instanceof Error ? 'toast bad' : 'toast', role: 'status'},
        error instanceof Error ?
            [h('strong', null, error.title ?? 'Error'), ' ', error.detail || error.message] :
            String(error),
        h('button',
          {type: 'button', class: 'bare', 'aria-label': 'Dismiss', onclick: () => node.remove()},
          '×'));
  box.append(node);
  setTimeout(() => node.remove(), error instanceof Error ? 12_000 : 5_000);
}

/** Terms and values, dense. @param {[string, any][]} pairs */
export const facts = (pairs) =>
    h('dl', {class: 'facts'},
      pairs.filter(([, value]) => value !== undefined && value !== null)
          .map(([term, value]) => h('div', null, h('dt', null, term), h('dd', null, value))));

/** What a token of a scope may, of one that may not all. */
export const SCOPE_MEANS = {
  read: 'It sees what there is and starts nothing, not even a picture.',
  render: 'It renders pictures, paths and evaluations; it imports and trains nothing.',
  train: 'It changes only what it made itself.'
};

/** How a job that is over ended, in a sentence: "was cancelled". */
export const endOf = (job) => (job.state === 'failed' ? 'has failed' : `was ${job.state}`);

/** A section with a heading; `tools` stand at its right. */
export function panel(title, props, ...children) {
  const {tools = null, ...rest} = props ?? {};
  return h(
      'section', {class: 'panel', 'aria-label': title, ...rest},
      h('header', null, h('h2', null, title), tools), ...children);
}

/**
 * A box that scrolls when its content is wide or tall: with a name and reachable by the keyboard. No
 * landmark: the panel that it stands in is one.
 */
export const scroller = (label, props, ...children) =>
    h('div', {
      role: 'group',
      tabindex: 0,
      'aria-label': label,
      ...props,
      class: `scroll ${props?.class ?? ''}`
    },
      ...children);

export const empty = (title, ...more) =>
    h('div', {class: 'empty'}, h('p', {class: 'empty-title'}, title), ...more);
export const skeleton = (lines = 3) =>
    h('div', {class: 'skeleton', 'aria-hidden': 'true'},
      Array.from({length: lines}, () => h('span')));

const VERBS = {
  train: 'Training',
  path: 'Camera path',
  eval: 'Evaluation',
  ingest: 'Import',
  curve: 'Curve',
  estimate: 'Estimate',
  effects: 'Effects',
  export: 'Export',
  ladder: 'Ladder',
  doctor: 'Doctor',
  validate: 'Validation',
  poses: 'Poses'
};
export const kindOf = (job) => VERBS[job.type] ?? job.type;
export const subjectOf = (job) =>
    job.scene_name ?? job.scene ?? job.dataset_name ?? job.dataset ?? '';

function waiting(job) {
  const ahead = state.jobs.find((one) => one.id !== job.id && one.state === 'running');
  return `waiting for its turn${ahead ? `: ${kindOf(ahead)} ${subjectOf(ahead)} is running` : ''}`;
}

/** A job's progress in a few words. */
export function progressWords(job) {
  const p = job.progress;
  if (!p) return job.state === 'queued' ? waiting(job) : '';
  const left =
      job.state === 'running' && p.eta_seconds > 0.5 ? `${format.seconds(p.eta_seconds)} left` : '';
  if (job.type !== 'train')
    return [
      p.stage ?? '',
      p.total ? `${format.whole(p.done)} of ${format.whole(p.total)}` :
          p.done ? `${format.whole(p.done)} done` :
                   '',
      left
    ].filter(Boolean)
        .join(' · ');
  if (p.stage) return `${p.stage} · ${format.seconds(p.load_seconds)}`;
  if (p.evaluating_first) return `last evaluation after ${format.seconds(p.train_seconds)}`;
  if (p.evaluating) return `evaluating after ${format.seconds(p.train_seconds)}`;
  return [
    `step ${format.whole(p.step)}`,
    p.max_seconds ? `${format.seconds(p.train_seconds)} of ${format.seconds(p.max_seconds)}` :
                    format.seconds(p.train_seconds),
    p.psnr ? format.decibel(p.psnr) : '', left
  ].filter(Boolean)
      .join(' · ');
}

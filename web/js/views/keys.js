// The camera path: recorded keys as a strip, its options, preview, saving and submitting.
import {api} from '../api.js';
import {
  addKey,
  cameraAt,
  changeKey,
  documentOf,
  duration,
  emptyPath,
  frameCount,
  moveKey,
  pathOfDocument,
  problemOf,
  removeKey,
  turnTable
} from '../path.js';
import {fill, follow, h, saveBlob, showBlob, text} from '../dom.js';
import {plural, seconds} from '../format.js';
import {action, announce, choice, empty, field, panel, showFaults, toast} from '../ui.js';
import {go, link} from '../router.js';
import {putJob} from '../store.js';

/**
 * @param {any} scene @param {{width: number, height: number}} size of a frame at first
 * @param {ReturnType<import('./viewport.js').createViewport>} view @param {AbortSignal} signal
 */
export function createKeys(scene, size, view, signal) {
  const storeKey = `ripnerf-path-${scene.id}`;
  let path = restore(storeKey) ?? emptyPath(size.width, size.height);
  let playing = null;

  const strip = h('ol', {class: 'keys'});
  const box = h('div');
  const words = h('p', {class: 'quiet', role: 'status'});
  const problem = h('div');
  const form = optionsForm(path, (values) => set({...path, ...values}));
  const play = h(
      'button', {type: 'button', onclick: () => (playing ? stopPreview() : preview())}, 'Preview');
  const submit = action(
      'Render the path', send,
      {kind: 'primary', onError: (error) => showFaults(form.fields, problem, error)});

  function set(next) {
    path = next;
    sessionStorage.setItem(
        storeKey,
        JSON.stringify({...path, keys: path.keys.map((key) => ({...key, picture: undefined}))}));
    show();
  }

  function show() {
    if (path.keys.length) {
      if (box.firstChild !== strip) fill(box, strip);
      follow(strip, path.keys, (key) => key.id, createRow);
    } else
      fill(
          box,
          empty(
              'No keys yet',
              h('p', null, 'Turn the scene to where the path begins and press ',
                h('strong', null, 'Record key'), '. Or take a whole turn around it.')));
    const fault = problemOf(path);
    const many = path.keys.length > 1;
    text(words, path.keys.length ? fault ?? describe() : '');
    words.classList.toggle('bad', Boolean(path.keys.length && fault));
    submit.disabled = Boolean(fault);
    play.disabled = Boolean(fault) || !many;
  }

  /** Keys, duration, frames, and how long they will take by the pictures shown last. */
  function describe() {
    const frames = frameCount(path);
    const cost = view.msPerPixel() * frames * path.width * path.height / 1000;
    return [
      plural(path.keys.length, 'key'), seconds(duration(path)),
      `${plural(frames, 'frame')} of ${path.width} × ${path.height}`,
      cost ? `about ${seconds(Math.max(1, Math.round(cost)))} to render` : ''
    ].filter(Boolean)
        .join(' · ');
  }

  const createRow = (key) => keyRow(key, {
    change: (id, values) => {
      set(changeKey(path, id, values));
      pictures();
    },
    remove: (id) => set(removeKey(path, id)),
    move: (id, by) => set(moveKey(path, id, path.keys.findIndex((item) => item.id === id) + by)),
    place: (id, target) =>
        set(moveKey(path, id, path.keys.findIndex((item) => item.id === target))),
    show: (id) => {
      const item = path.keys.find((other) => other.id === id);
      view.show(item.pose, item.fovDeg);
    },
    order: (id) => ({index: path.keys.findIndex((item) => item.id === id), count: path.keys.length})
  });

  async function picture(id) {
    const key = path.keys.find((item) => item.id === id);
    if (!key || key.picture) return;
    try {
      const blob = await view.thumbnail(key.pose, key.fovDeg, signal);
      path = changeKey(path, id, {picture: blob});
      show();
    } catch { /* the key stands without its picture */
    }
  }

  async function pictures() {
    for (const key of path.keys)
      if (!key.picture && !signal.aborted) await picture(key.id);
  }

  function record() {
    set(addKey(path, view.pose(), view.orbit.fovDeg));
    announce(`Key ${path.keys.length} recorded`);
    pictures();
  }

  function stopPreview() {
    cancelAnimationFrame(playing);
    playing = null;
    text(play, 'Preview');
  }

  function preview() {
    const began = performance.now();
    text(play, 'Stop');
    const tick = () => {
      const time = (performance.now() - began) / 1000;
      if (signal.aborted || time > duration(path)) {
        stopPreview();
        return;
      }
      const {pose, fovDeg} = cameraAt(path, time);
      view.show(pose, fovDeg);
      playing = requestAnimationFrame(tick);
    };
    playing = requestAnimationFrame(tick);
  }

  async function send() {
    showFaults(form.fields, problem, null);
    const options = form.output() === 'rgb' ? {} : {options: {output: form.output()}};
    go(link.job(
        putJob(await api.submit(
                   {type: 'path', scene: scene.id, camera_path: documentOf(path), ...options}))
            .id));
  }

  const adopt = (document) => {
    set(pathOfDocument(document));
    form.show(path);
    pictures();
  };
  const turn = () => {
    set(turnTable(path, view.orbit, 8, 6));
    form.show(path);
    pictures();
  };
  show();
  pictures();
  signal.addEventListener('abort', stopPreview, {once: true});
  const node = panel(
      'Camera path', {
        'data-order': 1,
        tools:
            h('div', {class: 'row'},
              h('button', {type: 'button', class: 'small', onclick: turn}, 'Whole turn'),
              h('button', {
                type: 'button',
                class: 'small bare',
                onclick: () => {
                  set({...path, keys: []});
                }
              },
                'Clear'))
      },
      box, words, form.node, problem,
      h('div', {class: 'row'}, play, submit, saving(() => path, adopt, signal)));
  return {node, record};
}

function restore(storeKey) {
  try {
    return JSON.parse(sessionStorage.getItem(storeKey));
  } catch { return null; }
}

function keyRow(first, host) {
  const {id} = first;
  const image = h('img', {alt: '', draggable: 'false', hidden: true});
  const number = h('span', {class: 'key-number'});
  const time = h('input', {
    type: 'number',
    min: 0,
    step: 0.1,
    'aria-label': 'Time, seconds',
    onchange: () => host.change(id, {time: Number(time.value)})
  });
  const fov = h('input', {
    type: 'number',
    min: 1,
    max: 170,
    step: 0.5,
    'aria-label': 'Field of view, degrees',
    onchange: () => host.change(id, {fovDeg: Number(fov.value), picture: undefined})
  });
  const left =
      h('button', {
        type: 'button',
        class: 'small bare',
        'aria-label': 'Earlier',
        title: 'Earlier',
        onclick: () => host.move(id, -1)
      },
        '←');
  const right =
      h('button', {
        type: 'button',
        class: 'small bare',
        'aria-label': 'Later',
        title: 'Later',
        onclick: () => host.move(id, 1)
      },
        '→');
  const node =
      h('li', {class: 'key', draggable: 'true'},
        h('button', {
          type: 'button',
          class: 'key-picture',
          onclick: () => host.show(id),
          title: 'Go to this key'
        },
          image, number),
        h('div', {class: 'key-fields'}, h('label', null, time, 's'), h('label', null, fov, '°')),
        h('div', {class: 'row'}, left, right,
          h('button', {
            type: 'button',
            class: 'small bare',
            'aria-label': 'Delete key',
            title: 'Delete',
            onclick: () => host.remove(id)
          },
            '×')));
  const gone = new AbortController();
  let shown = null;
  node.addEventListener(
      'dragstart', (event) => event.dataTransfer.setData('text/x-ripnerf-key', id));
  node.addEventListener('dragover', (event) => {
    if (event.dataTransfer.types.includes('text/x-ripnerf-key')) event.preventDefault();
  });
  node.addEventListener('drop', (event) => {
    const moved = event.dataTransfer.getData('text/x-ripnerf-key');
    if (moved) {
      event.preventDefault();
      host.place(moved, id);
    }
  });
  const update = (key) => {
    const {index, count} = host.order(id);
    text(number, index + 1);
    if (document.activeElement !== time) time.value = Number(key.time.toFixed(3));
    if (document.activeElement !== fov) fov.value = Number(key.fovDeg.toFixed(2));
    left.disabled = index === 0;
    right.disabled = index === count - 1;
    if (key.picture && key.picture !== shown) {
      shown = key.picture;
      image.hidden = false;
      showBlob(image, shown, gone.signal);
    }
  };
  return {node, update, remove: () => gone.abort()};
}

/** Frames per second, size, interpolation, loop, output. */
function optionsForm(path, change) {
  const number = (label, key, props, unit, pointer) => {
    const item = field(
        label,
        h('input',
          {type: 'number', ...props, oninput: () => change({[key]: Number(item.control.value)})}),
        {unit, pointer});
    return item;
  };
  const width = number('Width', 'width', {min: 1, max: 16384}, 'px', '/camera_path/width');
  const height = number('Height', 'height', {min: 1, max: 16384}, 'px', '/camera_path/height');
  const fps = number('Frames', 'fps', {min: 1, max: 1000, step: 'any'}, '/s', '/camera_path/fps');
  const interpolation = choice(
      'Between keys', [['spline', 'smooth'], ['linear', 'straight']], path.interpolation,
      {pointer: '/camera_path/interpolation'});
  const loop =
      h('input', {type: 'checkbox', id: 'path-loop', onchange: () => change({loop: loop.checked})});
  const output = choice(
      'Output', [['rgb', 'colour'], ['depth', 'depth'], ['alpha', 'opacity']], 'rgb',
      {pointer: '/options/output'});
  interpolation.control.onChange(() => change({interpolation: interpolation.control.value}));
  const show = (now) => {
    for (const [item, key] of [[width, 'width'], [height, 'height'], [fps, 'fps']])
      item.control.value = now[key];
    loop.checked = now.loop;
    interpolation.node.querySelector(`input[value=${now.interpolation}]`).checked = true;
  };
  show(path);
  return {
    fields: [width, height, fps, interpolation, output],
    output: () => output.control.value,
    show,
    node:
        h('div', {class: 'path-options'}, width.node, height.node, fps.node, interpolation.node,
          output.node,
          h('div', {class: 'field check'}, loop, h('label', {'for': 'path-loop'}, 'Loop')))
  };
}

/** Keeping paths at the daemon and in files. */
function saving(get, adopt, signal) {
  const list = h('select', {id: 'saved-paths'});
  const name =
      h('input',
        {type: 'text', id: 'path-name', maxLength: 64, placeholder: 'name', spellcheck: 'false'});
  const file = h('input', {
    type: 'file',
    accept: '.json,application/json',
    class: 'unseen',
    id: 'path-file',
    onchange: async () => {
      try {
        adopt(JSON.parse(await file.files[0].text()).path);
      } catch (error) {
        toast(Object.assign(
            new Error(`${file.files[0].name}: ${error.message}`), {title: 'Not a path file'}));
      }
      file.value = '';
    }
  });
  const saved = async () => {
    const paths = await api.paths(signal);
    fill(
        list, h('option', {value: ''}, paths.length ? 'choose' : 'none kept'),
        paths.map((item) => h('option', {value: item.id}, item.name)));
  };
  const node = h(
      'details', {ontoggle: () => node.open && saved().catch(toast)},
      h('summary', null, 'Keep and load'),
      h('div', {class: 'row wrap'}, h('label', {'for': 'path-name'}, 'Keep as'), name,
        action(
            'Keep',
            async () => {
              await api.savePath({name: name.value.trim(), path: documentOf(get())});
              await saved();
              toast(`Kept as ${name.value.trim()}`);
            })),
      h('div', {class: 'row wrap'}, h('label', {'for': 'saved-paths'}, 'Load'), list,
        action(
            'Load',
            async () => {
              if (list.value) adopt((await api.path(list.value, signal)).path);
            })),
      h('div', {class: 'row wrap'},
        h('button', {
          type: 'button',
          onclick: () => saveBlob(
              new Blob(
                  [JSON.stringify({path: documentOf(get())}, null, 1)], {type: 'application/json'}),
              'path.json')
        },
          'Save as a file'),
        file, h('label', {class: 'button', 'for': 'path-file'}, 'Open a file')));
  return node;
}

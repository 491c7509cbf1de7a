// The camera path: recorded keys as a strip and on a timeline, its options, preview, saving and
// submitting.
import {api} from '../api.js';
import {
  addKey,
  cameraAt,
  changeKey,
  createHistory,
  documentOf,
  duration,
  emptyPath,
  frameCount,
  insertKey,
  momentOf,
  moveKey,
  pathOfDocument,
  photographedArc,
  PREFABS,
  problemOf,
  removeKey,
  shiftKey,
  stretch,
  throughCameras,
  timeOfWay
} from '../path.js';
import {fill, follow, h, saveBlob, showBlob, text} from '../dom.js';
import {plural, seconds} from '../format.js';
import {
  action,
  announce,
  choice,
  confirmFirst,
  empty,
  field,
  panel,
  showFaults,
  toast
} from '../ui.js';
import {needsSpace, readPathFiles, writePathFiles} from '../pathfile.js';
import {FILMS, FRAMES, OUTPUTS} from '../outputs.js';
import {createPathStore} from '../pathstore.js';
import {go, link} from '../router.js';
import {putJob, state} from '../store.js';
import {createKeyFields} from './keyfields.js';
import {createQuality} from './pathquality.js';
import {createTimeline} from './timeline.js';

/**
 * @param {any} scene @param {{width: number, height: number}} size of a frame at first
 * @param {ReturnType<import('./viewport.js').createViewport>} view @param {AbortSignal} signal
 */
export function createKeys(scene, size, view, signal) {
  const storeKey = `ripnerf-path-${scene.id}`;
  let path = restore(storeKey) ?? emptyPath(size.width, size.height);
  let playing = null;
  let selected = null;
  let at = null;  // the time along the path that is looked at, else null
  const history = createHistory();

  const strip = h('ol', {class: 'keys'});
  const box = h('div');
  const words = h('p', {class: 'quiet', role: 'status'});
  const kept = h('p', {class: 'quiet kept'});
  const problem = h('div');
  const store = createPathStore(scene, (said) => text(kept, said), signal);
  const form = optionsForm(path, `ripnerf-made-${scene.id}`, ({seconds: whole, ...values}) => {
    if (whole > 0 && duration(path)) set(stretch(path, whole), 'seconds');
    if (whole !== undefined) return;
    const keys = 'lens' in values ? path.keys.map((key) => ({...key, picture: undefined})) : path.keys;
    set({...path, keys, ...values}, Object.keys(values)[0]);
    pictures();
  });
  const quality = createQuality(scene);
  const numbers = createKeyFields(view.up, {
    change: (id, values) => {
      set(changeKey(path, id, values), `numbers ${id}`);
      goTo(id);
      pictures();
    },
    depthOf: view.depthOf,
    take,
    spread
  });
  const timeline = createTimeline({
    path: () => path,
    seek,
    shift: (id, time, drag) => set(shiftKey(path, id, time), drag ?? `shift ${id}`),
    show: (id) => goTo(id),
    remove: (id) => set(removeKey(path, id)),
    selected: () => selected
  });
  const play = h(
      'button', {type: 'button', onclick: () => (playing ? stopPreview() : preview())}, 'Preview');
  const between =
      h('button', {
        type: 'button',
        class: 'small',
        onclick: insertHere,
        title: 'A key at this moment of the path'
      },
        'Key here');
  const undo = h(
      'button', {type: 'button', class: 'small bare', title: 'Ctrl Z', onclick: () => step('undo')},
      'Undo');
  const redo =
      h('button',
        {type: 'button', class: 'small bare', title: 'Ctrl Shift Z', onclick: () => step('redo')},
        'Redo');
  const submit = action(
      'Render the path', send,
      {kind: 'primary', onError: (error) => showFaults(form.fields, problem, error)});

  function put(next) {
    path = next;
    if (!path.keys.some((key) => key.id === selected)) selected = null;
    if (at !== null) at = Math.min(at, duration(path));
    sessionStorage.setItem(
        storeKey,
        JSON.stringify({...path, keys: path.keys.map((key) => ({...key, picture: undefined}))}));
    show();
  }

  /** A change by the reader; `word` names it, so that a drag is one step back. What changes nothing is none. */
  function set(next, word) {
    if (next === path) return;
    history.note(path, word);
    put(next);
    store.keep(path);
  }

  function step(verb) {
    const next = history[verb](path);
    if (!next) return;
    put(next);
    form.show(path);
    store.keep(path);
    announce(verb === 'undo' ? 'Undone' : 'Done again');
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
                h('strong', null, 'Record key'),
                '. Or take a ready-made path from the list above.')));
    const fault = problemOf(path);
    const many = path.keys.length > 1;
    strip.dataset.lens = path.lens;
    text(words, path.keys.length ? fault ?? describe() : '');
    words.classList.toggle('bad', Boolean(path.keys.length && fault));
    submit.disabled = Boolean(fault);
    play.disabled = Boolean(fault) || !many;
    between.disabled = Boolean(fault) || !many || at === null;
    undo.disabled = !history.canUndo();
    redo.disabled = !history.canRedo();
    clear.disabled = !path.keys.length;
    timeline.update();
    form.tell(path);
    quality.update(path, view.msPerPixel());
    const index = path.keys.findIndex((key) => key.id === selected);
    numbers.show(path.keys[index] ?? null, index + 1);
    view.overlay({path, selected, time: fault ? null : at});
  }

  const describe = () => [plural(path.keys.length, 'key'), seconds(duration(path)),
                          `${plural(frameCount(path), 'frame')} of ${path.width} × ${path.height}`]
                             .join(' · ');

  /** The chosen key is in sight among the others; the page stays where it is. */
  function reveal() {
    const item = strip.children[path.keys.findIndex((key) => key.id === selected)];
    const [has, room] = [item, strip].map((e) => e.getBoundingClientRect());
    strip.scrollLeft += Math.max(0, has.right - room.right) + Math.min(0, has.left - room.left);
  }

  function goTo(id) {
    const item = path.keys.find((other) => other.id === id);
    if (!item) return;
    stopPreview();
    selected = id;
    at = null;
    timeline.set(momentOf(path, path.keys.indexOf(item)));
    view.show(item.pose, item.fovDeg, item.optics);
    show();
    reveal();
  }

  function seek(time) {
    if (problemOf(path)) return;
    stopPreview();
    at = time;
    const {pose, fovDeg, optics} = cameraAt(path, time);
    view.show(pose, fovDeg, optics);
    show();
  }

  function insertHere() {
    const {pose, fovDeg, optics} = cameraAt(path, at);
    set(insertKey(path, path.keys[0].time + timeOfWay(path, at), pose, fovDeg, optics));
    pictures();
  }

  const createRow = (key) => keyRow(key, {
    signal,
    change: (id, values) => {
      set(changeKey(path, id, values), `row ${id}`);
      pictures();
    },
    remove: (id) => set(removeKey(path, id)),
    move: (id, by) => set(moveKey(path, id, path.keys.findIndex((item) => item.id === id) + by)),
    place: (id, target) =>
        set(moveKey(path, id, path.keys.findIndex((item) => item.id === target))),
    show: goTo,
    order: (id) => ({
      index: path.keys.findIndex((item) => item.id === id),
      count: path.keys.length,
      selected: id === selected
    })
  });

  async function picture(id) {
    const key = path.keys.find((item) => item.id === id);
    if (!key || key.picture) return;
    try {
      const around = path.lens === 'equirectangular';
      const blob = await view.thumbnail(key.pose, key.fovDeg, signal, key.optics, around);
      if (around !== (path.lens === 'equirectangular')) return;  // another lens was chosen
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
    selected = path.keys.at(-1).id;
    show();
    reveal();
    timeline.set(momentOf(path, path.keys.length - 1));
    announce(`Key ${path.keys.length} recorded`);
    pictures();
  }

  /** The chosen key has the camera that looks now. */
  function take() {
    const index = path.keys.findIndex((key) => key.id === selected);
    if (index < 0) return;
    set(changeKey(
        path, selected, {pose: view.pose(), fovDeg: view.orbit.fovDeg, picture: undefined}));
    announce(`Key ${index + 1} is here now`);
    pictures();
  }

  /** Every key has the chosen one's field of view and effects. */
  function spread() {
    const {fovDeg, optics} = path.keys.find((key) => key.id === selected);
    set({...path, keys: path.keys.map((key) => ({...key, fovDeg, optics, picture: undefined}))});
    announce(`${plural(path.keys.length, 'key')} changed`);
    pictures();
  }

  function stopPreview() {
    if (!playing) return;
    cancelAnimationFrame(playing);
    playing = null;
    text(play, 'Preview');
    if (!signal.aborted) show();
  }

  /** At the path's own speed, while the daemon is there to draw it; a loop goes on until it is stopped. */
  function preview() {
    let time = at !== null && at < duration(path) - 0.05 ? at : 0;
    let last = null;
    text(play, 'Stop');
    const tick = (now) => {
      if (state.connection.status === 'online') time += (now - (last ?? now)) / 1000;
      last = now;
      const whole = duration(path);
      if (signal.aborted || problemOf(path) || !whole || time > whole && !path.loop) {
        stopPreview();
        return;
      }
      time %= whole;
      at = time;
      timeline.set(time);
      const {pose, fovDeg, optics} = cameraAt(path, time);
      view.show(pose, fovDeg, optics);
      view.overlay({path, selected, time});
      playing = requestAnimationFrame(tick);
    };
    playing = requestAnimationFrame(tick);
  }

  async function send() {
    showFaults(form.fields, problem, null);
    const crop = view.crop();
    const options = {...form.options(), ...quality.setting(), ...(crop ? {crop} : {})};
    const body = {type: 'path', scene: scene.id, camera_path: documentOf(path)};
    go(link.job(
        putJob(await api.submit(Object.keys(options).length ? {...body, options} : body)).id));
  }

  const adopt = (document) => {
    set(pathOfDocument(document));
    form.show(path);
    pictures();
  };
  const make = (name) => {
    const [, , build] = PREFABS.find(([key]) => key === name);
    set(build ? build(path, view.orbit, view.cameras) : throughCameras(path, view.cameras));
    form.show(path);
    pictures();
  };
  const offer = (name) => path.keys.length ?
      confirmFirst('Replace the keys of this path?', 'Replace', async () => make(name)) :
      make(name);
  const swings = photographedArc(view.orbit, view.cameras);  // a whole turn would show what nobody photographed
  const offered = ([name]) => name === 'photographs' ? view.cameras.length > 1 : name !== 'swing' || swings;
  const ready =
      h('select', {
        'aria-label': 'Ready-made paths',
        onchange: () => {
          const {value} = ready;
          ready.value = '';
          if (value) offer(value);
        }
      },
        h('option', {value: ''}, 'Ready-made…'),
        PREFABS.filter(offered).map(([value, label]) => h('option', {value}, label)));
  const clear =
      h('button', {
        type: 'button',
        class: 'small bare',
        onclick: () => confirmFirst(
            `Remove all ${plural(path.keys.length, 'key')} of this path?`, 'Remove',
            async () => set({...path, keys: []}))
      },
        'Clear');
  const node = panel(
      'Camera path', {
        'data-order': 1,
        tools:
            h('div', {class: 'row wrap'}, undo, redo, ready,
              h('button', {type: 'button', class: 'small', onclick: () => offer(swings ? 'swing' : 'orbit')},
                swings ? 'Swing' : 'Whole turn'),
              clear)
      },
      box, numbers.node, words, form.node, quality.node, problem,
      h('div', {class: 'row wrap'}, submit, saving(() => path, adopt, signal)), kept);
  view.below(h('div', {class: 'reel'}, play, timeline.node, between));
  show();
  pictures();
  if (!path.keys.length)
    store.find()
        .then(
            (document) => document && !path.keys.length && !signal.aborted &&
                (put(pathOfDocument(document)), form.show(path), pictures(),
                 text(kept, `as it was kept in the daemon, ${store.name}`)))
        .catch(() => {});
  signal.addEventListener('abort', stopPreview, {once: true});
  addEventListener('keydown', (event) => {
    const typing = event.target.closest?.('input:not([type=range]), select, textarea');
    if (!(event.ctrlKey || event.metaKey) || typing) return;
    const again = event.key === 'y' || event.key === 'Z' || event.key === 'z' && event.shiftKey;
    if (event.key.toLowerCase() !== 'z' && event.key !== 'y') return;
    event.preventDefault();
    step(again ? 'redo' : 'undo');
  }, {signal});
  return {
    node,
    record,
    take,
    choose: goTo,
    /** The reader has taken the camera. */
    leave: () => stopPreview(),
    /** The scene's curve, or null: what the path's frames cost. */
    set curve(next) {
      quality.curve = next;
      show();
    }
  };
}

function readJson(key) {
  try {
    return JSON.parse(sessionStorage.getItem(key));
  } catch { return null; }
}

function restore(storeKey) {
  const kept = readJson(storeKey);
  return kept && {tension: 0, constantSpeed: false, lens: 'pinhole', ...kept};
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
    const {index, count, selected} = host.order(id);
    node.dataset.selected = String(selected);
    text(number, index + 1);
    if (document.activeElement !== time) time.value = Number(key.time.toFixed(3));
    if (document.activeElement !== fov) fov.value = Number(key.fovDeg.toFixed(2));
    left.disabled = index === 0;
    right.disabled = index === count - 1;
    if (key.picture && key.picture !== shown) {
      shown = key.picture;
      image.hidden = false;
      showBlob(image, shown, AbortSignal.any([gone.signal, host.signal]));
    }
  };
  return {node, update, remove: () => gone.abort()};
}

/**
 * Frames per second, size, length, interpolation, loop, output; what is made of them is kept under
 * `madeKey`, as the path is.
 */
function optionsForm(path, madeKey, change) {
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
  const length = number('Length', 'seconds', {min: 0, step: 'any'}, 's');
  const interpolation = choice(
      'Between keys', [['spline', 'smooth'], ['linear', 'straight'], ['circle', 'round']],
      path.interpolation, {pointer: '/camera_path/interpolation'});
  const loop =
      h('input', {type: 'checkbox', id: 'path-loop', onchange: () => change({loop: loop.checked})});
  const lens = choice(
      'Lens', [['pinhole', 'perspective'], ['equirectangular', 'all around']],
      path.lens ?? 'pinhole', {pointer: '/camera_path/lens'});
  lens.control.onChange(() => change({lens: lens.control.value}));
  const output = choice(
      'Output', OUTPUTS, 'rgb',
      {pointer: '/options/output'});
  const tension = field(
      'Tension', h('input', {
        type: 'range',
        min: 0,
        max: 1,
        step: 0.05,
        value: path.tension ?? 0,
        oninput: () => change({tension: Number(tension.control.value)})
      }),
      {pointer: '/camera_path/tension'});
  const steady = h('input', {
    type: 'checkbox',
    id: 'path-steady',
    onchange: () => change({constantSpeed: steady.checked})
  });
  const offer = (kind, names) => names.map(([value, label]) => h('option', {value}, `${kind}, ${label}`));
  const film = field(
      'Made into',
      h('select', null, state.info?.films ? offer('film', FILMS) : null, offer('frames', FRAMES)),
      {pointer: '/options/film'});
  const quality = field(
      'Film quality', h('input', {type: 'number', min: 0, max: 100, value: 75}),
      {pointer: '/options/video_quality'});
  const jpegQuality = field(
      'JPEG quality', h('input', {type: 'number', min: 1, max: 100, value: 90}),
      {pointer: '/options/jpeg_quality'});
  const isFilm = () => FILMS.some(([value]) => value === film.control.value);
  const showMade = () => {
    quality.node.hidden = !isFilm();
    jpegQuality.node.hidden = film.control.value !== 'jpeg';
    output.node.hidden = film.control.value === 'exr';
  };
  const made = {film, quality, jpegQuality, output};
  for (const [name, value] of Object.entries(readJson(madeKey) ?? {}))
    if (made[name]) made[name].control.value = value;
  film.control.value ||= film.control.options[0].value;
  for (const {node} of Object.values(made))
    node.addEventListener('change', () => {
      showMade();
      const values = Object.entries(made).map(([name, {control}]) => [name, control.value]);
      sessionStorage.setItem(madeKey, JSON.stringify(Object.fromEntries(values)));
    });
  showMade();
  const madeOptions = () => {
    const made = film.control.value;
    if (isFilm()) return {film: made, video_quality: Number(quality.control.value)};
    if (made === 'jpeg') return {format: made, jpeg_quality: Number(jpegQuality.control.value)};
    return {format: made};
  };
  interpolation.control.onChange(() => {
    change({interpolation: interpolation.control.value});
    tension.node.hidden = interpolation.control.value !== 'spline';
  });
  const show = (now) => {
    tension.control.value = now.tension ?? 0;
    tension.node.hidden = now.interpolation !== 'spline';
    steady.checked = Boolean(now.constantSpeed);
    for (const [item, key] of [[width, 'width'], [height, 'height'], [fps, 'fps']])
      item.control.value = now[key];
    loop.checked = now.loop;
    interpolation.node.querySelector(`input[value=${now.interpolation}]`).checked = true;
    lens.node.querySelector(`input[value=${now.lens ?? 'pinhole'}]`).checked = true;
  };
  show(path);
  return {
    fields: [width, height, fps, interpolation, tension, lens, output, film, quality,
             jpegQuality],
    options: () => ({
      ...(output.control.value === 'rgb' || film.control.value === 'exr' ?
              {} :
              {output: output.control.value}),
      ...madeOptions()
    }),
    show,
    /** After a change of the keys. */
    tell: (now) => {
      length.control.disabled = now.keys.length < 2;
      if (document.activeElement !== length.control)
        length.control.value = Number(duration(now).toFixed(3));
    },
    node:
        h('div', {class: 'path-options'}, width.node, height.node, fps.node, length.node, interpolation.node,
          tension.node, lens.node, output.node, film.node, quality.node, jpegQuality.node,
          h('div', {class: 'field check'}, loop, h('label', {'for': 'path-loop'}, 'Loop')),
          h('div', {class: 'field check'}, steady,
            h('label', {'for': 'path-steady'}, 'Constant speed')))
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
    multiple: true,
    accept: '.json,.txt,application/json,text/plain',
    class: 'unseen',
    id: 'path-file',
    onchange: () => {
      const files = [...file.files];
      file.value = '';
      open(files, false).catch((error) => {
        if (needsSpace(error))
          return confirmFirst(
              'These coordinates are those of one training of nerfstudio. Its dataparser_transforms.json, opened together with the path, says where they lie. Or are they the dataset’s own?',
              'They are the dataset’s', () => open(files, true),
              {leave: 'Leave it', kind: 'primary'});
        toast(Object.assign(error, {title: 'Not read'}));
      });
    }
  });
  async function open(files, ours) {
    const {path, format} = await readPathFiles(files, signal, ours);
    adopt(path);
    if (format !== 'ripnerf') toast(`Read as a path of ${format}`);
  }
  const format = h('select', {id: 'path-format'});
  api.formats(signal).then(
      ({paths}) => format.append(
          ...paths.map(({name, title}) => h('option', {value: name}, title))), () => {});
  const saved = async () => {
    const paths = await api.paths(signal);
    fill(
        list, h('option', {value: ''}, paths.length ? 'choose' : 'none kept'),
        paths.map((item) => h('option', {value: item.id}, item.name)));
  };
  const node = h(
      'details', {ontoggle: () => node.open && saved().catch(toast)},
      h('summary', null, 'Keep, load, import, export'),
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
        h('label', {'for': 'path-format'}, 'As a file of'), format,
        action(
            'Save as a file',
            async () => {
              for (const [called, blob] of await writePathFiles(get(), format.value, signal))
                saveBlob(blob, called);
            }),
        file, h('label', {class: 'button', 'for': 'path-file'}, 'Open a file')),
      h('p', {class: 'quiet'},
        'Opened are paths of all these programs, in the dataset’s coordinates; of nerfstudio together with its dataparser_transforms.json, COLMAP’s images.txt with its cameras.txt, instant-ngp’s with the dataset’s transforms.json where that has a scale or an offset.'));
  return node;
}

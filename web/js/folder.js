// A chosen or dropped folder: which files a dataset needs, decided by the daemon's table of formats
// and by the documents' JSON before any upload.

const SPLITS = ['train', 'val', 'test'];
const MAX_FILES = 100_000;

/**
 * @typedef {{path: string, file: File}} Entry
 * @typedef {{name: string, title: string, signs: {file: string, member?: string}[],
 *   documents: string[], photo_folders: string[]}} Format
 * @typedef {{name: string, layout: string, entries: Entry[], bytes: number, left: number,
 *   views: Record<string, number>, missing: string[], problem: string|null, poses?: string}} Plan
 */

/** @param {FileList} files of an <input webkitdirectory> @returns {Entry[]} */
export const entriesOfInput =
    (files) => [...files].map((file) => ({path: file.webkitRelativePath || file.name, file}));

/** Walks what was dropped. @param {DataTransferItemList} items @returns {Promise<Entry[]>} */
export async function entriesOfDrop(items) {
  const roots = [...items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  const entries = [];
  const walk = async (node) => {
    if (entries.length >= MAX_FILES) return;
    if (node.isFile) {
      const file = await new Promise((done, fail) => node.file(done, fail));
      entries.push({path: node.fullPath.replace(/^\//, ''), file});
      return;
    }
    const reader = node.createReader();
    for (;;) {
      const part = await new Promise((done, fail) => reader.readEntries(done, fail));
      if (!part.length) return;
      for (const child of part) await walk(child);
    }
  };
  for (const root of roots) await walk(root);
  return entries;
}

const EXTENSIONS =
    ['png', 'jpg', 'jpeg', 'jfif', 'webp', 'tif', 'tiff', 'heic', 'heif', 'avif', 'exr'];
const SMALLER = ['images_2', 'images_4', 'images_8'];  // where images/ has none
const FILMS = ['mp4', 'mov', 'm4v', 'mkv', 'webm', 'avi'];
const FEWEST = 3;  // photographs that poses are found for
const NAMING = ['file_path', 'mask_path', 'ply_file_path', 'ply_file_path', 'file', 'mask'];

/** What a path may stand for: itself, another case of its extension, the same in a smaller size. */
function choicesOf(path) {
  const [, stem, extension] = /^(.*)\.([A-Za-z0-9]{2,4})$/.exec(path) ?? [path, path];
  const cased = (extension ? [extension] : EXTENSIONS)
                    .flatMap((one) => [one.toLowerCase(), one.toUpperCase()])
                    .map((one) => `${stem}.${one}`);
  const named = extension ? [path, ...cased] : cased;
  const inner = /^images\/(.*)/;
  return [
    ...named, ...SMALLER.flatMap(
                  (folder) => named.filter((one) => inner.test(one))
                                  .map((one) => one.replace(inner, `${folder}/$1`)))
  ];
}

/**
 * The dataset's file that a document means: "./train/r_0" is "train/r_0.png" where no file says
 * otherwise; a path of another machine is the file at its end.
 * @param {string} named @param {{has: (path: string) => boolean}} files
 */
export function imagePath(named, files) {
  const path = named.replaceAll('\\', '/').replace(/^(\.\/)+/, '');
  const choices = choicesOf(path);
  if (!/^\/|^[A-Za-z]:|(^|\/)\.\.(\/|$)/.test(path))
    return choices.find((choice) => files.has(choice)) ?? choices[0];
  for (const choice of choices) {
    const parts = choice.split('/');
    for (let from = parts.lastIndexOf('..') + 1; from < parts.length; from++)
      if (files.has(parts.slice(from).join('/'))) return parts.slice(from).join('/');
  }
  return choices[0];
}

/** Every file that a document names, wherever in it. */
function namesIn(node, key = '') {
  if (typeof node === 'string') return NAMING.includes(key) ? [node] : [];
  if (!node || typeof node !== 'object') return [];
  return Object.entries(node).flatMap(
      ([inner, value]) => namesIn(value, Array.isArray(node) ? key : inner));
}

/** Views by split, as far as a document tells. */
function viewsIn(fileName, json) {
  const split = /_(train|val|test)\.json$/.exec(fileName)?.[1];
  if (split) return {[split]: json.frames?.length ?? 0};
  const counted = SPLITS.filter((key) => Array.isArray(json[key]?.file_path));
  if (counted.length)
    return Object.fromEntries(counted.map((key) => [key, json[key].file_path.length]));
  return {photographs: json.frames?.length ?? 0};
}

/** JSON without what some programs write into it: comments, and numbers that are none. */
const plainJson = (text) => text.replace(
    /("(?:\\.|[^"\\])*")|-?\b(NaN|Infinity)\b|\/\/[^\n]*|\/\*[\s\S]*?\*\//g,
    (all, string, number) => string ?? (number ? 'null' : ''));

const isPhoto = (path) => EXTENSIONS.includes(path.split('.').at(-1).toLowerCase());
const pattern = (text) =>
    new RegExp(`^${text.replace(/[.+?^${}()|[\]\\]/g, '\\$&').replaceAll('*', '[^/]*')}$`);

/** The folders that bear a sign of some format, shallowest first. */
function rootsOf(entries, formats) {
  const signs = [...new Set(formats.flatMap((format) => format.signs.map((sign) => sign.file)))];
  const roots = new Set();
  for (const {path} of entries)
    for (const sign of signs)
      if (path === sign || path.endsWith(`/${sign}`)) roots.add(path.slice(0, -sign.length));
  return [...roots].sort((a, b) => a.length - b.length);
}

/** Photographs without smaller ones of the very same names: readers take those that are larger. */
function withoutCopies(photos) {
  const namesOf = (folder) => photos.filter((path) => path.startsWith(`${folder}/`))
                                  .map((path) => path.slice(folder.length + 1))
                                  .sort()
                                  .join('\n');
  const largest = namesOf('images');
  const copies = SMALLER.filter((folder) => namesOf(folder) === largest);
  return photos.filter((path) => !copies.some((folder) => path.startsWith(`${folder}/`)));
}

/** Whether the folder bears one of a format's signs. */
async function bearsSign(format, files) {
  for (const {file, member} of format.signs) {
    if (!files.has(file)) continue;
    if (!member) return true;
    try {
      if (member in JSON.parse(plainJson(await files.get(file).text()))) return true;
    } catch {
      continue;  // no sign then; whoever reads it as a document says why
    }
  }
  return false;
}

/** A name the daemon takes: letters, digits, dot, dash, underscore. */
export function safeName(text) {
  const name = text.replace(/[^A-Za-z0-9._-]+/g, '-').replace(/^[^A-Za-z0-9]+/, '').slice(0, 64);
  return /^(ds_|sc_|job_|path_|tok_)/.test(name) ? name.replace('_', '-') : name;
}

const isFilm = (path) => FILMS.includes(path.split('.').at(-1).toLowerCase());

/** A plan for photographs, or one film, that no document poses; null where there are too few. */
function photosOnly(entries) {
  const shown = entries.filter(({path}) => !/(^|\/)\./.test(path));
  const photos = shown.filter(({path}) => isPhoto(path)),
        films = shown.filter(({path}) => isFilm(path));
  const chosen = photos.length >= FEWEST ? photos : films.length === 1 ? films : [];
  if (!chosen.length) return null;
  const masks = photos.filter(({path}) => /(^|\/)masks\//.test(path)).length;
  return {
    name: safeName(
        chosen[0].path.split('/').slice(0, -1).find((part) => part !== 'images') ??
        (chosen === films ? chosen[0].path.replace(/\.\w+$/, '') : 'photographs')),
    layout: chosen === photos ? 'photographs without poses' : 'a film',
    entries: chosen,
    bytes: chosen.reduce((sum, entry) => sum + entry.file.size, 0),
    left: entries.length - chosen.length,
    views: chosen === photos ? {photographs: photos.length - masks} : {},
    missing: [],
    problem: null,
    poses: 'find',
  };
}

/**
 * What to upload. Only what the format's documents name, or what lies in its folders, is sent;
 * `problem` says why nothing can be.
 * @param {Entry[]} entries @param {Format[]} formats as GET /v1/formats has them
 * @returns {Promise<Plan>}
 */
export async function planUpload(entries, formats) {
  const plan =
      {name: '', layout: '', entries: [], bytes: 0, left: 0, views: {}, missing: [], problem: null};
  const roots = rootsOf(entries, formats);
  const bare = roots.length ? null : photosOnly(entries);
  if (bare) return bare;
  if (!roots.length) {
    const signs = formats.map(({title, signs}) => `${signs[0].file} (${title})`).join(', ');
    return {
      ...plan,
      problem: `None of ${signs} is in this folder, nor are ${
          FEWEST} photographs or one film, whose cameras could be looked for. Choose another folder.`
    };
  }
  const root = roots[0];
  if (roots.length > 1 && root.split('/').length === roots[1].split('/').length) {
    return {
      ...plan,
      problem:
          `Several datasets in this folder (${roots.slice(0, 4).join(', ')}). Choose one of them.`
    };
  }
  const files = new Map(entries.filter((e) => e.path.startsWith(root))
                            .map((e) => [e.path.slice(root.length), e.file]));
  let format = null;
  for (const candidate of formats)
    if (!format && await bearsSign(candidate, files)) format = candidate;
  format ??= formats.find(({signs}) => signs.some(({file}) => files.has(file)));
  const documents = format.documents.map(pattern), folders = format.photo_folders;
  const described = [...files.keys()].filter((path) => documents.some((one) => one.test(path)));
  const photos = withoutCopies([...files.keys()].filter(
      (path) => isPhoto(path) && folders.some((folder) => path.startsWith(`${folder}/`))));
  const masks = [...files.keys()].filter((path) => isPhoto(path) && /mask/i.test(path));
  const wanted = new Set([...described, ...photos, ...masks]);
  plan.layout = format.title;
  if (photos.length) plan.views.photographs = photos.length;
  for (const path of described.filter((name) => name.endsWith('.json'))) {
    let json;
    try {
      json = JSON.parse(plainJson(await files.get(path).text()));
    } catch (error) { return {...plan, problem: `${path}: ${error.message}`}; }
    namesIn(json).forEach((name) => wanted.add(imagePath(name, files)));
    for (const [split, count] of Object.entries(viewsIn(path, json)))
      plan.views[split] = (plan.views[split] ?? 0) + count;
  }
  plan.name = safeName(root.split('/').filter(Boolean).at(-1) ?? 'dataset');
  plan.missing = [...wanted].filter((path) => !files.has(path));
  plan.entries =
      [...wanted].filter((path) => files.has(path)).map((path) => ({path, file: files.get(path)}));
  plan.bytes = plan.entries.reduce((sum, entry) => sum + entry.file.size, 0);
  plan.left = files.size - plan.entries.length;
  return plan;
}

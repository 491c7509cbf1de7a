// A chosen or dropped folder: which files a dataset needs, decided by its JSON before any upload.

const SPLITS = ['train', 'val', 'test'];
const MAX_FILES = 100_000;

/**
 * @typedef {{path: string, file: File}} Entry
 * @typedef {{name: string, layout: string, entries: Entry[], bytes: number, left: number,
 *   views: Record<string, number>, missing: string[], problem: string|null}} Plan
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

/** "./train/r_0" of a transforms file is "train/r_0.png": no extension means PNG. */
export function imagePath(filePath) {
  const path = filePath.replaceAll('\\', '/').replace(/^(\.\/)+/, '');
  return /\.[A-Za-z0-9]{2,4}$/.test(path) ? path : `${path}.png`;
}

/** Image paths by split of one parsed description. */
function namesIn(fileName, json) {
  const split = /^transforms_(train|val|test)\.json$/.exec(fileName)?.[1];
  if (split)
    return {[split]: (json.frames ?? []).map((frame) => imagePath(String(frame.file_path ?? '')))};
  const names = {};
  for (const key of SPLITS)
    if (json[key]) names[key] = (json[key].file_path ?? []).map((path) => imagePath(String(path)));
  return names;
}

const isDescription = (path) => /(^|\/)(transforms_(train|val|test)|metadata)\.json$/.test(path);
const folderOf = (path) => path.slice(0, path.lastIndexOf('/') + 1);

/** A name the daemon takes: letters, digits, dot, dash, underscore. */
export function safeName(text) {
  const name = text.replace(/[^A-Za-z0-9._-]+/g, '-').replace(/^[^A-Za-z0-9]+/, '').slice(0, 64);
  return /^(ds_|sc_|job_|path_)/.test(name) ? name.replace('_', '-') : name;
}

/**
 * What to upload. Only what the JSON names is sent; `problem` says why nothing can be.
 * @param {Entry[]} entries @returns {Promise<Plan>}
 */
export async function planUpload(entries) {
  const plan =
      {name: '', layout: '', entries: [], bytes: 0, left: 0, views: {}, missing: [], problem: null};
  const described = entries.filter((entry) => isDescription(entry.path));
  const roots = [...new Set(described.map((entry) => folderOf(entry.path)))].sort(
      (a, b) => a.length - b.length);
  if (!roots.length)
    return {
      ...plan,
      problem:
          'No transforms_train.json and no metadata.json in this folder. Choose the folder that holds it.'
    };
  if (roots.length > 1 && roots[0].split('/').length === roots[1].split('/').length) {
    return {
      ...plan,
      problem:
          `Several datasets in this folder (${roots.slice(0, 4).join(', ')}). Choose one of them.`
    };
  }
  const root = roots[0];
  const files = new Map(entries.filter((e) => e.path.startsWith(root))
                            .map((e) => [e.path.slice(root.length), e.file]));
  const descriptions =
      [...files.keys()].filter((path) => isDescription(path) && !path.includes('/'));
  const wanted = new Set(descriptions);
  plan.layout = descriptions.includes('metadata.json') ? 'multi-scale Blender' : 'NeRF-synthetic';
  for (const path of descriptions) {
    let json;
    try {
      json = JSON.parse(await files.get(path).text());
    } catch (error) { return {...plan, problem: `${path}: ${error.message}`}; }
    for (const [split, names] of Object.entries(namesIn(path, json))) {
      plan.views[split] = (plan.views[split] ?? 0) + names.length;
      names.forEach((name) => wanted.add(name));
    }
  }
  plan.name = safeName(root.split('/').filter(Boolean).at(-1) ?? 'dataset');
  plan.missing = [...wanted].filter((path) => !files.has(path));
  plan.entries =
      [...wanted].filter((path) => files.has(path)).map((path) => ({path, file: files.get(path)}));
  plan.bytes = plan.entries.reduce((sum, entry) => sum + entry.file.size, 0);
  plan.left = files.size - plan.entries.length;
  return plan;
}

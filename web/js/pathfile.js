// Camera paths in files: this program's own, and other programs' through the daemon's readers.
import {api} from './api.js';
import {documentOf} from './path.js';

const named = (files, name) => files.find((file) => file.name === name);

/** What lies beside a path's file among those that were chosen: the path itself is what is left. */
export function sortFiles(files) {
  const space = named(files, 'dataparser_transforms.json');
  const beside = files.length > 1 ? named(files, 'cameras.txt') : undefined;
  const left = files.filter((one) => one !== space && one !== beside);
  const dataset = left.length > 1 ? named(left, 'transforms.json') : undefined;
  return {file: left.find((one) => one !== dataset), beside, space, dataset};
}

/**
 * The document of the chosen files, in the dataset's coordinates.
 * @param {File[]} files a path, and what its format has beside it: COLMAP's cameras.txt,
 *     nerfstudio's dataparser_transforms.json, the dataset's transforms.json
 * @param {boolean} ours the coordinates are the dataset's own, whatever the format
 */
export async function readPathFiles(files, signal, ours = false) {
  const {file, beside, space, dataset} = sortFiles(files);
  if (!file) throw new Error('Choose the path’s own file too.');
  const body = {
    file: await file.text(),
    ...(beside ? {beside: await beside.text()} : {}),
    ...(space ? {space: await space.text()} : ours ? {space: 'dataset'} : {}),
    ...(dataset ? {dataset: await dataset.text()} : {})
  };
  try {
    return await api.convertPath(body, signal);
  } catch (error) {
    throw Object.assign(error, {detail: saidOf(error, {file, beside, space, dataset})});
  }
}

/** What is wrong, with the name of the file that the daemon found it in. */
function saidOf(error, parts) {
  const [found] = error.errors ?? [];
  const part = parts[found?.pointer.slice(2)] ?? parts.file;
  return `${part.name}: ${found?.detail ?? (error.detail || error.message)}`;
}

/** Whether a path was not read because its coordinates are known to one training alone. */
export const needsSpace = (error) => error.errors?.some(({pointer}) => pointer === '#/space');

/**
 * The files of a path in another program's words: name and blob of each.
 * @param {string} to a format, as GET /v1/formats has them
 */
export async function writePathFiles(path, to, signal) {
  const answer = await api.convertPath(
      {path: documentOf(path), to, ...(to === 'nerfstudio' ? {space: 'dataset'} : {})}, signal);
  const {file} = (await api.formats(signal)).paths.find(({name}) => name === answer.format);
  const files = [[file, answer.file]];
  if (answer.beside) files.push([answer.beside_name, answer.beside]);
  return files.map(([called, words]) => [called, new Blob([words], {type: 'text/plain'})]);
}

// A look at each photograph before anything is sent: whether it can be read, and a small picture of
// it, by which the daemon judges blur, duplicates and exposures.

const KNOWN =
    /\.(png|jpe?g|webp|avif)$/i;  // what browsers decode; others are the daemon's to judge
const MASKS = /(^|\/)masks\//;
const AT_ONCE = 3;

/** One that can be looked at here. @param {string} path */
export const isPhotograph = (path) => KNOWN.test(path) && !MASKS.test(path);

const SIDE = 960;  // pixels, about: the longest side of a small picture

const HEADS = {
  // what says an image's size lies in its first so many bytes
  png: 64 << 10,
  webp: 64 << 10,
  jpg: 256 << 10,
  jpeg: 256 << 10
};
const SCAN = 0xda;  // the JPEG segment that pixels follow

/** How much of a JPEG's beginning comes before its pixels. @param {Uint8Array} bytes */
function beforePixels(bytes) {
  let at = 2;
  while (at + 4 <= bytes.length && bytes[at] === 0xff) {
    const end = at + 2 + 256 * bytes[at + 2] + bytes[at + 3];
    if (bytes[at + 1] === SCAN) return end;
    at = end;
  }
  return bytes.length;
}

/**
 * What of a file says a picture's size and its camera; all of one that is no picture.
 * @param {{path: string, file: Blob}} entry
 */
export async function headOf({path, file}) {
  const ending = path.split('.').at(-1).toLowerCase();
  const head = file.slice(0, HEADS[ending] ?? file.size);
  if (!/^jpe?g$/.test(ending)) return {path, file: head};
  return {path, file: head.slice(0, beforePixels(new Uint8Array(await head.arrayBuffer())))};
}

async function shrink(picture) {
  const cell = Math.max(1, Math.round(Math.max(picture.width, picture.height) / SIDE));
  const canvas =
      new OffscreenCanvas(Math.ceil(picture.width / cell), Math.ceil(picture.height / cell));
  const context = canvas.getContext('2d');
  context.imageSmoothingQuality = 'high';
  context.drawImage(picture, 0, 0, canvas.width, canvas.height);
  return canvas.convertToBlob({type: 'image/jpeg', quality: 0.9});
}

/** @returns {Promise<{why?: string, small?: Blob}>} why it is bad, or a small picture where one is wanted */
async function lookAt(file, wantsSmall) {
  if (!file.size) return {why: 'is empty'};
  let picture;
  try {
    picture = await createImageBitmap(file);
  } catch { return {why: 'cannot be decoded: it is damaged, or no picture'}; }
  const small = wantsSmall && await shrink(picture).catch(() => null);
  picture.close();
  return {small};
}

/**
 * @param {{path: string, file: File}[]} entries
 * @param {{onBad: (path: string, why: string) => void, onProgress: (done: number, total: number) =>
 *     void, signal: AbortSignal}} host
 * @returns {Promise<{path: string, file: Blob}[]>} small pictures, upright, of those that can be read
 */
export async function checkPhotographs(entries, {onBad, onProgress, signal}) {
  const photographs = entries.filter(({path}) => KNOWN.test(path));
  const small = [];
  let next = 0;
  let done = 0;
  const work = async () => {
    while (next < photographs.length && !signal.aborted) {
      const {path, file} = photographs[next++];
      const found = await lookAt(file, isPhotograph(path));
      if (signal.aborted) return;
      if (found.why) onBad(path, found.why);
      if (found.small) small.push({path, file: found.small});
      onProgress(++done, photographs.length);
    }
  };
  if (photographs.length) onProgress(0, photographs.length);
  await Promise.all(Array.from({length: AT_ONCE}, work));
  return small;
}

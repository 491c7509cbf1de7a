// A look at each photograph before anything is sent: whether it can be read, and a small picture of
// it, by which the daemon judges blur, duplicates and exposures.

const KNOWN =
    /\.(png|jpe?g|webp|avif)$/i;  // what browsers decode; others are the daemon's to judge
const MASKS = /(^|\/)masks\//;
const AT_ONCE = 3;

/** One that can be looked at here. @param {string} path */
export const isPhotograph = (path) => KNOWN.test(path) && !MASKS.test(path);

const SIDE = 960;  // pixels, about: the longest side of a small picture

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
  await Promise.all(Array.from({length: AT_ONCE}, work));
  return small;
}

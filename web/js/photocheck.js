// Photographs that cannot be read, found before anything is sent.

const KNOWN =
    /\.(png|jpe?g|webp|avif)$/i;  // what browsers decode; others are the daemon's to judge
const AT_ONCE = 3;

async function whyBad(file) {
  if (!file.size) return 'is empty';
  try {
    (await createImageBitmap(file)).close();
    return null;
  } catch { return 'cannot be decoded: it is damaged, or no picture'; }
}

/**
 * @param {{path: string, file: File}[]} entries
 * @param {{onBad: (path: string, why: string) => void, onProgress: (done: number, total: number) =>
 *     void, signal: AbortSignal}} host
 */
export async function checkPhotographs(entries, {onBad, onProgress, signal}) {
  const photographs = entries.filter(({path}) => KNOWN.test(path));
  let next = 0;
  let done = 0;
  const work = async () => {
    while (next < photographs.length && !signal.aborted) {
      const {path, file} = photographs[next++];
      const why = await whyBad(file);
      if (signal.aborted) return;
      if (why) onBad(path, why);
      onProgress(++done, photographs.length);
    }
  };
  await Promise.all(Array.from({length: AT_ONCE}, work));
}

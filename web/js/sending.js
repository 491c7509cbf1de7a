// Sending a tar in parts: after a lost connection it goes on where the daemon has it.
import {api, Problem, Unreachable} from './api.js';
import {sleep} from './dom.js';
import {watch} from './store.js';

const FIRST_PART = 4 << 20;
const MOST_PART = 64 << 20;
const QUICK_MS = 4000;  // a part that took less is followed by one of twice the size
const WAITS_MS = [500, 1000, 2000, 4000, 8000];

/** Whether a failure passes by itself: a lost line, or a daemon that is busy. */
const passes = (error) => error instanceof Unreachable ||
    (error instanceof Problem && [409, 429, 502, 503, 504].includes(error.status));

/** Of a part, also a disk that is full: what is there stays, and it is freed perhaps. */
const partPasses = (error) => passes(error) || (error instanceof Problem && error.status === 507);

/**
 * What was sent goes if it is given up, fails for good, or the page is left.
 * @param {Blob} tar @param {string} name the dataset's
 * @param {{onProgress: (sent: number) => void, onWait: (error: Error) => void,
 *     take?: (upload: string) => Promise<any>, signal: AbortSignal}} host onWait: a pause, after a failure
 *     that passes; take: what becomes of the whole upload, asked again where its answer was lost
 * @returns {Promise<any>} what `take` answers, else the upload's id
 */
export async function sendInParts(
    tar, name, {onProgress, onWait, take, signal}) {
  let failures = 0;
  const pause = async (error, mayPass = passes) => {
    if (signal.aborted) throw new DOMException('upload cancelled', 'AbortError');
    if (!mayPass(error)) throw error;
    const ms = WAITS_MS[Math.min(failures++, WAITS_MS.length - 1)];
    onWait(error);
    await online(ms, signal);
  };
  const patiently = async (ask) => {
    for (;;) {
      try {
        return await ask();
      } catch (error) {
        if (error instanceof Problem && error.status === 409) throw error;  // a name that is taken
        await pause(error);
      }
    }
  };
  const begin = () => patiently(() => api.beginUpload({size_bytes: tar.size, name}, signal));
  let upload = await begin();
  let size = FIRST_PART;
  const over = new AbortController();
  const drop = () => api.dropUpload(upload.id).catch(() => {});
  signal.addEventListener('abort', drop, {once: true, signal: over.signal});
  addEventListener('pagehide', drop, {signal: AbortSignal.any([signal, over.signal])});
  const sendNext = async () => {
    const from = upload.offset;
    const part = tar.slice(from, from + size);
    const began = performance.now();
    try {
      await api.sendPart(upload.id, from, part, (sent) => onProgress(from + sent), signal);
      upload = {...upload, offset: from + part.size};
      failures = 0;
      if (performance.now() - began < QUICK_MS) size = Math.min(MOST_PART, 2 * size);
    } catch (error) {
      size = FIRST_PART;
      await pause(error, partPasses);
      upload = await patiently(() => api.upload(upload.id, signal)).catch((lost) => {
        if (lost instanceof Problem && lost.status === 404) return begin();  // it was removed
        throw lost;
      });
      if (upload.offset > from) failures = 0;
    }
    onProgress(upload.offset);
  };
  try {
    while (upload.offset < tar.size) await sendNext();
    if (!take) return upload.id;
    const taken = await patiently(() => take(upload.id));
    over.abort();  // it is the daemon's
    return taken;
  } catch (error) {
    if (!signal.aborted) drop();
    over.abort();
    throw error;
  }
}

/** Waits so long, or until the browser is online again, or the page has found the daemon again. */
async function online(ms, signal) {
  const early = new AbortController();
  const wake = () => early.abort();
  let away = false;
  addEventListener('online', wake, {signal: early.signal});
  watch(({connection}) => {
    if (away && connection.status === 'online') wake();
    away = connection.status !== 'online';
  }, early.signal);
  await sleep(ms, AbortSignal.any([signal, early.signal]));
  wake();
  if (signal.aborted) throw new DOMException('upload cancelled', 'AbortError');
}

// A scene's path is kept in the daemon as it is made, so that it outlives the tab.
import {api, Problem} from './api.js';
import {documentOf} from './path.js';

const WAIT_MS = 1200;

/**
 * @param {any} scene @param {(words: string) => void} say what became of it
 * @param {AbortSignal} signal
 */
export function createPathStore(scene, say, signal) {
  const name = `${scene.name}.path`.slice(-64).replace(/^[^A-Za-z0-9]+/, '');
  let timer = 0;
  let id = null;      // of the record that holds the path now
  let latest = null;  // what is to be kept
  let busy = false;

  async function write() {
    if (busy || !latest) return;
    busy = true;
    const path = latest;
    latest = null;
    try {
      id ??= (await api.paths()).find((item) => item.name === name)?.id ?? null;
      if (id) await api.removePath(id);
      id = null;
      if (path.keys.length) id = (await api.savePath({name, path: documentOf(path)})).id;
      say(path.keys.length ? `kept in the daemon as ${name}` : '');
    } catch (error) {
      if (signal.aborted) return;
      if (error instanceof Problem && error.status === 404) id = null;
      if (error instanceof Problem && error.status === 403) {
        latest = null;
        return say(`not kept in the daemon: ${name} is another token’s`);
      }
      say('not kept in the daemon yet');
      latest ??= path;
      timer = setTimeout(write, 5 * WAIT_MS);
    } finally { busy = false; }
    if (latest && !timer) timer = setTimeout(write, WAIT_MS);
  }

  signal.addEventListener('abort', () => {
    if (timer && latest) write();  // the page goes: what waits is kept now
    clearTimeout(timer);
  }, {once: true});
  return {
    name,
    /** Keeps the path a moment after its last change. */
    keep(path) {
      latest = path;
      clearTimeout(timer);
      timer = setTimeout(() => {
        timer = 0;
        write();
      }, WAIT_MS);
    },
    /** The document that was kept for this scene, or null. */
    async find() {
      const items = await api.paths(signal).catch(() => []);
      const found = items.find((item) => item.name === name);
      if (!found) return null;
      id = found.id;
      return (await api.path(found.id, signal)).path;
    },
  };
}

// Deep links in the location's hash: #/, #/dataset/NAME, #/scene/NAME, #/job/ID, #/jobs, #/system.

/**
 * @param {string} hash
 * @returns {{view: string, id: string|null, query: URLSearchParams}}
 */
export function parseRoute(hash) {
  const [path, query = ''] = hash.replace(/^#\/?/, '').split('?');
  const [view = '', id = null] = path.split('/').map((part) => {
    try {
      return decodeURIComponent(part);
    } catch { return part; }
  });
  return {view: view || 'home', id: id || null, query: new URLSearchParams(query)};
}

export const link = {
  home: () => '#/',
  jobs: () => '#/jobs',
  system: () => '#/system',
  dataset: (id, query = '') => `#/dataset/${encodeURIComponent(id)}${query}`,
  scene: (id, query = '') => `#/scene/${encodeURIComponent(id)}${query}`,
  job: (id) => `#/job/${encodeURIComponent(id)}`,
};

export const go = (hash) => {
  location.hash = hash;
};

/** Calls `show` now and at every change of the hash. */
export function startRouter(show) {
  addEventListener('hashchange', () => show(parseRoute(location.hash)));
  show(parseRoute(location.hash));
}

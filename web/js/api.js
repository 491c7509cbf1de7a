// The daemon's HTTP interface. Addresses are relative to the page, so that a proxy may add a
// prefix.

import {sleep} from './dom.js';

const base = new URL('.', document.baseURI);
const TOKEN = 'ripnerf-token';

/** An application/problem+json answer. */
export class Problem extends Error {
  constructor(status, body) {
    super(body.detail || body.title || `The daemon answered ${status}`);
    this.status = status;
    this.title = body.title || `HTTP ${status}`;
    this.detail = body.detail || '';
    /** @type {{pointer: string, detail: string}[]} */
    this.errors = Array.isArray(body.errors) ? body.errors : [];
    this.retryAfter = 0;
  }
}

/** The daemon did not answer at all. */
export class Unreachable extends Error {
  constructor() {
    super('The daemon does not answer');
    this.title = 'Daemon unreachable';
    this.errors = [];
  }
}

/** Hooks the page installs: ask for a token; hear that the daemon did not answer. */
export const hooks = {
  askToken: async () => null,
  unreachable: () => {}
};

export const token = {
  get: () => sessionStorage.getItem(TOKEN),
  set: (value) => (value ? sessionStorage.setItem(TOKEN, value) : sessionStorage.removeItem(TOKEN)),
};

let linkToken = null;  // that the page was opened by

/**
 * Takes the token of a link (#t=TOKEN/scene/NAME) out of the address and keeps it for this tab: it
 * stands in no history, and no server has seen it.
 */
export function takeLinkToken() {
  const found = /^#t=([^/]+)(\/.*)?$/.exec(location.hash);
  if (!found) return;
  token.set(found[1]);
  linkToken = found[1];
  history.replaceState(null, '', `#${found[2] ?? '/'}`);
}

/** The absolute address of an API path ("/v1/…" or "v1/…"). */
export const address = (path) => new URL(path.replace(/^\//, ''), base).href;

const withToken = (headers) =>
    (token.get() ? {...headers, Authorization: `Bearer ${token.get()}`} : headers);

/** What is said of a token that was refused, and `why` where the daemon says that. */
function refusalOf(used, why) {
  const said = why ? `: ${why.replace(/\.$/, '')}` : '';
  if (used === linkToken)
    return `This link is good no longer${said}. Whoever sent it can make another.`;
  return `That token was refused${said}.`;
}

let asking = null;  // one question at a time, however many requests were refused

/** @param {string|null} used that was refused @param {string} [why] */
async function renewToken(used, why = '') {
  if (token.get() !== used) return true;
  asking ??= hooks.askToken(used ? refusalOf(used, why) : '').finally(() => {
    asking = null;
  });
  const answer = await asking;
  if (answer) token.set(answer);
  return Boolean(answer);
}

async function problemOf(response) {
  const isJson = (response.headers.get('Content-Type') ?? '').includes('json');
  const problem =
      new Problem(response.status, isJson ? await response.json().catch(() => ({})) : {});
  problem.retryAfter = Number(response.headers.get('Retry-After')) || 0;
  return problem;
}

/**
 * One exchange. Throws Problem, Unreachable or AbortError.
 * @param {string} method @param {string} path
 * @param {{json?: any, headers?: object, signal?: AbortSignal, repeatable?: boolean, keepalive?: boolean}}
 *     [options] repeatable: as often asked as once; by default what reads, and what has a key;
 *     keepalive: also where the page is left
 * @returns {Promise<Response>} with a 2xx status
 */
export async function request(method, path, {json, headers = {}, signal, repeatable, keepalive} = {}) {
  const used = token.get();
  const response = await reach(address(path), {
    method,
    signal,
    keepalive,
    body: json === undefined ? undefined : JSON.stringify(json),
    headers: withToken(
        json === undefined ? headers : {'Content-Type': 'application/json', ...headers}),
  }, repeatable ?? (method === 'GET' || 'Idempotency-Key' in headers));
  if (response.ok) return response;
  const problem = await problemOf(response);
  if (response.status === 401 && await renewToken(used, problem.detail))
    return request(method, path, {json, headers, signal, repeatable, keepalive});
  throw problem;
}

const AGAIN_MS = [100, 400];  // a request that was lost on its way is made anew after so long

/** The answer; what may be asked twice is asked again where a line broke. */
async function reach(url, what, repeatable) {
  for (let lost = 0;; lost++) {
    try {
      return await fetch(url, what);
    } catch (error) {
      if (what.signal?.aborted) throw error;
      if (!repeatable || lost === AGAIN_MS.length) {
        hooks.unreachable();
        throw new Unreachable();
      }
      await sleep(AGAIN_MS[lost], what.signal);
      if (what.signal?.aborted) throw new DOMException('given up', 'AbortError');
    }
  }
}

const name = encodeURIComponent;
const json = async (method, path, options) => (await request(method, path, options)).json();
const blob = async (path, options) => (await request('GET', path, options)).blob();

/** Every item of a list, page after page; at most 40 pages. */
async function list(path, signal) {
  const items = [];
  let cursor = null;
  for (let page = 0; page < 40; page++) {
    const mark =
        `${path.includes('?') ? '&' : '?'}limit=100${cursor ? `&cursor=${name(cursor)}` : ''}`;
    const part = await json('GET', path + mark, {signal});
    items.push(...part.items);
    cursor = part.next_cursor;
    if (!cursor) break;
  }
  return items;
}

/** What a render cost, from the answer's headers. */
function renderFacts(response, started) {
  const timing = response.headers.get('Server-Timing') ?? '';
  const duration = (key) => Number(new RegExp(`${key};dur=([0-9.]+)`).exec(timing)?.[1] ?? NaN);
  const number = (key) => (response.headers.has(key) ? Number(response.headers.get(key)) : NaN);
  return {
    renderMs: duration('render'),
    queueMs: duration('queue'),
    encodeMs: duration('encode'),
    totalMs: performance.now() - started,
    step: number('X-Ripnerf-Step'),
    samples: number('X-Ripnerf-Samples'),
    scale: response.headers.get('X-Ripnerf-Scale') ?? '',
    at: number('X-Ripnerf-At'),
    askedMs: number('X-Ripnerf-Asked-Ms'),
    spentMs: number('X-Ripnerf-Spent-Ms'),
    expectedPsnr: number('X-Ripnerf-Expected-Psnr'),
    expectedSpread: number('X-Ripnerf-Expected-Spread'),
    late: response.headers.get('X-Ripnerf-Late') === '1',
    setting: response.headers.get('X-Ripnerf-Setting') ?? '',
    curve: response.headers.get('X-Ripnerf-Curve') ?? '',
  };
}

export const api = {
  info: (signal) => json('GET', 'v1/info', {signal}),
  /** By which files each layout of a dataset is recognised, in the order of precedence. */
  formats: (signal) => json('GET', 'v1/formats', {signal}),
  datasets: (signal) => list('v1/datasets', signal),
  dataset: (id, signal) => json('GET', `v1/datasets/${name(id)}`, {signal}),
  /** Cameras of all splits and scales. */
  cameras: async (id, signal) =>
      (await json('GET', `v1/datasets/${name(id)}/cameras`, {signal})).items,
  /** Sparse points: {count, items of x, y, z, red, green, blue}. */
  points: (id, signal) => json('GET', `v1/datasets/${name(id)}/points`, {signal}),
  photo: (id, split, index, scale, signal) =>
      blob(`v1/datasets/${name(id)}/images/${name(split)}/${index}?scale=${scale}`, {signal}),
  addDirectory: (body) => json('POST', 'v1/datasets', {json: body}),
  removeDataset: (id) => request('DELETE', `v1/datasets/${name(id)}`),
  scenes: (signal) => list('v1/scenes', signal),
  scene: (id, signal) => json('GET', `v1/scenes/${name(id)}`, {signal}),
  removeScene: (id) => request('DELETE', `v1/scenes/${name(id)}`),
  /** Where to begin to look: {camera, up}. */
  start: (id, signal) => json('GET', `v1/scenes/${name(id)}/start`, {signal}),
  curve: (id, signal) => json('GET', `v1/scenes/${name(id)}/curve`, {signal}),
  measureCurve: (id) => json('POST', `v1/scenes/${name(id)}/curve`, {json: {}}),
  effects: (id, signal) => json('GET', `v1/scenes/${name(id)}/effects`, {signal}),
  measureEffects: (id, options) =>
      json('POST', `v1/scenes/${name(id)}/effects`, {json: options}),
  /** Training steps that were not finite: {count, items of file, incident}. */
  incidents: (id, signal) => json('GET', `v1/scenes/${name(id)}/incidents`, {signal}),
  evaluations: (id, signal) => list(`v1/scenes/${name(id)}/evaluations`, signal),
  jobs: (signal) => list('v1/jobs', signal),
  job: (id, signal) => json('GET', `v1/jobs/${name(id)}`, {signal}),
  /** Held-out figures of a training job so far, oldest first. */
  metrics: async (id, signal) => (await json('GET', `v1/jobs/${name(id)}/metrics`, {signal})).items,
  /** What a ladder has found so far. */
  report: (id, signal) => json('GET', `v1/jobs/${name(id)}/report?format=json`, {signal}),
  submit: (body) => json(
      'POST', 'v1/jobs',
      {json: body, headers: {'Idempotency-Key': crypto.randomUUID?.() ?? String(Math.random())}}),
  act: (id, verb) => json('POST', `v1/jobs/${name(id)}/${verb}`),
  frames: (id, signal) => list(`v1/jobs/${name(id)}/frames`, signal),
  frame: (id, index, signal) => blob(`v1/jobs/${name(id)}/frames/${index}`, {signal}),
  /** The document of a path job's camera path. */
  pathOfJob: (id, signal) => json('GET', `v1/jobs/${name(id)}/camera-path`, {signal}),
  paths: (signal) => list('v1/camera-paths', signal),
  path: (id, signal) => json('GET', `v1/camera-paths/${name(id)}`, {signal}),
  /** Makes a token or a link; its secret is in this answer alone. */
  makeToken: (body) => json('POST', 'v1/tokens', {json: body}),
  savePath: (body) => json('POST', 'v1/camera-paths', {json: body}),
  convertPath: (body, signal) => json('POST', 'v1/camera-paths/convert', {json: body, signal}),
  removePath: (id) => request('DELETE', `v1/camera-paths/${name(id)}`),
  stream: (path, headers, signal) => request('GET', path, {headers, signal}),

  /** @returns {Promise<{blob: Blob, facts: ReturnType<typeof renderFacts>}>} */
  async render(id, body, signal) {
    const started = performance.now();
    const response = await request(
        'POST', `v1/scenes/${name(id)}/render`, {json: body, signal, repeatable: true});
    const picture = await response.blob();
    return {blob: picture, facts: renderFacts(response, started)};
  },

  /** A file to keep: a plain link where no token is needed, else fetched and handed over. */
  download: (path, options) => blob(path, options),

  /** Begins an upload of a tar; a name that is taken is refused here. */
  beginUpload: (body, signal) => json('POST', 'v1/uploads', {json: body, signal, repeatable: true}),
  upload: (id, signal) => json('GET', `v1/uploads/${name(id)}`, {signal}),
  dropUpload: (id) => request('DELETE', `v1/uploads/${name(id)}`, {keepalive: true}),
  /** Imports an upload that is whole; asked twice, the same job answers. */
  addUpload: (body, signal) => json('POST', 'v1/datasets', {json: body, signal, repeatable: true}),

  /** Sends a part of an upload, from `offset` on. */
  sendPart: (id, offset, part, onProgress, signal) => send(
      'PATCH', `v1/uploads/${name(id)}`,
      {'Content-Type': 'application/offset+octet-stream', 'Upload-Offset': String(offset)}, part,
      onProgress, signal),
  /** Sends a scene that was exported; the answer is its ingest job. */
  sendScene: (called, dataset, file, onProgress, signal) => send(
      'POST', `v1/scenes?name=${name(called)}${dataset ? `&dataset=${name(dataset)}` : ''}`,
      {'Content-Type': 'application/octet-stream'}, file, onProgress, signal),
};

/**
 * Sends bytes; the answer's JSON. XMLHttpRequest, because it alone reports what was sent.
 * @param {Blob} body @param {(sent: number) => void} onProgress @param {AbortSignal} signal
 */
function send(method, path, headers, body, onProgress, signal) {
  const used = token.get();
  return new Promise((resolve, reject) => {
    const call = new XMLHttpRequest();
    call.open(method, address(path));
    for (const [key, value] of Object.entries(withToken(headers))) call.setRequestHeader(key, value);
    call.upload.onprogress = (event) => onProgress(event.loaded);
    call.onerror = () => reject(new Unreachable());
    call.onabort = () => reject(new DOMException('upload cancelled', 'AbortError'));
    call.onload = async () => {
      if (call.status >= 200 && call.status < 300)
        resolve(parseJson(call.responseText));
      else if (call.status === 401 && await renewToken(used))
        resolve(send(method, path, headers, body, onProgress, signal));
      else
        reject(new Problem(call.status, parseJson(call.responseText)));
    };
    signal?.addEventListener('abort', () => call.abort(), {once: true});
    call.send(body);
  });
}

function parseJson(text) {
  try {
    return JSON.parse(text);
  } catch { return {}; }
}

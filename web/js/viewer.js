// Keeps a canvas showing a scene: coarse while the camera moves, refined when it rests. One request
// is under way at a time, and the latest camera wins.
import {Problem, Unreachable} from './api.js';
import {pictureOf} from './grey16.js';

const STILL_MS = 150;
const COARSE_MS = 60;       // what a coarse picture may take, answer included, two at a time
const COARSE_FLIGHTS = 2;   // one is rendered while the other is sent, decoded and drawn
const HALF_FIRST_MS = 500;  // a full picture that takes longer is preceded by one of half the size
const REFRESH_MS = 2000;    // while training; renders take at most about an eighth of the time
const EARLY_MS = 400;       // the same while a picture is of the first steps, which change most
const EARLY_STEPS = 300;
const [COARSE, HALF, FULL] = [0, 1, 2];
const TOLERANCE = [0.06, 0.03, 0];  // of each; pixels are worth more than their last half dB

const even = (x) => Math.max(8, 2 * Math.round(x / 2));

/**
 * Width and height with about `pixels` pixels in the full picture's shape.
 * @param {{width: number, height: number}} full @param {number} pixels
 */
export function sizeFor(full, pixels) {
  const k = Math.min(1, Math.sqrt(pixels / (full.width * full.height)));
  return {width: even(full.width * k), height: even(full.height * k)};
}

/** The next coarse picture's pixels, from what the last one took. */
export const nextBudget = (pixels, ms) =>
    Math.min(480 * 360, Math.max(64 * 48, pixels * Math.min(1.6, Math.max(0.5, COARSE_MS / ms))));

/**
 * @param {HTMLCanvasElement} canvas
 * @param {{camera: (width: number, height: number) => any, fullSize: () => {width: number, height:
 *     number},
 *   output: () => string, budgetMs: () => number|null, send: (body: any, signal: AbortSignal) => Promise<{blob: Blob, facts:
 * any}>, live: () => boolean, onPicture: (facts: any) => void, onTrouble: (trouble: Error|null) =>
 * void}} host
 * @param {AbortSignal} signal
 */
export function createViewer(canvas, host, signal) {
  let version = 0;
  let shown = {version: -1, level: -1};
  const flights = new Set();
  let movedAt = 0;
  let budget = 200 * 150;
  let msPerPixel = 0;
  let waitUntil = 0;
  let refreshAt = Infinity;
  let timer = 0;

  const poke = (ms) => {
    clearTimeout(timer);
    timer = setTimeout(pump, Math.max(0, ms));
  };

  function changed() {
    version++;
    movedAt = performance.now();
    dropRefinements();
    pump();
  }

  function dropRefinements() {
    for (const flight of flights)
      if (flight.level > COARSE) flight.stop.abort();
  }

  function nextLevel(now) {
    if (shown.version !== version) return COARSE;
    if (now - movedAt < STILL_MS) return null;
    const full = host.fullSize();
    if (shown.level === COARSE)
      return !host.budgetMs() && msPerPixel * full.width * full.height > HALF_FIRST_MS ? HALF : FULL;
    if (shown.level === HALF) return FULL;
    return host.live() && now >= refreshAt ? FULL : null;
  }

  function pump() {
    if (signal.aborted || document.hidden) return;
    // Only a camera that moved on since the last request is worth a second one.
    const last = [...flights].at(-1);
    if (last && (last.level > COARSE || last.version === version || flights.size >= COARSE_FLIGHTS))
      return;
    const now = performance.now();
    if (now < waitUntil) {
      poke(waitUntil - now);
      return;
    }
    const level = nextLevel(now);
    if (level !== null && (level === COARSE || !flights.size)) {
      fly(level);
      return;
    }
    if (now - movedAt < STILL_MS)
      poke(STILL_MS - (now - movedAt));
    else if (host.live())
      poke(refreshAt - now);
  }

  function requestFor(level) {
    const full = host.fullSize();
    const size = level === FULL ?
        full :
        sizeFor(full, level === HALF ? full.width * full.height / 4 : budget);
    const output = host.output();
    const lossy = level !== FULL && output === 'rgb';
    return {
      camera: host.camera(size.width, size.height),
      output,
      ...(level !== FULL        ? {supersample: 1, tolerance: TOLERANCE[level]} :
          host.budgetMs() && output === 'rgb' ? {within_ms: host.budgetMs()} :
                                                {}),
      ...(lossy ? {format: 'jpeg', jpeg_quality: level === COARSE ? 75 : 90} : {format: 'png'})
    };
  }

  async function fly(level) {
    const flight = {level, version, stop: new AbortController()};
    flights.add(flight);
    const body = requestFor(level);
    try {
      const {blob, facts} = await host.send(body, AbortSignal.any([flight.stop.signal, signal]));
      const picture = await pictureOf(blob, body.output);
      if (signal.aborted) return;
      if (flight.stop.signal.aborted) return picture.close();  // of what was asked for before
      learn(level, body.camera, facts);
      if (flight.version < shown.version) return picture.close();  // overtaken
      draw(canvas, picture);
      shown = {version: flight.version, level};
      host.onTrouble(null);
      host.onPicture({
        ...facts,
        width: body.camera.width,
        height: body.camera.height,
        level,
        bytes: blob.size
      });
    } catch (error) {
      if (signal.aborted) return;
      if (!flight.stop.signal.aborted) trouble(error);
    } finally {
      flights.delete(flight);
      if (!signal.aborted) poke(0);
    }
  }

  function learn(level, {width, height}, facts) {
    const spent = Number.isFinite(facts.renderMs) ? facts.renderMs : facts.totalMs;
    msPerPixel = spent / (width * height);
    if (level === COARSE) budget = nextBudget(budget, facts.totalMs);
    if (level !== FULL) return;
    const wait = facts.step < EARLY_STEPS ? EARLY_MS : REFRESH_MS;
    refreshAt = performance.now() + Math.max(wait, 8 * spent);
  }

  function trouble(error) {
    const wait = error instanceof Problem ? 1000 * (error.retryAfter || 2) :
        error instanceof Unreachable      ? 1500 :
                                            4000;
    waitUntil = performance.now() + wait;
    host.onTrouble(error);
  }

  document.addEventListener('visibilitychange', pump, {signal});
  signal.addEventListener('abort', () => clearTimeout(timer), {once: true});
  return {
    changed,
    /** What a pixel of the last picture took, ms; 0 before the first. */
    msPerPixel: () => msPerPixel,
    /** Draws again with the same camera: another output, another size, newer parameters. */
    refresh() {
      shown = {...shown, level: COARSE};
      movedAt = 0;
      waitUntil = 0;
      dropRefinements();
      pump();
    },
  };
}

function draw(canvas, picture) {
  const context = canvas.getContext('2d');
  context.imageSmoothingQuality = 'high';
  context.drawImage(picture, 0, 0, canvas.width, canvas.height);
  picture.close();
}

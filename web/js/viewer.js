// Keeps a canvas showing a scene: coarse while the camera moves, refined when it rests. The next
// picture is asked for, with the newest camera, once the one before is drawn: a daemon that is near
// often has the cores that the browser draws with. From afar it is asked for when the daemon should be
// done with the one before, and rendered while that is on its way.
import {Problem, Unreachable} from './api.js';
import {pictureOf} from './grey16.js';
import {opticsOfPicture} from './optics.js';

const STILL_MS = 50;  // from the last input to a finer picture, which the next one gives up
const COARSE_MS = 42;       // from an input to the answer with its coarse picture, nearly always
const LEAST_MS = 12;        // of it in rendering, however long its way is;
const WAY_SHARE = 0.25;     // and as much as this of a long way, which is hardly longer by it,
const MOST_MS = 60;         // up to so much
const LATE_MS = 1;          // that a movement is after its time
const MOST_AHEAD = 2;       // coarse pictures that are not answered yet
const FAR_MS = 20;          // on its way, of a coarse picture, from which on the daemon is far
const HALF_FIRST_MS = 500;  // a full picture that takes longer is preceded by one of half the size
const LENS_MS = 2500;       // a picture through a wide lens: as many cones as there is time for
const REFRESH_MS = 2000;    // while training; renders take at most about an eighth of the time
const EARLY_MS = 400;       // the same while a picture is of the first steps, which change most
const EARLY_STEPS = 300;  // a fog before the first of them, whose full picture takes the longest
const [COARSE, HALF, FULL] = [0, 1, 2];
const HALF_TOLERANCE = 0.03;
const SHARP = 640 * 480;  // pixels of a coarse picture, at most
const LEAST = 60 * 60;    // and at least

const even = (x) => Math.max(8, 2 * Math.round(x / 2));

/**
 * Width and height with about `pixels` pixels in the full picture's shape.
 * @param {{width: number, height: number}} full @param {number} pixels
 */
export function sizeFor(full, pixels) {
  const k = Math.min(1, Math.sqrt(pixels / (full.width * full.height)));
  return {width: even(full.width * k), height: even(full.height * k)};
}

/**
 * Size and tolerance of a coarse picture for so much effort, in pixels of tolerance 0.12. Of equally
 * quick pictures the nearest to the full one are of about that tolerance, whatever their size
 * (tests/bench/page.md).
 * @param {{width: number, height: number}} full @param {number} effort
 */
export function coarseOf(full, effort) {
  const most = Math.min(SHARP, full.width * full.height);
  return {
    ...sizeFor(full, Math.min(most, effort)),
    tolerance: Number(Math.max(0.03, 0.12 * Math.min(1, most / effort) ** 2).toFixed(3))
  };
}

const half = (full) =>
    ({...sizeFor(full, full.width * full.height / 4), tolerance: HALF_TOLERANCE});

/**
 * The next coarse picture's effort, from what the last one took: in all, and of that in rendering,
 * which is what fewer pixels make quicker; its way to the daemon and back they do not. An input that
 * just missed a picture waits for as long as that is rendered, and then for its own.
 */
export function nextEffort(effort, totalMs, renderMs) {
  const rendering = Math.max(0.1, Number.isFinite(renderMs) ? renderMs : totalMs);
  const way = Math.max(0, totalMs - rendering);
  const room =
      Math.max(LEAST_MS, (COARSE_MS - way) / 2, Math.min(MOST_MS, WAY_SHARE * way));
  const change = Math.min(1.4, Math.max(0.5, room / rendering) ** 0.6);
  return Math.min(2 * SHARP, Math.max(LEAST, effort * change));
}

/**
 * How long a coarse picture waits for a newer camera, ms, where movements come `apartMs` from each
 * other: for one that is nearer than the last, which came `ageMs` ago.
 */
export function untilNewer(ageMs, apartMs) {
  const comes = apartMs - ageMs;
  return comes > 0 && comes < ageMs ? comes + LATE_MS : 0;
}

/**
 * @param {HTMLCanvasElement} canvas
 * @param {{camera: (width: number, height: number) => any, fullSize: () => {width: number, height:
 *     number},
 *   optics?: () => any, at?: () => number|null, crop?: () => number[]|null, output: () => string, budgetMs: () => number|null, send: (body: any,
 * signal: AbortSignal) => Promise<{blob: Blob, facts: any}>, live: () => boolean, onPicture:
 * (facts: any) => void, onTrouble: (trouble: Error|null) => void}} host
 * @param {AbortSignal} signal
 */
export function createViewer(canvas, host, signal) {
  let version = 0;
  let shown = {version: -1, level: -1};
  const flights = new Set();
  let movedAt = 0;
  let apartMs = 0;  // movements of a drag, about
  let effort = 120 * 120;
  let msPerPixel = 0;
  let fullMsPerPixel = 0;
  let daemonMs = Infinity;  // what the last coarse picture took there; before one, no other is sent
  let wayMs = 0;  // of a coarse picture's time, not the daemon's
  let lastStep = NaN;  // of the picture that came last
  let waitUntil = 0;
  let refreshAt = Infinity;
  let timer = 0;

  const poke = (ms) => {
    clearTimeout(timer);
    timer = setTimeout(pump, Math.max(0, ms));
  };

  function changed() {
    version++;
    const now = performance.now();
    if (now - movedAt < STILL_MS) apartMs += ((now - movedAt) - apartMs) / (apartMs ? 8 : 1);
    movedAt = now;
    dropRefinements();
    pump();
  }

  function dropRefinements() {
    for (const flight of flights) {
      if (flight.level === COARSE) continue;
      flight.stop.abort();
      flights.delete(flight);  // nothing waits until it is over
    }
  }

  function nextLevel(now) {
    if (shown.version !== version) return COARSE;
    if (now - movedAt < STILL_MS) return null;
    if (lastStep === 0 && host.live()) return now >= refreshAt ? COARSE : null;
    const full = host.fullSize();
    if (shown.level === COARSE)
      return !host.budgetMs() && msPerPixel * full.width * full.height > HALF_FIRST_MS ? HALF :
                                                                                         FULL;
    if (shown.level === HALF) return FULL;
    return host.live() && now >= refreshAt ? FULL : null;
  }

  function pump() {
    if (signal.aborted || document.hidden) return;
    // Only a camera that moved on since the last request is worth a second one.
    const last = [...flights].at(-1);
    if (last && (last.level > COARSE || last.version === version)) return;
    const now = performance.now();
    if (last && wayMs < FAR_MS) return;
    if (last && !last.answered) {
      if ([...flights].filter((flight) => !flight.answered).length === MOST_AHEAD) return;
      const left = last.sentAt + daemonMs - now;
      if (left > 0) {
        if (left < Infinity) poke(left);
        return;
      }
    }
    if (now < waitUntil) {
      poke(waitUntil - now);
      return;
    }
    const level = nextLevel(now);
    const soonMs = level === COARSE ? untilNewer(now - movedAt, apartMs) : 0;
    if (soonMs > 0) {
      poke(soonMs);
      return;
    }
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
    const {tolerance, ...size} = level === FULL ? full :
        level === HALF                          ? half(full) :
                                                  coarseOf(full, effort);
    const output = host.output();
    const lossy = level !== FULL && output === 'rgb';
    const optics = opticsOfPicture(host.optics?.(), level === FULL);
    const at = host.at?.() ?? null;
    const crop = host.crop?.() ?? null;
    const withinMs = at ? null : host.budgetMs() ?? (optics.aperture ? LENS_MS : null);
    return {
      camera: host.camera(size.width, size.height),
      output,
      ...(at ? {at} : {}),
      ...(crop ? {crop} : {}),
      ...(level !== FULL                   ? {supersample: 1, tolerance} :
              withinMs && output === 'rgb' ? {within_ms: withinMs} :
                                             {}),
      ...(Object.keys(optics).length ? {optics} : {}),
      ...(lossy ? {format: 'jpeg', jpeg_quality: level === COARSE ? 88 : 90} : {format: 'png'})
    };
  }

  async function fly(level) {
    const flight = {
      level,
      version,
      sentAt: performance.now(),
      answered: false,
      stop: new AbortController()
    };
    flights.add(flight);
    const body = requestFor(level);
    try {
      const {blob, facts} = await host.send(body, AbortSignal.any([flight.stop.signal, signal]));
      flight.answered = true;
      if (level === COARSE) {
        learn(level, body.camera, facts);
        pump();
      }
      const {picture, scale} = await pictureOf(blob, body.output);
      // Nobody looks any more, or it is of what was asked for before.
      if (signal.aborted || flight.stop.signal.aborted) return picture.close();
      if (level > COARSE) learn(level, body.camera, facts);
      if (flight.version < shown.version) return picture.close();  // overtaken
      draw(canvas, picture, level === COARSE ? 'low' : 'high');
      shown = {version: flight.version, level};
      host.onTrouble(null);
      host.onPicture({
        ...facts,
        width: body.camera.width,
        height: body.camera.height,
        level,
        output: body.output,
        scale: facts.scale || scale,
        blob
      });
    } catch (error) {
      if (signal.aborted) return;
      if (!flight.stop.signal.aborted) trouble(error);
    } finally {
      flights.delete(flight);
      if (!signal.aborted) pump();
    }
  }

  function learn(level, {width, height}, facts) {
    const spent = Number.isFinite(facts.renderMs) ? facts.renderMs : facts.totalMs;
    msPerPixel = spent / (width * height);
    if (level === FULL) fullMsPerPixel = msPerPixel;
    lastStep = facts.step;
    if (level === COARSE) {
      effort = nextEffort(effort, facts.totalMs, facts.renderMs);
      const there = facts.queueMs + facts.renderMs + facts.encodeMs;
      daemonMs = Number.isFinite(there) ? there : Infinity;
      if (there < facts.totalMs) wayMs += (facts.totalMs - there - wayMs) / 4;
    }
    if (level !== FULL && lastStep !== 0) return;
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
    /** What a pixel of the last refined picture took, ms; 0 before the first. */
    msPerPixel: () => fullMsPerPixel,
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

/** `smoothing`: low is a quarter of high's time, and enlarges as well to 0.3 dB. */
function draw(canvas, picture, smoothing) {
  const context = canvas.getContext('2d', {alpha: false});  // put on the page without blending
  context.imageSmoothingQuality = smoothing;
  context.drawImage(picture, 0, 0, canvas.width, canvas.height);
  picture.close();
}

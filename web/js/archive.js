// Archives as folders: the files of a zip, a tar or a tar.gz. What lies in one as it is stays a part of
// it; what is compressed is unpacked by the browser.

const MOST_FILES = 100_000;
const MOST_DIRECTORY = 64 << 20;  // bytes of a zip's list of files
const BLOCK = 512;                // of a tar
const END = 0x06054b50, END64 = 0x06064b50, LOCATOR64 = 0x07064b50;  // records of a zip
const ENTRY = 0x02014b50, LOCAL = 0x04034b50;
const FULL = 0xffffffff;  // a number that stands in the record of 64 bits

const decoder = new TextDecoder();
const wrong = (file, why) => new Error(`${file.name} ${why}`);
const damaged = (file) => wrong(file, 'is damaged or cut off.');

export const isArchive = (name) => /\.(zip|tar|tgz|tar\.gz)$/i.test(name);

async function viewOf(file, from, size) {
  if (!(from >= 0 && size >= 0 && from + size <= file.size)) throw damaged(file);
  return new DataView(await file.slice(from, from + size).arrayBuffer());
}

const textOf = (view, from, size) =>
    decoder.decode(new Uint8Array(view.buffer, view.byteOffset + from, size));

/** What a compressed part holds; `size`: as many bytes as it says, null where it does not. */
async function inflate(file, part, kind, size = null) {
  let seen = 0;
  const counted = new TransformStream({
    transform(chunk, out) {
      seen += chunk.length;
      if (size !== null && seen > size) throw damaged(file);
      out.enqueue(chunk);
    }
  });
  const stream = part.stream().pipeThrough(new DecompressionStream(kind)).pipeThrough(counted);
  const whole = await new Response(stream).blob().catch(() => null);
  if (!whole || size !== null && whole.size !== size) throw damaged(file);
  return whole;
}

// ---- zip ----

/** Where a zip's list of files lies, and how many they are. */
async function directoryOf(file) {
  const tail = Math.min(file.size, 22 + 0xffff);
  const view = await viewOf(file, file.size - tail, tail);
  let at = tail - 22;
  while (at >= 0 && view.getUint32(at, true) !== END) at--;
  if (at < 0) throw damaged(file);
  const found = {
    count: view.getUint16(at + 10, true),
    size: view.getUint32(at + 12, true),
    from: view.getUint32(at + 16, true)
  };
  if (found.from !== FULL && found.count !== 0xffff) return found;
  if (at < 20 || view.getUint32(at - 20, true) !== LOCATOR64) return found;
  const end = await viewOf(file, Number(view.getBigUint64(at - 12, true)), 56);
  if (end.getUint32(0, true) !== END64) throw damaged(file);
  const [count, size, from] = [32, 40, 48].map((place) => Number(end.getBigUint64(place, true)));
  return {count, size, from};
}

/** Sizes and place of an entry at `at`, from its record of 64 bits where they are too large. */
function numbersOf(view, at, names, extras) {
  const found = {
    size: view.getUint32(at + 24, true),
    packed: view.getUint32(at + 20, true),
    from: view.getUint32(at + 42, true)
  };
  for (let p = at + 46 + names, end = p + extras; p + 4 <= end;) {
    const [id, length] = [view.getUint16(p, true), view.getUint16(p + 2, true)];
    let place = p + 4;
    for (const key of id === 1 ? ['size', 'packed', 'from'] : [])
      if (found[key] === FULL && place + 8 <= p + 4 + length) {
        found[key] = Number(view.getBigUint64(place, true));
        place += 8;
      }
    p += 4 + length;
  }
  return found;
}

async function* filesOfZip(file) {
  const {count, size, from} = await directoryOf(file);
  if (size > MOST_DIRECTORY) throw wrong(file, 'holds too many files.');
  const view = await viewOf(file, from, size);
  for (let i = 0, at = 0; i < count; i++) {
    if (at + 46 > size || view.getUint32(at, true) !== ENTRY) throw damaged(file);
    const [names, extras, words] = [28, 30, 32].map((place) => view.getUint16(at + place, true));
    if (at + 46 + names + extras > size) throw damaged(file);
    const entry = {
      path: textOf(view, at + 46, names).replaceAll('\\', '/'),
      locked: view.getUint16(at + 8, true) & 1,
      method: view.getUint16(at + 10, true),
      ...numbersOf(view, at, names, extras)
    };
    at += 46 + names + extras + words;
    if (!entry.path.endsWith('/')) yield {path: entry.path, open: () => openZipped(file, entry)};
  }
}

async function openZipped(file, {path, locked, method, size, packed, from}) {
  if (locked) throw wrong(file, `is encrypted (${path}).`);
  if (method !== 0 && method !== 8)
    throw wrong(file, `is compressed in a way that browsers cannot undo (${path}): unpack it first.`);
  const head = await viewOf(file, from, 30);
  if (head.getUint32(0, true) !== LOCAL) throw damaged(file);
  const start = from + 30 + head.getUint16(26, true) + head.getUint16(28, true);
  if (start + packed > file.size || method === 0 && packed !== size) throw damaged(file);
  const part = file.slice(start, start + packed);
  return method ? inflate(file, part, 'deflate-raw', size) : part;
}

// ---- tar ----

/** A number of a tar's header: octal digits, or bytes where the first bit is set. */
function numberAt(view, at, size) {
  if (view.getUint8(at) & 0x80) return Number(view.getBigUint64(at + size - 8));
  return parseInt(textOf(view, at, size).replace(/\0.*$/s, '').trim() || '0', 8);
}
const wordAt = (view, at, size) => textOf(view, at, size).replace(/\0.*$/s, '');

/** The path that a header of the "pax" kind gives to the file behind it. */
const paxPath = (text) => /(?:^|\n)\d+ path=([^\n]*)\n/.exec(text)?.[1];

async function* filesOfTar(file, tar) {
  let long = null;  // the next file's name, where it is too long for its header
  for (let at = 0; at + BLOCK <= tar.size;) {
    const head = new DataView(await tar.slice(at, at + BLOCK).arrayBuffer());
    const name = wordAt(head, 0, 100);
    if (!name && !head.getUint8(156)) return;
    const size = numberAt(head, 124, 12);
    const part = tar.slice(at + BLOCK, at + BLOCK + size);
    if (!Number.isSafeInteger(size) || part.size !== size) throw damaged(file);
    const kind = String.fromCharCode(head.getUint8(156)).replace('\0', '0');
    const before = textOf(head, 257, 5) === 'ustar' ? wordAt(head, 345, 155) : '';
    if (kind === 'L') long = (await part.text()).replace(/\0.*$/s, '');
    if (kind === 'x') long = paxPath(await part.text()) ?? long;
    if (kind === '0') {
      const path = long ?? (before ? `${before}/${name}` : name);
      yield {path, open: async () => part};
    }
    if (!'Lx'.includes(kind)) long = null;
    at += BLOCK + BLOCK * Math.ceil(size / BLOCK);
  }
  throw damaged(file);
}

/**
 * The files of an archive, as if its folder had been chosen: in a folder of the archive's name.
 * @param {File} file @param {(count: number) => void} onProgress so many are there
 * @returns {Promise<import('./folder.js').Entry[]>}
 */
export async function entriesOfArchive(file, onProgress) {
  const name = file.name.replace(/\.(zip|tar|tgz|tar\.gz)$/i, '');
  const zipped = /\.zip$/i.test(file.name);
  const packed = /gz$/i.test(file.name);
  const files = zipped ? filesOfZip(file) :
                         filesOfTar(file, packed ? await inflate(file, file, 'gzip') : file);
  const entries = [];
  for await (const {path, open} of files) {
    if (/(^|\/)(__MACOSX\/|\._)/.test(path)) continue;  // what a Mac adds of its own
    if (entries.length === MOST_FILES) throw wrong(file, 'holds too many files.');
    entries.push({path: `${name}/${path.replace(/^(\.?\/)+/, '')}`, file: await open()});
    onProgress(entries.length);
  }
  return entries;
}

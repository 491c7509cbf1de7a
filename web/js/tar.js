// A plain POSIX tar made of files without reading them: headers and padding around file references.

const BLOCK = 512;
const encoder = new TextEncoder();

/** Writes `value` as octal digits and a NUL into `size` bytes at `at`. */
function octal(header, at, size, value) {
  const digits = value.toString(8).padStart(size - 1, '0');
  if (digits.length >= size) throw new RangeError(`${value} does not fit a tar header`);
  header.set(encoder.encode(digits), at);
}

/** Splits a name at a slash into prefix (at most 155 bytes) and name (at most 100). */
function splitName(bytes) {
  if (bytes.length <= 100) return {prefix: new Uint8Array(), name: bytes};
  for (let at = bytes.length - 101; at < bytes.length && at <= 155; at++) {
    if (bytes[at] === 0x2f && at > 0)
      return {prefix: bytes.slice(0, at), name: bytes.slice(at + 1)};
  }
  return null;
}

function header(name, size, type, modifiedS) {
  const block = new Uint8Array(BLOCK);
  const parts = splitName(encoder.encode(name));
  if (!parts) throw new RangeError(`${name}: the name is too long for a tar`);
  block.set(parts.name, 0);
  octal(block, 100, 8, 0o644);
  octal(block, 108, 8, 0);
  octal(block, 116, 8, 0);
  octal(block, 124, 12, size);
  octal(block, 136, 12, modifiedS);
  block.fill(0x20, 148, 156);
  block[156] = type.charCodeAt(0);
  block.set(encoder.encode('ustar\u000000'), 257);
  block.set(parts.prefix, 345);
  octal(block, 148, 7, block.reduce((sum, byte) => sum + byte, 0));
  return block;
}

/**
 * The header of one regular file, 512 bytes.
 * @param {string} name relative, with slashes; at most 255 bytes that split at a slash
 * @param {number} size in bytes
 * @param {number} [modifiedS] seconds since 1970
 */
export const tarHeader = (name, size, modifiedS = 0) => header(name, size, '0', modifiedS);

/**
 * @param {{path: string, file: Blob}[]} entries
 * @returns {Blob} the archive; it refers to the files, which are read while it is sent
 */
export function tarOf(entries) {
  const parts = [];
  for (const {path, file} of entries) {
    parts.push(tarHeader(path, file.size), file);
    const rest = file.size % BLOCK;
    if (rest) parts.push(new Uint8Array(BLOCK - rest));
  }
  parts.push(new Uint8Array(2 * BLOCK));
  return new Blob(parts, {type: 'application/x-tar'});
}

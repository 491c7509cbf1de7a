// 16-bit grey PNG, read in full: a browser's own decoder keeps only the upper eight bits.

const CHUNKS_AT = 8;

/**
 * @param {Uint8Array} bytes @returns {{width: number, height: number, packed: Blob}|null} null
 *     when not 16-bit grey
 */
function open(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const parts = [];
  let size = null;
  let scale = NaN;
  for (let at = CHUNKS_AT; at + 12 <= bytes.length;) {
    const length = view.getUint32(at);
    const type = String.fromCharCode(...bytes.subarray(at + 4, at + 8));
    const body = bytes.subarray(at + 8, at + 8 + length);
    if (type === 'IHDR') {
      if (body[8] !== 16 || body[9] !== 0 || body[12] !== 0) return null;
      size = {width: view.getUint32(at + 8), height: view.getUint32(at + 12)};
    }
    if (type === 'tEXt') {
      const [key, value] = new TextDecoder('latin1').decode(body).split('\0');
      if (key === 'ripnerf:depth_scale') scale = Number(value);
    }
    if (type === 'IDAT') parts.push(body);
    at += 12 + length;
  }
  return size && {...size, scale, packed: new Blob(parts)};
}

const paeth = (a, b, c) => {
  const [pa, pb, pc] = [Math.abs(b - c), Math.abs(a - c), Math.abs(a + b - 2 * c)];
  return pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
};

/** Undoes a row's filter in place (PNG, section 9); two bytes a pixel. */
function unfilter(kind, row, above) {
  for (let i = 0; i < row.length; i++) {
    const left = i < 2 ? 0 : row[i - 2];
    const up = above ? above[i] : 0;
    const corner = above && i >= 2 ? above[i - 2] : 0;
    row[i] += [0, left, up, (left + up) >> 1, paeth(left, up, corner)][kind];
  }
}

/**
 * @param {Blob} blob
 * @returns {Promise<{width: number, height: number, values: Uint16Array, scale: number}|null>} null
 *     when it is another kind of picture; scale: dataset units that 65535 stands for
 */
export async function readGrey16(blob) {
  const png = open(new Uint8Array(await blob.arrayBuffer()));
  if (!png) return null;
  const stream = png.packed.stream().pipeThrough(new DecompressionStream('deflate'));
  const raw = new Uint8Array(await new Response(stream).arrayBuffer());
  const stride = 2 * png.width;
  const values = new Uint16Array(png.width * png.height);
  let above = null;
  for (let y = 0; y < png.height; y++) {
    const start = y * (stride + 1);
    const row = raw.subarray(start + 1, start + 1 + stride);
    unfilter(raw[start], row, above);
    for (let x = 0; x < png.width; x++)
      values[y * png.width + x] = (row[2 * x] << 8) | row[2 * x + 1];
    above = row;
  }
  return {width: png.width, height: png.height, values, scale: png.scale};
}

/**
 * Depth for the eye: near is bright, far is dark, 0 (nothing hit) is black; `range` is of the nearest
 * and the farthest, 0 to 65535, null where nothing was hit.
 * @param {{width: number, height: number, values: Uint16Array}} depth
 */
export function depthImage({width, height, values}) {
  let [low, high] = [65535, 0];
  for (const value of values)
    if (value) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  const image = new ImageData(width, height);
  const gain = 205 / Math.max(1, high - low);
  values.forEach((value, i) => {
    image.data.fill(value ? 50 + (high - value) * gain : 0, 4 * i, 4 * i + 3);
    image.data[4 * i + 3] = 255;
  });
  return {image, range: high >= low ? [low, high] : null};
}

/**
 * A picture to draw, depth stretched for the eye; `scale` tells from what to what it is, as the
 * header X-Ripnerf-Scale does: "1.2 4.5 dataset units". @param {Blob} blob @param {string} output
 * rgb, depth, alpha … @returns {Promise<{picture: ImageBitmap, scale: string}>}
 */
export async function pictureOf(blob, output) {
  const depth = output === 'depth' ? await readGrey16(blob) : null;
  if (!depth) return {picture: await createImageBitmap(blob), scale: ''};
  const {image, range} = depthImage(depth);
  const told = (value) => Number(((value / 65535) * depth.scale).toPrecision(3));
  return {
    picture: await createImageBitmap(image),
    scale: range && depth.scale > 0 ? `${range.map(told).join(' ')} dataset units` : ''
  };
}

// How two pictures of the same size differ, as a picture.

/** A difference of -255 .. 255 as a colour: red where the second is lighter, blue where darker. */
export function signedColour(d) {
  const x = Math.max(-1, Math.min(1, (4 * d) / 255));
  const rest = Math.round(255 * (1 - Math.abs(x)));
  return x > 0 ? [255, rest, rest] : [rest, rest, 255];
}

/** An error of 0 .. 255 as a colour: black, through red and yellow, to white at a quarter. */
export function errorColour(e) {
  const x = Math.min(1, (4 * e) / 255) * 3;
  return [0, 1, 2].map((c) => Math.round(255 * Math.max(0, Math.min(1, x - c))));
}

/**
 * Pixel by pixel over RGBA arrays: 'signed' by the mean of the channels, 'error' by the root of
 * their mean square. Also the PSNR in dB, null of equal pictures.
 * @param {Uint8ClampedArray} a @param {Uint8ClampedArray} b @param {'signed'|'error'} kind
 */
export function differenceOf(a, b, kind) {
  const out = new Uint8ClampedArray(a.length);
  let squares = 0;
  for (let i = 0; i < a.length; i += 4) {
    let [sum, square] = [0, 0];
    for (let c = 0; c < 3; c++) {
      const d = b[i + c] - a[i + c];
      sum += d / 3;
      square += (d * d) / 3;
    }
    squares += square;
    out.set(kind === 'signed' ? signedColour(sum) : errorColour(Math.sqrt(square)), i);
    out[i + 3] = 255;
  }
  const mean = squares / (a.length / 4);
  return {pixels: out, psnr: mean > 0 ? 10 * Math.log10((255 * 255) / mean) : null};
}

/** What lies under a picture, and the picture over its background, at the smaller one's size. */
function alike(image, under, background) {
  const [width, height] = under instanceof HTMLImageElement ?
      [under.naturalWidth, under.naturalHeight] :
      [image.naturalWidth, image.naturalHeight];
  const [at, box] = [image.getBoundingClientRect(), under.getBoundingClientRect()];
  const scale = (under.naturalWidth || under.width) / box.width;
  return [
    (context) => {
      context.fillStyle = background;
      context.fillRect(0, 0, width, height);
      context.drawImage(image, 0, 0, width, height);
    },
    (context) => context.drawImage(
        under, (at.left - box.left) * scale, (at.top - box.top) * scale, at.width * scale,
        at.height * scale, 0, 0, width, height)
  ].map((draw) => {
    const context = new OffscreenCanvas(width, height).getContext('2d', {willReadFrequently: true});
    context.imageSmoothingQuality = 'high';
    draw(context);
    return context.getImageData(0, 0, width, height);
  });
}

/** A picture that lies over a canvas or another picture against what it covers: the map, and the PSNR. */
export async function differenceMap(image, under, background, kind) {
  const [over, below] = alike(image, under, background);
  const {pixels, psnr} = differenceOf(over.data, below.data, kind);
  const room = new OffscreenCanvas(over.width, over.height);
  room.getContext('2d').putImageData(new ImageData(pixels, over.width, over.height), 0, 0);
  return {blob: await room.convertToBlob({type: 'image/png'}), psnr};
}

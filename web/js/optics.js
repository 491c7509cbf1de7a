// Effects of the camera that keys of a path may ask for, as the daemon names them.

/** Name, label, unit and step of each; 0 is none. */
export const OPTICS = [
  ['aperture', 'Aperture', 'width', 0.05], ['focus', 'Focus', 'away', 0.1],
  ['shutter', 'Shutter', 'of a frame', 0.1], ['exposure', 'Exposure', 'stops', 0.25],
  ['white_balance', 'White balance', 'K', 100], ['ortho_height', 'Parallel, height', '', 0.1]
];
const DAYLIGHT_K = 6504;

/** Those of `values` that are not none. */
export const opticsOf = (values) => Object.fromEntries(
    OPTICS.map(([name]) => [name, Number(values?.[name])]).filter(([, value]) => value));

/** What any of the keys asks for, in words without units: "0.1", "off to 0.1". */
export const effectsOfKeys = (keys) => Object.fromEntries(
    OPTICS.map(([name]) => {
      const values = keys.map((key) => Number(key[name]) || 0).sort((a, b) => a - b);
      return [name, [...new Set([values[0], values.at(-1)])].map((x) => x || 'off').join(' to ')];
    }).filter(([, words]) => words !== 'off'));

/** Between two keys' effects, as the daemon goes over from one to the other. */
export function blendOptics(a, b, u) {
  const mix = (p, q) => p + (q - p) * u;
  const either = (name, none) => {
    const [p, q] = [a?.[name] || 0, b?.[name] || 0];
    return p || q ? mix(p || none || q, q || none || p) : 0;
  };
  return opticsOf({
    aperture: mix(a?.aperture || 0, b?.aperture || 0),
    focus: either('focus'),
    shutter: mix(a?.shutter || 0, b?.shutter || 0),
    exposure: mix(a?.exposure || 0, b?.exposure || 0),
    white_balance: either('white_balance', DAYLIGHT_K),
    ortho_height: either('ortho_height'),
  });
}

/** What of a key's effects a single picture shows; those that need many cones only when asked. */
export function opticsOfPicture(optics, refined) {
  const {shutter, aperture, focus, ...cheap} = opticsOf(optics);
  return refined && aperture && focus ? {...cheap, aperture, focus} : cheap;
}

/** Why the daemon would refuse a key's effects, or null. */
export function problemOfOptics(optics) {
  const {
    aperture = 0,
    focus = 0,
    shutter = 0,
    exposure = 0,
    white_balance: white = 0,
    ortho_height: height = 0
  } = optics ?? {};
  if (aperture < 0 || focus < 0 || height < 0) return 'lengths cannot be negative.';
  if (aperture && !focus) return 'an aperture needs a focus: how far away what is sharp lies.';
  if (shutter && !(shutter >= 0.001 && shutter <= 1))
    return 'the shutter is a share of a frame, 0 to 1.';
  if (!(exposure >= -20 && exposure <= 20))
    return 'the exposure must lie between -20 and 20 stops.';
  if (white && !(white >= 1700 && white <= 25000))
    return 'the white balance must lie between 1700 and 25000 K.';
  return null;
}

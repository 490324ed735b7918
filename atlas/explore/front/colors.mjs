// Computes the colours of cells from their codes and numbers, equal to the bit to those of atlas.render.layers.paint.

export const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
export const pixel = ([r, g, b]) => (0xff000000 | (b << 16) | (g << 8) | r) >>> 0;

/** Return the position of a number on a colorbar with these limits: 0 to 1, less or more outside the limits. */
export function shareOf(bar, [low, high], value) {
  if (bar.scale === "two-sided") return value < 0 ? (0.5 / -low) * (value - low) : (0.5 / high) * value + 0.5;
  if (bar.scale !== "log") return high === low ? 0 : (value - low) / (high - low);
  const least = Math.log10(low);
  return (Math.log10(Math.max(value || bar.zero, low)) - least) / (Math.log10(high) - least);
}

/** Return true if a colorbar can have these limits on its scale. */
export function fits(bar, [low, high]) {
  if (!(low < high)) return false;
  return bar.scale === "log" ? low > 0 : bar.scale !== "two-sided" || (low < 0 && high > 0);
}

/** Return the limits of a colorbar: those requested if they are possible, its own where a requested limit is null. */
export function endsOf(bar, asked) {
  const own = bar.ends, ends = asked ? own.map((end, k) => asked[k] ?? end) : own;
  return fits(bar, ends) ? ends : own;
}

const STEPS = 512;
const placed = (share, count) => Math.min(count - 1, Math.max(0, Math.floor(share * count)));

/** Return the colours of a colorbar as pixels, from the lower limit to the upper. */
export function tableOf(bar, [low, high]) {
  const table = (hex) => Uint32Array.from(hex.match(/.{6}/g), (color) => pixel(rgb(`#${color}`)));
  if (!bar.both || !(low < 0 && high > 0)) return table(bar.colors);
  const both = table(bar.both), most = Math.max(-low, high), step = (high - low) / (STEPS - 1);
  return Uint32Array.from({ length: STEPS }, (_, k) => {
    const value = k < STEPS - 1 ? k * step + low : high;
    return both[placed(0.5 + 0.5 * (value / most), both.length)];
  });
}

/** Return a function that gives the colour, as a pixel, of a number on a colorbar with these limits. */
export function coloring(bar, ends) {
  const table = tableOf(bar, ends);
  return (value) => table[placed(shareOf(bar, ends, Math.max(value, bar.scale === "log" ? 0 : ends[0])), table.length)];
}

function shadeOf({ variable, low, high, dark }, values) {
  const share = (value) => Math.min(1, Math.max(0, (value - low) / Math.max(high - low, 1)));
  return (k) => 1 - (1 - dark) * share(values[variable][k]);
}

/** Return the pixel of each cell of a map: the colour of its code, or of its number between the requested limits. */
export function colorsOf(map, codes, values, asked) {
  const colors = new Uint32Array(codes.length), brightness = map.shade && shadeOf(map.shade, values);
  const flat = map.entries.map((entry) => (entry.color ? pixel(rgb(entry.color)) : 0));
  const colorOf = map.bar && coloring(map.bar, endsOf(map.bar, asked)), numbers = map.bar && values[map.bar.variable];
  for (let k = 0; k < codes.length; k++) {
    const code = codes[k], entry = map.entries[code];
    if (entry.byNumber) colors[k] = colorOf(numbers[k]);
    else if (entry.shaded) colors[k] = pixel(rgb(entry.color).map((part) => Math.floor(part * brightness(k))));
    else colors[k] = flat[code];
  }
  return colors;
}

/** Return true if a hatch covers the point (x, y) of its pattern, which repeats after `size` pixels. */
export function inkedBy(hatch, x, y, size, width) {
  const near = (value) => ((value % size) + size) % size < width;
  const square = (x - size / 2) ** 2 + (y - size / 2) ** 2;
  return { "/": near(x + y), "\\": near(x - y), x: near(x + y) || near(x - y), "+": near(x) || near(y),
    "-": near(y), "|": near(x), ".": square < width ** 2 }[hatch];
}

/** Return the hatches of a map's entries: the size of a pattern, and the mask and colour of each entry. */
export function texturesOf(entries, ratio) {
  const size = Math.round(8 * ratio);
  const masks = entries.map(({ hatch }) => hatch && Uint8Array.from({ length: size * size }, (_, k) =>
    inkedBy(hatch, k % size, Math.floor(k / size), size, 0.9 * ratio)));
  return { size, masks, inks: entries.map(({ ink }) => (ink ? pixel(rgb(ink)) : 0)) };
}

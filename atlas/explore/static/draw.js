"use strict";
// The page of an atlas: it draws the map of the cells in any window, reads cells out and keeps the view in the address.

const by = (id) => document.getElementById(id);
const atlas = JSON.parse(by("atlas").textContent);
const { regime: REGIME, pending: PENDING, reason: REASON, largest: LARGEST, error: ERROR } = atlas.special;
const axes = atlas.axes.map((axis) => {
  const to = axis.log ? Math.log : (value) => value;
  return { ...axis, to, from: axis.log ? Math.exp : (value) => value, cuts: axis.edges.map(to) };
});
const [X, Y] = axes;
const NX = X.values.length;
const isCoarse = Math.max(...atlas.block) > 1;
const map = by("map"), pen = map.getContext("2d");
const whole = () => axes.map(({ cuts }) => [cuts[0], cuts[cuts.length - 1]]);

// What is shown: all that the address holds. Everything on the page follows from it.
let state = { map: atlas.maps[0], window: whole(), cell: null, ends: null, hidden: new Set() };
let shown = null; // a map, the arrays and the colours of its cells: state.map once these are read
let plot = { left: 0, top: 8, width: 1, height: 1 };

// Numbers of the cells, see numbers.py

const TYPES = { float64: Float64Array, int32: Int32Array, int8: Int8Array, uint8: Uint8Array, uint16: Uint16Array };
const read = new Map();

function numbers(name) {
  if (!read.has(name)) read.set(name, unpacked(name));
  return read.get(name);
}

async function unpacked(name) {
  const text = atob(by(name).textContent), packed = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) packed[k] = text.charCodeAt(k);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const Type = TYPES[atlas.arrays[name].type], size = Type.BYTES_PER_ELEMENT, count = planes.length / size;
  const bytes = new Uint8Array(planes.length);
  for (let plane = 0, at = 0; plane < size; plane++) for (let k = plane; k < bytes.length; k += size) bytes[k] = planes[at++];
  summed(bytes, size, count);
  return new Type(bytes.buffer);
}

function summed(bytes, size, count) {
  if (size < 8) {
    const whole = new { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array }[size](bytes.buffer);
    for (let k = NX; k < count; k++) whole[k] += whole[k - NX];
    return;
  }
  const half = new Uint32Array(bytes.buffer); // the lower half of each number first
  for (let k = 2 * NX; k < 2 * count; k += 2) {
    const low = half[k] + half[k - 2 * NX];
    half[k + 1] += half[k + 1 - 2 * NX] + (low > 0xffffffff ? 1 : 0);
    half[k] = low;
  }
}

// Colours

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
const pixel = ([r, g, b]) => (0xff000000 | (b << 16) | (g << 8) | r) >>> 0;
const scaleEnds = (bar) => (state.ends && state.map.bars.length === 1 ? state.ends : bar.ends);

function shareOf(bar, [low, high], value) {
  if (bar.scale === "two-sided") return value < 0 ? 0.5 - (0.5 * value) / low : 0.5 + (0.5 * value) / high;
  if (bar.scale === "log") return Math.log(Math.max(value || bar.zero, low) / low) / Math.log(high / low);
  return (value - low) / (high - low);
}

function tableOf(bar) {
  const parts = bar.colors.match(/.{6}/g).map((color) => pixel(rgb(`#${color}`)));
  return Uint32Array.from(parts);
}

function brightnessOf({ variable, low, high, dark }, values) {
  const share = (value) => Math.min(1, Math.max(0, (value - low) / Math.max(high - low, 1)));
  return (k) => 1 - (1 - dark) * share(values[variable][k]);
}

function colorsOf(one, codes, values) {
  const colors = new Uint32Array(codes.length), brightness = one.shade && brightnessOf(one.shade, values);
  const flat = one.entries.map((entry) => (entry.color ? pixel(rgb(entry.color)) : 0));
  const bars = one.bars.map((bar) => ({ ...bar, table: tableOf(bar), range: scaleEnds(bar) }));
  for (let k = 0; k < codes.length; k++) {
    const entry = one.entries[codes[k]], bar = bars[entry.bar];
    if (entry.shaded) colors[k] = pixel(rgb(entry.color).map((channel) => Math.floor(channel * brightness(k))));
    else if (!bar) colors[k] = flat[codes[k]];
    else {
      const share = Math.min(1, Math.max(0, shareOf(bar, bar.range, values[bar.variable][k])));
      colors[k] = bar.table[Math.min(bar.table.length - 1, Math.floor(share * bar.table.length))];
    }
  }
  return colors;
}

function inkedBy(hatch, x, y, size, width) {
  const near = (value) => ((value % size) + size) % size < width;
  const square = (x - size / 2) ** 2 + (y - size / 2) ** 2;
  return { "/": near(x + y), "\\": near(x - y), x: near(x + y) || near(x - y), "+": near(x) || near(y),
    "-": near(y), "|": near(x), ".": square < width ** 2 }[hatch];
}

function texturesOf(entries, ratio) {
  const size = Math.round(8 * ratio);
  const masks = entries.map(({ hatch }) => hatch && Uint8Array.from({ length: size * size }, (_, k) =>
    inkedBy(hatch, k % size, Math.floor(k / size), size, 0.9 * ratio)));
  return { size, masks, inks: entries.map(({ ink }) => (ink ? pixel(rgb(ink)) : 0)) };
}

// Drawing

let asked = false;
function draw() {
  if (!asked) requestAnimationFrame(() => { asked = false; drawNow(); });
  asked = true;
}

const look = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  canvas.width = Math.round(box.width * ratio);
  canvas.height = Math.round(box.height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, ratio, width: box.width, height: box.height };
}

function cellsAlong(cuts, [low, high], count, falling) {
  const found = new Int32Array(count);
  for (let k = 0, cell = 0; k < count; k++) {
    const at = low + ((high - low) * (k + 0.5)) / count;
    while (cell < cuts.length - 2 && cuts[cell + 1] <= at) cell++;
    found[falling ? count - 1 - k : k] = cell;
  }
  return found;
}

function drawNow() {
  const { ratio, width, height } = fitted(map);
  plot = { left: 58, top: 8, width: width - 70, height: height - 50 };
  drawAxes();
  if (!shown) return;
  const columns = Math.round(plot.width * ratio), rows = Math.round(plot.height * ratio);
  const image = pen.createImageData(columns, rows), pixels = new Uint32Array(image.data.buffer);
  const across = cellsAlong(X.cuts, state.window[0], columns, false);
  const up = cellsAlong(Y.cuts, state.window[1], rows, true);
  const { size, masks, inks } = texturesOf(shown.map.entries, ratio);
  for (let row = 0, at = 0; row < rows; row++) {
    const first = up[row] * NX, line = (row % size) * size;
    for (let column = 0; column < columns; column++, at++) {
      const cell = first + across[column], code = shown.codes[cell];
      pixels[at] = masks[code] && masks[code][line + (column % size)] ? inks[code] : shown.colors[cell];
    }
  }
  pen.putImageData(image, Math.round(plot.left * ratio), Math.round(plot.top * ratio));
  pen.save();
  pen.beginPath();
  pen.rect(plot.left, plot.top, plot.width, plot.height);
  pen.clip();
  drawCurves();
  drawMark();
  pen.restore();
}

const place = (at, along) => {
  const [low, high] = state.window[along], share = (axes[along].to(at) - low) / (high - low);
  return along ? plot.top + (1 - share) * plot.height : plot.left + share * plot.width;
};

function ticks(low, high, most, log) {
  if (log && high / low > 8) {
    const found = [];
    const steps = Math.log10(high / low) > most / 2 ? [1] : [1, 2, 5];
    for (let power = Math.floor(Math.log10(low)); 10 ** power <= high; power++)
      for (const step of steps) found.push(Number(`${step}e${power}`));
    const every = Math.ceil(found.length / (1.5 * most));
    return found.filter((value, k) => value >= low && value <= high && k % every === 0);
  }
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((each) => each * power >= rough) * power;
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++)
    found.push(Number((k * step).toPrecision(12)));
  return found;
}

function drawAxes() {
  pen.font = "12px system-ui, sans-serif";
  pen.fillStyle = look("--ink");
  pen.strokeStyle = look("--faint");
  pen.lineWidth = 1;
  pen.strokeRect(plot.left - 0.5, plot.top - 0.5, plot.width + 1, plot.height + 1);
  axes.forEach((axis, along) => {
    const [low, high] = state.window[along].map(axis.from);
    pen.textAlign = along ? "right" : "center";
    pen.textBaseline = along ? "middle" : "top";
    for (const value of ticks(low, high, along ? plot.height / 60 : plot.width / 80, axis.log)) {
      const at = place(value, along), bottom = plot.top + plot.height;
      pen.beginPath();
      if (along) pen.moveTo(plot.left - 5, at), pen.lineTo(plot.left, at);
      else pen.moveTo(at, bottom), pen.lineTo(at, bottom + 5);
      pen.stroke();
      if (along) pen.fillText(number(value, 8), plot.left - 8, at);
      else pen.fillText(number(value, 8), at, bottom + 8);
    }
  });
  pen.textAlign = "center";
  pen.fillText(X.label, plot.left + plot.width / 2, plot.top + plot.height + 28, plot.width);
  pen.save();
  pen.translate(12, plot.top + plot.height / 2);
  pen.rotate(-Math.PI / 2);
  pen.fillText(Y.label, 0, -6, plot.height);
  pen.restore();
}

function drawCurves() {
  if (!atlas.curves.lines) return;
  const there = ({ kind }) => !state.hidden.has(kind);
  for (const casing of [true, false])
    for (const { kind, points } of atlas.curves.lines.filter(there)) {
      const { color, dashes } = atlas.curves.looks[kind];
      pen.beginPath();
      for (let k = 0; k < points.length; k += 2) pen.lineTo(place(points[k], 0), place(points[k + 1], 1));
      pen.strokeStyle = casing ? "#ffffff" : color;
      pen.lineWidth = casing ? 3.4 : 1.6;
      pen.setLineDash(casing ? [] : dashes.map((dash) => 1.6 * dash));
      pen.stroke();
    }
  pen.setLineDash([]);
  pen.lineWidth = 1;
  if (!state.hidden.has("codimension_two"))
    for (const [kind, x, y] of atlas.curves.corners) outlined(pen, atlas.curves.marks[kind].shape, place(x, 0), place(y, 1));
  for (const [kind, x, y] of atlas.curves.ends) if (there({ kind })) dot(pen, place(x, 0), place(y, 1));
}

function dot(context, x, y) {
  context.beginPath();
  context.arc(x, y, 2.5, 0, 7);
  context.fillStyle = "#000000";
  context.strokeStyle = "#ffffff";
  context.fill();
  context.stroke();
}

function outlined(context, shape, x, y) {
  context.beginPath();
  for (const part of shape) {
    for (let k = 0; k < part.length; k += 2) context[k ? "lineTo" : "moveTo"](x + 7 * part[k], y - 7 * part[k + 1]);
    context.closePath();
  }
  context.fillStyle = "#ffffff";
  context.strokeStyle = "#000000";
  context.fill();
  context.stroke();
}

function drawMark() {
  if (!state.cell) return;
  const [[left, right], [bottom, top]] = axes.map(({ edges }, along) =>
    [0, 1].map((end) => place(edges[state.cell[along] + end], along)));
  const [width, height] = [Math.max(8, right - left), Math.max(8, bottom - top)];
  for (const [color, line] of [["#ffffff", 5], ["#000000", 2]]) {
    pen.strokeStyle = color;
    pen.lineWidth = line;
    pen.strokeRect((left + right - width) / 2, (top + bottom - height) / 2, width, height);
  }
}

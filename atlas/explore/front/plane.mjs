// Draws a plane of an atlas in a canvas: its cells, its curves and marks, its axes.
//
// A scene is all that is drawn: { axes: [x, y], window, plot, shown, lines, names, hidden, mark, over }. An axis is as
// `drawnAxis` makes it; the window has limits in the drawn coordinates; the plot is the area in CSS pixels. shown is
// { map, codes, colors, regions }, by cell; lines are as atlas.render.coded_lines returns them. names
// are labels; hidden are kinds of curves; mark has the edges of the chosen cell; over(pen, scene) draws over all of it.

import { pixel, rgb, texturesOf } from "./colors.mjs";
import { number } from "./words.mjs";

const BORDER = "#101418", OUTLINE = "#1a2433";
const POINT = 96 / 72; // CSS pixels
const VISIBLE = 2 * POINT, MOST_MARKS = 300; // as in atlas.render.raster

/** Return the functions to and from the coordinate in which an axis is drawn, its logarithm if `log`. */
export const scaleOf = (log) => (log ? [Math.log, Math.exp] : [(value) => value, (value) => value]);

/** Return an axis of `count` cells between its `edges`, all or the outer two, with functions `to` and `from` the drawn
 * coordinate, and with the `cuts` between cells in this coordinate.
 */
export function drawnAxis(axis) {
  const { edges, log, count = edges.length - 1 } = axis, [to, from] = scaleOf(log);
  const [low, high] = [edges[0], edges.at(-1)].map(to);
  const cuts = edges.length > count ? edges.map(to) : Array.from({ length: count + 1 }, (_, k) => low + ((high - low) * k) / count);
  return { ...axis, to, from, cuts };
}

/** Return the index of the cell along an axis that contains a value; -1 if the value lies outside. */
export function cellWith({ cuts, to }, value) {
  const place = to(value);
  let [low, high] = [0, cuts.length - 1];
  if (!(place >= cuts[0] && place < cuts[high])) return -1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (cuts[middle] <= place) low = middle;
    else high = middle;
  }
  return low;
}

function cellsAlong(cuts, [low, high], count, falling) {
  const found = new Int32Array(count).fill(-1);
  for (let k = 0, cell = 0; k < count; k++) {
    const at = low + ((high - low) * (k + 0.5)) / count;
    while (cell < cuts.length - 2 && cuts[cell + 1] <= at) cell++;
    if (at >= cuts[0] && at < cuts[cuts.length - 1]) found[falling ? count - 1 - k : k] = cell;
  }
  return found;
}

/** Return the image of the visible cells, with `ratio` pixels to a CSS pixel; transparent where there are no cells. */
export function pixelsOf({ axes: [x, y], window, plot, shown }, ratio) {
  const columns = Math.max(1, Math.round(plot.width * ratio)), rows = Math.max(1, Math.round(plot.height * ratio));
  const image = new ImageData(columns, rows), pixels = new Uint32Array(image.data.buffer), count = x.cuts.length - 1;
  const across = cellsAlong(x.cuts, window[0], columns, false), up = cellsAlong(y.cuts, window[1], rows, true);
  const { size, masks, inks } = texturesOf(shown.map.entries, ratio), { regions } = shown;
  const border = pixel(rgb(BORDER)), wide = Math.max(1, Math.round(ratio));
  const line = pixel(rgb(OUTLINE)), inside = shown.map.entries.map(({ outlined }) => Boolean(outlined));
  const hasOutline = inside.includes(true) && inside.includes(false), isInside = (cell) => inside[shown.codes[cell]];
  for (let row = 0, at = 0; row < rows; row++) {
    const first = up[row] * count, texture = (row % size) * size, below = up[Math.min(rows - 1, row + wide)] * count;
    if (first < 0) at += columns;
    else for (let column = 0; column < columns; column++, at++) {
      const cell = first + across[column], code = shown.codes[cell];
      if (across[column] < 0) continue;
      pixels[at] = masks[code] && masks[code][texture + (column % size)] ? inks[code] : shown.colors[cell];
      if (hasOutline) {
        const beside = across[Math.min(columns - 1, column + 1)], under = up[Math.min(rows - 1, row + 1)];
        if ((beside >= 0 && isInside(first + beside) !== inside[code])
          || (under >= 0 && isInside(under * count + across[column]) !== inside[code])) pixels[at] = line;
      }
      if (!regions) continue;
      const right = across[Math.min(columns - 1, column + wide)];
      if ((right >= 0 && regions[first + right] !== regions[cell])
        || (below >= 0 && regions[below + across[column]] !== regions[cell])) pixels[at] = border;
    }
  }
  return image;
}

function position({ window, plot }, at, along) {
  const [low, high] = window[along], share = (at - low) / (high - low);
  return along ? plot.top + (1 - share) * plot.height : plot.left + share * plot.width;
}

/** Return the position, in CSS pixels, of a value of the first (along = 0) or the second axis (along = 1). */
export const place = (scene, value, along) => position(scene, scene.axes[along].to(value), along);

/** Return the connected regions of cells in classes whose single cells are drawn larger, by the label of the class. A
 * region is given by [first column, last column, first row, last row, colour].
 */
export function specksOf({ map: { entries }, codes }, width) {
  const found = {}, seen = new Uint8Array(codes.length), label = (cell) => entries[codes[cell]].enlarged;
  if (!entries.some(({ enlarged }) => enlarged)) return found;
  for (let cell = 0; cell < codes.length; cell++) {
    const own = label(cell);
    if (!own || seen[cell]) continue;
    const box = [width, -1, codes.length, -1, entries[codes[cell]].color], stack = [cell];
    seen[cell] = 1;
    while (stack.length) {
      const at = stack.pop(), column = at % width, row = (at - column) / width;
      [box[0], box[1], box[2], box[3]] = [Math.min(box[0], column), Math.max(box[1], column), Math.min(box[2], row), Math.max(box[3], row)];
      for (const next of [column ? at - 1 : -1, column < width - 1 ? at + 1 : -1, at - width, at + width])
        if (next >= 0 && next < codes.length && !seen[next] && label(next) === own) {
          seen[next] = 1;
          stack.push(next);
        }
    }
    (found[own] ??= []).push(box);
  }
  return found;
}

/** Mark the regions of `specksOf` that are too small to be seen, unless they are too many; return their labels. */
function drawSpecks(pen, scene) {
  const { axes, plot, shown } = scene, drawn = new Set();
  shown.specks ??= specksOf(shown, axes[0].cuts.length - 1);
  for (const [label, boxes] of Object.entries(shown.specks)) {
    const small = [];
    for (const [left, right, low, high, color] of boxes) {
      const [[x0, x1], [y0, y1]] = [[left, right], [low, high]].map(([first, last], along) =>
        [first, last + 1].map((cut) => position(scene, axes[along].cuts[cut], along)));
      const x = (x0 + x1) / 2, y = (y0 + y1) / 2;
      if (Math.max(x1 - x0, y0 - y1) < VISIBLE && x > plot.left && x < plot.left + plot.width && y > plot.top && y < plot.top + plot.height)
        small.push([x, y, color]);
    }
    if (!small.length || small.length > MOST_MARKS) continue;
    drawn.add(label);
    const half = 0.45 * VISIBLE;
    for (const [x, y, color] of small) {
      pen.fillStyle = color;
      pen.strokeStyle = "#000000";
      pen.lineWidth = 0.2 * POINT;
      pen.fillRect(x - half, y - half, 2 * half, 2 * half);
      pen.strokeRect(x - half, y - half, 2 * half, 2 * half);
    }
  }
  return drawn;
}

/** Draw the cells of a scene and the lines over them; return the labels of classes with cells marked as too small. */
export function drawPlane(pen, scene, ratio) {
  const { left, top, width, height } = scene.plot;
  pen.putImageData(pixelsOf(scene, ratio), Math.round(left * ratio), Math.round(top * ratio));
  pen.save();
  pen.beginPath();
  pen.rect(left, top, width, height);
  pen.clip();
  const enlarged = drawSpecks(pen, scene);
  drawCurves(pen, scene);
  drawNames(pen, scene);
  if (scene.mark) drawMark(pen, scene);
  if (scene.over) scene.over(pen, scene);
  pen.restore();
  return enlarged;
}

/** Return round numbers between two limits, about `most` of them; with `log` on a logarithmic scale. */
export function ticks(low, high, most, log) {
  if (log && high / low > 8) {
    const found = [];
    const steps = Math.log10(high / low) > most / 2 ? [1] : [1, 2, 5];
    for (let power = Math.floor(Math.log10(low)); 10 ** power <= high; power++)
      for (const step of steps) found.push(Number(`${step}e${power}`));
    const every = Math.ceil(found.length / (1.5 * most));
    return found.filter((value, k) => value >= low && value <= high && k % every === 0);
  }
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((multiple) => multiple * power >= rough) * power;
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++)
    found.push(Number((k * step).toPrecision(12)));
  return found;
}

/** Return how the ticks of an axis are written: each value as (value - base) / unit, and the label that says so. In a
 * window much narrower than its distance from zero, they count from a round number near its centre. */
export function tickFormat({ label }, low, high) {
  const span = Math.abs(high - low), centre = 0.5 * (low + high), power = Math.floor(Math.log10(span));
  if (!(span <= 1e-3 * Math.abs(centre))) return { base: 0, unit: 1, label };
  const base = power < 0 ? Number(centre.toFixed(-power)) : Math.round(centre / 10 ** power) * 10 ** power;
  return { base, unit: 10 ** power, label: `${label}: distance from ${String(base).replace("-", "−")} in ${number(10 ** power, 1)}` };
}

/** Draw the frame of a plot, its ticks and its labels. */
export function drawAxes(pen, scene, ink, faint) {
  const { axes, plot } = scene, bottom = plot.top + plot.height;
  pen.font = "12px system-ui, sans-serif";
  pen.fillStyle = ink;
  pen.strokeStyle = faint;
  pen.lineWidth = 1;
  pen.strokeRect(plot.left - 0.5, plot.top - 0.5, plot.width + 1, plot.height + 1);
  axes.forEach((axis, along) => {
    const [low, high] = scene.window[along].map(axis.from), { base, unit, label } = tickFormat(axis, low, high);
    const [first, last] = [low, high].map((end) => (end - base) / unit);
    pen.textAlign = along ? "right" : "center";
    pen.textBaseline = along ? "middle" : "top";
    const values = axis.texts ? axis.texts.map((_, k) => k) : ticks(first, last, Math.max(2, along ? plot.height / 60 : plot.width / 80), axis.log && !base);
    for (const value of values) {
      const at = place(scene, base + value * unit, along);
      pen.beginPath();
      if (along) pen.moveTo(plot.left - 5, at), pen.lineTo(plot.left, at);
      else pen.moveTo(at, bottom), pen.lineTo(at, bottom + 5);
      pen.stroke();
      const text = axis.texts?.[value] ?? number(value, 8);
      if (along) pen.fillText(text, plot.left - 8, at);
      else pen.fillText(text, at, bottom + 8);
    }
    pen.save();
    if (along) pen.translate(6, plot.top + plot.height / 2), pen.rotate(-Math.PI / 2);
    else pen.translate(plot.left + plot.width / 2, bottom + 28);
    pen.textAlign = "center";
    pen.textBaseline = "top";
    pen.fillText(label, 0, 0, along ? plot.height : plot.width);
    pen.restore();
  });
}

function drawCurves(pen, scene) {
  const { looks, lines = [], marks, corners = [], ends = [] } = scene.lines;
  const there = ({ kind }) => !scene.hidden.has(kind);
  for (const casing of [true, false])
    for (const { kind, points } of lines.filter(there)) {
      const { color, dashes, width = 1.6, edge = "#ffffff" } = looks[kind];
      pen.beginPath();
      for (let k = 0; k < points.length; k += 2)
        pen.lineTo(place(scene, points[k], 0), place(scene, points[k + 1], 1));
      pen.strokeStyle = casing ? edge : color;
      pen.lineWidth = casing ? width + 1.8 : width;
      pen.setLineDash(casing ? [] : dashes.map((dash) => width * dash));
      pen.stroke();
    }
  pen.setLineDash([]);
  pen.lineWidth = 1;
  if (!scene.hidden.has("codimension_two"))
    for (const [kind, x, y] of corners) outlined(pen, marks[kind].shape, place(scene, x, 0), place(scene, y, 1));
  for (const [kind, x, y] of ends) if (there({ kind })) dot(pen, place(scene, x, 0), place(scene, y, 1));
}

function drawNames(pen, scene) {
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  for (const { text, x, y, angle, color, size } of scene.names || []) {
    pen.save();
    pen.translate(place(scene, x, 0), place(scene, y, 1));
    pen.rotate((-angle * Math.PI) / 180);
    pen.font = `${size}px STIXGeneral, "Times New Roman", serif`;
    pen.fillStyle = color;
    pen.fillText(text, 0, 0);
    pen.restore();
  }
}

/** Draw the dot that marks the end of a curve. */
export function dot(pen, x, y) {
  pen.beginPath();
  pen.arc(x, y, 2.5, 0, 7);
  pen.fillStyle = "#000000";
  pen.strokeStyle = "#ffffff";
  pen.fill();
  pen.stroke();
}

/** Draw a white marker with a black outline at (x, y); `shape` are its polygons in units of 7 pixels. */
export function outlined(pen, shape, x, y) {
  pen.beginPath();
  for (const part of shape) {
    for (let k = 0; k < part.length; k += 2) pen[k ? "lineTo" : "moveTo"](x + 7 * part[k], y - 7 * part[k + 1]);
    pen.closePath();
  }
  pen.fillStyle = "#ffffff";
  pen.strokeStyle = "#000000";
  pen.fill();
  pen.stroke();
}

function drawMark(pen, scene) {
  const [[left, right], [bottom, top]] = scene.mark.map((edges, along) => edges.map((edge) => place(scene, edge, along)));
  const [width, height] = [Math.max(8, right - left), Math.max(8, bottom - top)];
  for (const [color, line] of [["#ffffff", 5], ["#000000", 2]]) {
    pen.strokeStyle = color;
    pen.lineWidth = line;
    pen.strokeRect((left + right - width) / 2, (top + bottom - height) / 2, width, height);
  }
}

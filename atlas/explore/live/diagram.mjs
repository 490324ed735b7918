// Draws a diagram in a canvas: points, lines and bands over a parameter, with its axes.

import { fitted, themed } from "../front/elements.mjs";
import { drawAxes, place, scaleOf } from "../front/plane.mjs";

const [keep] = scaleOf(false);

/** Return the limits of some values with a margin, a share of their range. */
export function rangeOf(values, margin = 0.05) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) if (value !== null) [low, high] = [Math.min(low, value), Math.max(high, value)];
  if (!(low <= high)) return [0, 1];
  const room = margin * (high - low) || 0.5 * Math.abs(low) || 1;
  return [low - room, high + room];
}

function trace(pen, at, x, y) {
  let pause = true;
  for (let k = 0; k < x.length; k++) {
    if (y[k] !== null) pen[pause ? "moveTo" : "lineTo"](at(x[k], 0), at(y[k], 1));
    pause = y[k] === null;
  }
}

const PARTS = {
  points(pen, at, { x, y, size = 1.8 }) {
    for (let k = 0; k < x.length; k++) pen.fillRect(at(x[k], 0) - size / 2, at(y[k], 1) - size / 2, size, size);
  },
  line(pen, at, { x, y, width = 1.5, dash = [] }) {
    pen.beginPath();
    trace(pen, at, x, y);
    Object.assign(pen, { lineWidth: width }).setLineDash(dash);
    pen.stroke();
    pen.setLineDash([]);
  },
  band(pen, at, { x, low, high }) {
    const known = x.map((_, k) => k).filter((k) => low[k] !== null && high[k] !== null);
    pen.beginPath();
    for (const k of known) pen.lineTo(at(x[k], 0), at(high[k], 1));
    for (const k of known.reverse()) pen.lineTo(at(x[k], 0), at(low[k], 1));
    pen.globalAlpha = 0.25;
    pen.fill();
    pen.globalAlpha = 1;
  },
  dots(pen, at, { x, y, size = 8, square }) {
    pen.strokeStyle = "#ffffff";
    pen.lineWidth = 1;
    for (let k = 0; k < x.length; k++) {
      pen.beginPath();
      if (square) pen.rect(at(x[k], 0) - size / 2, at(y[k], 1) - size / 2, size, size);
      else pen.arc(at(x[k], 0), at(y[k], 1), size / 2, 0, 7);
      pen.fill();
      pen.stroke();
    }
  },
};

/** Draw a diagram. Its axes x and y are { label, range }, and may name their ticks by `texts`; the parts are drawn in
 * their order, each of a `kind` of PARTS and a `color`, with null where there is no value. Return the scene drawn, see
 * plane.mjs. */
export function drawDiagram(canvas, { x, y, parts }) {
  const { context, width, height } = fitted(canvas);
  const axes = [x, y].map((axis) => ({ log: false, to: keep, from: keep, ...axis })), plot = { left: 64, top: 6, width: Math.max(1, width - 76), height: Math.max(1, height - (x.texts ? 14 : 52)) };
  const scene = { axes, window: [x.range, y.range], plot }, at = (value, along) => place(scene, value, along);
  drawAxes(context, scene, themed("--ink"), themed("--faint"));
  context.save();
  context.beginPath();
  context.rect(plot.left, plot.top, plot.width, plot.height);
  context.clip();
  for (const { kind, color = themed("--ink"), ...part } of parts) {
    context.fillStyle = context.strokeStyle = color;
    PARTS[kind](context, at, part);
  }
  context.restore();
  return scene;
}

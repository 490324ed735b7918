// The legend of a map: its colorbar with limits that can be changed, its classes, and a switch for each kind of curve.

import { endsOf, fits, inkedBy, rgb, shareOf, tableOf } from "./colors.mjs";
import { fitted, make } from "./elements.mjs";
import { dot, outlined, ticks } from "./plane.mjs";
import { number } from "./words.mjs";

function swatch(paint) {
  const canvas = make("canvas", {});
  canvas.paint = () => paint(fitted(canvas));
  return canvas;
}

function boxOf({ color, dark, hatch, ink }) {
  return swatch(({ context, ratio, width, height }) => {
    const fill = context.createLinearGradient(0, 0, width, 0);
    fill.addColorStop(0, color);
    fill.addColorStop(1, dark ? `rgb(${rgb(color).map((part) => part * dark)})` : color);
    context.fillStyle = fill;
    context.fillRect(0, 0, width, height);
    context.fillStyle = ink || color;
    const fine = 1 / ratio;
    for (let y = 0; hatch && y < height; y += fine)
      for (let x = 0; x < width; x += fine) if (inkedBy(hatch, x, y, 8, 0.9)) context.fillRect(x, y, fine, fine);
    context.strokeStyle = "#707070";
    context.strokeRect(0.5, 0.5, width - 1, height - 1);
  });
}

const isTwoSided = (bar) => bar.scale === "two-sided";

function barOf(bar, look) {
  const canvas = swatch(({ context, width, height }) => {
    const table = tableOf(bar, endsOf(bar, look().ends));
    for (let x = 0; x < width; x += 0.5) {
      const color = table[Math.floor((x / width) * table.length)];
      context.fillStyle = `rgb(${color & 255} ${(color >> 8) & 255} ${(color >> 16) & 255})`;
      context.fillRect(x, 0, 1, height);
    }
  });
  const marks = make("div", { className: "ticks" });
  marks.update = () => {
    const [low, high] = endsOf(bar, look().ends);
    const values = isTwoSided(bar) ? [...ticks(low, 0, 2), ...ticks(0, high, 2).slice(1)] : ticks(low, high, 4, bar.scale === "log");
    marks.replaceChildren(...values.map((value) => make("span", { textContent: number(value), style: `left: ${100 * shareOf(bar, [low, high], value)}%` })));
    canvas.ariaLabel = `colours from ${number(low)} to ${number(high)}`;
  };
  canvas.setAttribute("role", "img");
  const label = `${bar.label}${isTwoSided(bar) ? " (two linear scales, joined at 0)" : ""}`;
  return make("div", { className: "bar" }, label, canvas, marks);
}

function endsInputs(bar, look, change) {
  const inputs = ["lower", "upper"].map((end) => make("input", { type: "number", step: "any", ariaLabel: `${end} colour limit` }));
  const update = () => inputs.forEach((input, end) => { input.value = Number(endsOf(bar, look().ends)[end].toPrecision(6)); });
  const set = () => {
    const ends = inputs.map((input) => input.valueAsNumber);
    if (fits(bar, ends)) change({ ends });
    else update();
  };
  for (const input of inputs) input.onchange = set;
  const button = (textContent, ends) => make("button", { type: "button", textContent, onclick: () => change({ ends }) });
  const fit = bar.fit ? [button("fit the scale to the view", bar.fit)] : [];
  return Object.assign(make("div", { className: "ends" }, make("span", { textContent: "colour limits" }), inputs[0], "to", inputs[1], button("reset", null), ...fit), { update });
}

function lineEntry(kind, label, look, change, paint) {
  if (!kind) return make("li", {}, swatch(paint), label); // switched outside the legend
  const box = make("input", { type: "checkbox" });
  box.onchange = () => {
    const hidden = new Set(look().hidden);
    hidden[box.checked ? "delete" : "add"](kind);
    change({ hidden });
  };
  box.update = () => { box.checked = !look().hidden.has(kind); };
  return make("li", {}, make("label", {}, box, swatch(paint), label));
}

function curveEntries({ looks, marks, ends }, look, change) {
  const lines = Object.entries(looks).map(([kind, { label, color, dashes, edge = "#ffffff", fixed }]) => lineEntry(!fixed && kind, label, look, change, ({ context, width, height }) => {
    for (const [ink, wide, broken] of [[edge, 5, []], [color, 2, dashes.map((dash) => 1.6 * dash)]]) {
      context.strokeStyle = ink;
      context.lineWidth = wide;
      context.setLineDash(broken);
      context.strokeRect(-9, height / 2, width + 18, height);
    }
  }));
  const kinds = Object.values(marks);
  if (kinds.length)
    lines.push(lineEntry("codimension_two", `codimension two: ${kinds.map(({ label }) => label).join(", ")}`, look, change,
      ({ context, width, height }) => outlined(context, kinds[0].shape, width / 2, height / 2)));
  if (ends.length) lines.push(make("li", {}, swatch((canvas) => dot(canvas.context, canvas.width / 2, canvas.height / 2)), "end of a curve"));
  if (!lines.length) return [];
  const title = Object.values(looks).some(({ fixed }) => fixed) ? "lines" : "curves";
  return [make("h2", { textContent: title }), make("ul", {}, ...lines)];
}

function labelOf({ label }, enlarged) {
  const text = make("span", {});
  text.update = () => { text.textContent = enlarged().has(label) ? `${label}, single cells enlarged` : label; };
  return text;
}

/** Fill an element with the legend of a map and of the `lines` over it. `look` returns the style of the plane, `change`
 * is called with changed fields of it, and `enlarged` returns the labels of classes whose single cells are marked. */
export function fillKey(key, map, lines, look, change, enlarged) {
  const { meaning, title, bar, legend } = map;
  key.replaceChildren(make("h2", { textContent: meaning }));
  if (bar) key.append(barOf(bar, look), endsInputs(bar, look, change));
  if (title) key.append(make("p", { className: "note", textContent: title }));
  key.append(make("ul", {}, ...legend.map((entry) => make("li", {}, boxOf(entry), labelOf(entry, enlarged)))));
  if (lines.lines) key.append(...curveEntries(lines, look, change));
  updateKey(key);
}

/** Update all controls and drawings in a legend to the present style of the plane. */
export function updateKey(key) {
  for (const element of key.querySelectorAll("*")) {
    if (element.update) element.update();
    if (element.paint) element.paint();
  }
}

// The static page of an atlas: it draws a map in any window, shows numbers of cells, and keeps the view in the address.

import { planeOn } from "../front/canvas.mjs";
import { by, copying } from "../front/elements.mjs";
import { fillKey, updateKey } from "../front/key.mjs";
import { changed, fillLook, linesOf, lookOf, queryOf, shownAs } from "../front/look.mjs";
import { cellWith } from "../front/plane.mjs";
import { sentence } from "../front/words.mjs";
import { NX, REGIME, X, Y, atlas, axes, numbers } from "./atlas.mjs";
import { describe, drawCell, placeOf } from "./cell.mjs";

const map = by("map");
const mapOf = (name) => atlas.maps.find((map) => map.name === name);
const whole = () => axes.map(({ cuts }) => [cuts[0], cuts[cuts.length - 1]]);

// The view state: all that the address contains. Everything on the page follows from the view state.
const FIRST = { map: atlas.maps[0].name, log: false, overlays: atlas.lines.curves ? ["curves"] : [], hidden: new Set(), ends: null };
let state = { ...FIRST, window: whole(), cell: null };
let shown = null; // a map, the arrays and the colours of its cells: that of the state once these are read
let enlarged = new Set(); // labels of classes whose single cells are drawn larger

// View and address

async function change(given, remembered = false) {
  const before = state;
  state = changed(state, given);
  if (!shown || ["map", "ends", "overlays"].some((name) => state[name] !== before[name])) {
    const { map } = state, made = await shownAs(mapOf(map), state, numbers, [REGIME], "regions" in atlas.arrays);
    if (state.map !== map) return;
    shown = made;
  }
  fillLook(by("look"), { maps: atlas.maps.map(({ name, numbers, meaning }) => [name, numbers ? meaning : name]), overlays: Object.keys(atlas.lines), logs: false }, () => state, (given) => change(given, true));
  map.ariaLabel = `${shown.map.meaning}, over ${X.label} and ${Y.label}`;
  if (!by("key").firstChild || state.map !== before.map || state.overlays !== before.overlays) makeKey();
  else if (state.ends !== before.ends || state.hidden !== before.hidden) updateKey(by("key"));
  draw();
  if (state.cell !== before.cell) showCell();
  if (state.cell && state.cell !== before.cell) say(said(state.cell));
  if (remembered !== null) remember(remembered);
}

function makeKey() {
  fillKey(by("key"), shown.map, linesOf(state, atlas.lines), () => state, change, () => enlarged);
}

const showCell = () => drawCell(state.cell, (cell) => state.cell === cell);

const said = (cell) => `${placeOf(cell)}: ${sentence(atlas, shown.map, cell[1] * NX + cell[0], shown.values)}`;
const say = (text) => { by("readout").textContent = text || "\u00a0"; };

function remember(asNew) {
  const parts = queryOf(state) === queryOf(FIRST) ? [] : [queryOf(state)];
  whole().forEach((full, along) => {
    const [low, high] = state.window[along];
    if (low !== full[0] || high !== full[1])
      parts.push(`${axes[along].name}=${[low, high].map((end) => Number(axes[along].from(end).toPrecision(12))).join(":")}`);
  });
  if (state.cell) parts.push(`cell=${axes.map(({ values }, along) => values[state.cell[along]]).join(":")}`);
  const address = `#${parts.join("&")}`;
  if (address === (location.hash || "#")) return;
  try {
    history[asNew ? "pushState" : "replaceState"](null, "", address);
  } catch (error) {
    if (error.name !== "SecurityError") throw error; // a page inside another page has no address of its own
  }
}

function recall() {
  const given = new URLSearchParams(location.hash.slice(1));
  const pair = (name) => {
    const found = (given.get(name) || "").split(":").map(Number);
    return found.length === 2 && found.every(Number.isFinite) ? found : null;
  };
  const cell = pair("cell"), look = lookOf(given), known = mapOf(look.map) ? look : FIRST;
  const window = whole().map((full, along) => {
    const found = pair(axes[along].name);
    return found && found[0] < found[1] ? inside(along, found.map(axes[along].to)) : full;
  });
  change({
    ...known,
    overlays: known.overlays.filter((name) => name in atlas.lines),
    window,
    cell: cell && cell.map((value, along) => nearest(along, value)),
  }, null);
}

function nearest(along, value) {
  const { cuts, to } = axes[along], cell = cellWith(axes[along], value);
  return cell >= 0 ? cell : to(value) < cuts[0] ? 0 : cuts.length - 2;
}

function inside(along, [low, high]) {
  const [first, last] = whole()[along], cells = axes[along].values.length;
  if (!(low < high) || high - low > (1 - 1e-9) * (last - first)) return [first, last];
  const least = Math.min(1, 4 / cells) * (last - first), width = Math.min(last - first, Math.max(least, high - low));
  const start = Math.min(last - width, Math.max(first, (low + high - width) / 2));
  return [start, start + width];
}

function stepTo(step) {
  const middle = state.window.map(([low, high], along) => nearest(along, axes[along].from((low + high) / 2)));
  const cell = !state.cell ? middle : state.cell.map((at, along) =>
    Math.max(0, Math.min(axes[along].values.length - 1, at + step[along])));
  const window = state.window.map(([low, high], along) => {
    const [first, last] = [0, 1].map((end) => axes[along].cuts[cell[along] + end]), width = high - low;
    return first < low ? inside(along, [first, first + width]) : last > high ? inside(along, [last - width, last]) : [low, high];
  });
  change({ cell, window });
}

const plane = planeOn(map, {
  axes: () => axes, window: () => state.window,
  scene: () => ({ shown, lines: linesOf(state, atlas.lines), hidden: state.hidden, names: atlas.names[state.map] || [],
    mark: state.cell && state.cell.map((at, along) => axes[along].edges.slice(at, at + 2)) }),
  move: (window) => change({ window: window.map((limits, along) => inside(along, limits)) }),
  whole: () => change({ window: whole() }),
  choose: (point) => change({ cell: point.map((value, along) => nearest(along, value)) }, true),
  point: (point) => say(point && shown ? said(point.map((value, along) => nearest(along, value))) : state.cell && shown ? said(state.cell) : ""),
  step: stepTo,
  escape: () => change({ cell: null }, true).then(() => say("")),
  enlarged(labels) {
    if ([...labels].join() === [...enlarged].join()) return;
    enlarged = labels;
    updateKey(by("key"));
  },
});
const { draw, scene } = plane;

for (const button of document.querySelectorAll(".copy")) button.replaceWith(copying("copy", () => by(button.dataset.of).textContent));
window.onpopstate = recall;
window.onhashchange = recall;
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => updateKey(by("key")));
describe();
showCell();
if ("DecompressionStream" in window) recall();
else say("This browser is too old for this page: it cannot unpack its numbers. Any browser of 2023 or later can.");

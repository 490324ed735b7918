// The static page of an atlas: it draws a map in any window, shows numbers of cells, and keeps the view in the address.

import { fitted, oncePerFrame } from "../front/elements.mjs";
import { fillKey, updateKey } from "../front/key.mjs";
import { changed, fillLook, linesOf, lookOf, queryOf, shownAs } from "../front/look.mjs";
import { cellWith, drawAxes, drawPlane } from "../front/plane.mjs";
import { sentence } from "../front/words.mjs";
import { NX, REGIME, X, Y, atlas, axes, by, numbers } from "./atlas.mjs";
import { copying, describe, drawCell, placeOf } from "./cell.mjs";

const map = by("map");
const mapOf = (name) => atlas.maps.find((map) => map.name === name);
const whole = () => axes.map(({ cuts }) => [cuts[0], cuts[cuts.length - 1]]);

// The view state: all that the address contains. Everything on the page follows from the view state.
const FIRST = { map: atlas.maps[0].name, log: false, overlays: atlas.lines.curves ? ["curves"] : [], hidden: new Set(), ends: null };
let state = { ...FIRST, window: whole(), cell: null };
let shown = null; // a map, the arrays and the colours of its cells: that of the state once these are read
let enlarged = new Set(); // labels of classes whose single cells are drawn larger
let plot = { left: 0, top: 8, width: 1, height: 1 };

// Picture

const themed = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const draw = oncePerFrame(drawNow);
const scene = () => {
  const lines = linesOf(state, atlas.lines);
  return { axes, window: state.window, plot, shown, lines, hidden: state.hidden, names: atlas.names[state.map] || [],
    mark: state.cell && state.cell.map((at, along) => axes[along].edges.slice(at, at + 2)) };
};

function drawNow() {
  const { context, ratio, width, height } = fitted(map);
  plot = { left: 58, top: 8, width: width - 70, height: height - 50 };
  drawAxes(context, scene(), themed("--ink"), themed("--faint"));
  if (!shown) return;
  const larger = drawPlane(context, scene(), ratio);
  if ([...larger].join() === [...enlarged].join()) return;
  enlarged = larger;
  updateKey(by("key"));
}

// Gestures and address

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

function zoom(factor, shares = [0.5, 0.5], moved = [0, 0]) {
  change({ window: state.window.map(([low, high], along) => {
    const at = low + shares[along] * (high - low), shift = moved[along] * (high - low);
    return inside(along, [at + factor * (low - at) - shift, at + factor * (high - at) - shift]);
  }) });
}

const sharesAt = ({ clientX, clientY }) => {
  const box = map.getBoundingClientRect();
  return [(clientX - box.left - plot.left) / plot.width, 1 - (clientY - box.top - plot.top) / plot.height];
};

function cellAt(event) {
  const shares = sharesAt(event);
  if (!shares.every((share) => share >= 0 && share < 1)) return null;
  return shares.map((share, along) => {
    const [low, high] = state.window[along];
    return nearest(along, axes[along].from(low + share * (high - low)));
  });
}

const fingers = new Map();
let pressed = null;

map.onpointerdown = (event) => {
  fingers.set(event.pointerId, event);
  map.setPointerCapture(event.pointerId);
  pressed = fingers.size === 1 ? event : null;
};

map.onpointermove = (event) => {
  if (!fingers.has(event.pointerId)) {
    const cell = cellAt(event);
    return say(shown && cell ? said(cell) : state.cell && shown ? said(state.cell) : "");
  }
  const before = [...fingers.values()], old = fingers.get(event.pointerId);
  if (pressed && Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) < 5) return;
  pressed = null;
  fingers.set(event.pointerId, event);
  const now = [...fingers.values()];
  if (now.length === 1) return zoom(1, [0.5, 0.5], sharesAt(event).map((share, along) => share - sharesAt(old)[along]));
  const [one, other] = [before, now].map(([a, b]) => ({
    size: Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY),
    middle: sharesAt({ clientX: (a.clientX + b.clientX) / 2, clientY: (a.clientY + b.clientY) / 2 }),
  }));
  zoom(one.size / other.size, other.middle, other.middle.map((share, along) => share - one.middle[along]));
};

map.onpointerup = map.onpointercancel = (event) => {
  fingers.delete(event.pointerId);
  if (pressed && event.type === "pointerup") {
    const cell = cellAt(event);
    if (cell) change({ cell }, true);
  }
  pressed = null;
};

map.onpointerleave = () => say(state.cell && shown ? said(state.cell) : "");

map.addEventListener("wheel", (event) => {
  event.preventDefault();
  const lines = event.deltaMode === 1 ? 16 : 1;
  zoom(Math.exp(Math.max(-0.5, Math.min(0.5, 0.002 * lines * event.deltaY))), sharesAt(event));
}, { passive: false });

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

map.onkeydown = (event) => {
  const step = ARROWS[event.key];
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (step && event.shiftKey) zoom(1, [0.5, 0.5], step.map((share) => -0.2 * share));
  else if (step) stepTo(step);
  else if (event.key === "+" || event.key === "=") zoom(0.7);
  else if (event.key === "-") zoom(1 / 0.7);
  else if (event.key === "0") change({ window: whole() });
  else if (event.key === "Escape") change({ cell: null }, true).then(() => say(""));
  else return;
  event.preventDefault();
};

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

by("closer").onclick = () => zoom(0.7);
by("farther").onclick = () => zoom(1 / 0.7);
by("whole").onclick = () => change({ window: whole() });
for (const button of document.querySelectorAll(".copy")) button.replaceWith(copying("copy", () => by(button.dataset.of).textContent));
window.onpopstate = recall;
window.onhashchange = recall;
new ResizeObserver(draw).observe(map);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { updateKey(by("key")); draw(); });
describe();
showCell();
if ("DecompressionStream" in window) recall();
else say("This browser is too old for this page: it cannot unpack its numbers. Any browser of 2023 or later can.");

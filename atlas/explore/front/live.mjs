// The plane of the explorer's page: the visible cells from the server, and the style in which the browser shows them.
//
// Without the server the browser shows other colour limits, another map of the same variables, overlays that are
// switched, and the cell under the pointer. The server receives the style before any further request.

import { make, oncePerFrame } from "./elements.mjs";
import { fillKey, updateKey } from "./key.mjs";
import { changed, fillLook, linesOf, lookOf, mapName, queryOf, reader, shownAs } from "./look.mjs";
import { inflated } from "./numbers.mjs";
import { cellWith, drawPlane, drawnAxis, scaleOf } from "./plane.mjs";
import { number, resultsOf } from "./words.mjs";

const dark = matchMedia("(prefers-color-scheme: dark)");
const parts = {}; // elements of the page that this module fills, by name
let models = null, subject = null; // models of Bokeh, and the subject as plane_pane.py describes it
let look = null, lastTold = ""; // style of the plane, and the last style that the server received
let held = null; // visible cells from the server
let shown = null; // map that is drawn, its cells and their colours
let enlarged = new Set(); // labels of classes whose single cells are drawn larger
let pointer = null, turns = 0;

/** Start to draw; called once the document is ready, with the models of Bokeh and the subject as JSON. */
export function begin(given) {
  models = given;
  subject = JSON.parse(given.subject);
  look = lookOf(new URLSearchParams(subject.look));
  lastTold = query();
  for (const range of [models.plot.x_range, models.plot.y_range])
    for (const end of ["start", "end"]) range.properties[end].change.connect(draw);
  for (const size of ["inner_width", "inner_height"]) models.plot.properties[size].change.connect(draw);
  models.sent.properties.data.change.connect(hear);
  dark.addEventListener("change", () => { fill("key"); draw(); });
  for (const name of Object.keys(parts)) fill(name);
  hear();
}

// Style of the plane

const query = () => queryOf(look);

/** Change fields of the style of the plane, and show the plane in the new style. */
function change(given) {
  look = changed(look, given);
  remember();
  show();
}

/** Send the style of the plane to the server, unless the server has it. */
export function tell() {
  if (!look || query() === lastTold) return;
  lastTold = query();
  models.look.data = { query: [lastTold] };
}

/** Return, for each axis, the functions to and from the coordinate in which the axis is drawn. */
export const scales = () => subject.axes.map(({ log }) => scaleOf(log));

// Messages from the server

async function hear() {
  const [sent] = models.sent.data.message || [], turn = ++turns;
  fill("bar");
  if (!sent) {
    held = shown = null;
    models.image.setv({ data: { image: [], x: [], y: [], dw: [], dh: [], cells: [] } }, { sync: false });
    for (const name of ["key", "pointer"]) fill(name);
    return;
  }
  const bytes = new Uint8Array(sent.buffer, sent.byteOffset, sent.byteLength);
  const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true), body = 4 + length;
  const about = JSON.parse(new TextDecoder().decode(await inflated(bytes.slice(4, body))));
  if (turn !== turns) return;
  const old = held && held.of === about.of ? held : { maps: {}, lines: {}, names: {}, arrays: {} };
  const arrays = Object.entries(about.arrays).map(([name, { at, size, ...array }]) => [name, { ...array, bytes: bytes.slice(body + at, body + at + size) }]);
  held = { ...about, axes: about.axes.map((axis, along) => drawnAxis({ ...subject.axes[along], ...axis })),
    maps: { ...old.maps, ...Object.fromEntries(about.maps.map((map) => [map.name, map])) },
    lines: { ...old.lines, ...about.lines }, names: { ...old.names, ...about.names },
    arrays: { ...Object.fromEntries(arrays), ...old.arrays } };
  if ("regions" in about.arrays && !("boundaries" in old.lines)) held.arrays.regions = Object.fromEntries(arrays).regions;
  held.numbers = old.numbers ?? reader((name) => held.arrays[name], held.axes[0].count);
  show();
}

// Drawing

async function show() {
  fill("look");
  if (!held) return tell();
  const of = held, map = of.maps[mapName(look)], lacks = look.overlays.some((name) => !(name in of.lines));
  if (!map || lacks) tell();
  if (!map) return;
  const known = Object.keys(subject.variables).filter((name) => name in of.arrays);
  const made = await shownAs(map, look, of.numbers, [subject.special.regime, "stages", ...known], "regions" in of.arrays);
  if (of !== held || map !== held.maps[mapName(look)]) return;
  shown = made;
  models.waiting.setv({ visible: false }, { sync: false });
  for (const name of ["key", "pointer"]) fill(name);
  draw();
}

const lines = () => linesOf(look, held.lines);
const draw = oncePerFrame(drawNow);

function drawNow() {
  const { plot, image, blank } = models, ranges = [plot.x_range, plot.y_range];
  const width = plot.inner_width, height = plot.inner_height, ratio = window.devicePixelRatio || 1;
  if (!shown || !(width > 0 && height > 0)) return;
  const { axes } = held, over = lines();
  const canvas = new OffscreenCanvas(Math.round(width * ratio), Math.round(height * ratio)), pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  const larger = drawPlane(pen, { axes, window: ranges.map(({ start, end }, along) => [start, end].map(axes[along].to)), plot: { left: 0, top: 0, width, height },
    shown, lines: over, hidden: look.hidden, names: held.names[shown.map.name] || [] }, ratio);
  if ([...larger].join() !== [...enlarged].join()) {
    enlarged = larger;
    fill("key");
  }
  const pixels = new Uint32Array(pen.getImageData(0, 0, canvas.width, canvas.height).data.buffer);
  if (dark.matches) for (let k = 0; k < pixels.length; k++) pixels[k] ^= 0xffffff; // the page inverts all colours again
  const NDArray = blank.data.words[0].constructor, picture = new NDArray(pixels, [canvas.height, canvas.width]);
  const [x, y] = ranges.map(({ start }) => [start]), [dw, dh] = ranges.map(({ start, end }) => [end - start]);
  const [across, up] = axes.map(({ edges }) => [edges[0], edges.at(-1) - edges[0]]);
  image.setv({ data: { image: [picture], x, y, dw, dh, cells: [[across[0], up[0], across[1], up[1]]] } }, { sync: false });
}

/** Show the numbers of the cell at a point of the plane. */
export function point(_, { x, y }) {
  pointer = x == null || y == null ? null : [x, y];
  fill("pointer");
}

function cellAt(at) {
  const found = at.map((value, along) => cellWith(held.axes[along], value));
  return found.every((cell) => cell >= 0) ? found : null;
}

/** Return the values of the axes at the cell that is drawn at a cell of the viewport. If the viewport's own cell is not
 * known, this is a coarser cell, of `stage` halvings of the full density. */
function placeOf(cell, stage) {
  return held.axes.map(({ cuts, from, first }, along) => {
    const half = (1 << stage) >> 1, own = (((cell[along] + first + half) >> stage) << stage) - first;
    const step = (cuts.at(-1) - cuts[0]) / (cuts.length - 1);
    const middle = own >= 0 && own < cuts.length - 1 ? (cuts[own] + cuts[own + 1]) / 2 : cuts[0] + (own + 0.5) * step;
    return from(middle);
  });
}

// Parts of the page

/** Register an element as the part `name` of the page, such as the legend, and fill it. */
export function take(name, element) {
  parts[name] = element;
  fill(name);
}

const FILLED = { key: fillMapKey, pointer: fillPointer, bar: fillBar, cell: fillCell,
  look: (element) => fillLook(element, { ...subject, logs: true }, () => look, change) };

function fill(name) {
  if (parts[name] && models) FILLED[name](parts[name]);
}

let keyed = null; // map and overlays of the legend, as text

function fillMapKey(element) {
  if (!shown) {
    keyed = null;
    return element.replaceChildren();
  }
  const over = lines(), of = JSON.stringify([shown.map.name, shown.map.bar && [shown.map.bar.ends, shown.map.bar.fit], shown.map.legend, over.looks, Object.keys(over.marks), over.ends.length > 0]);
  if (of === keyed && element.firstChild) return updateKey(element);
  keyed = of;
  const at = element.getRootNode().activeElement, focused = at && [...element.querySelectorAll("input, button")].indexOf(at);
  fillKey(element, shown.map, Object.keys(over.looks).length ? over : {}, () => look, change, () => enlarged);
  if (focused >= 0) element.querySelectorAll("input, button")[focused]?.focus();
}

const rowOf = (head, text, title = "") => make("tr", {}, make("td", { textContent: head }), make("td", { className: /^[−\d]/.test(text) ? "number" : "", title, textContent: text }));

/** Fill an element with the results of the clicked cell from the server; the tooltip of a number has all its digits. */
function fillCell(element) {
  const { caption, places, variables, values } = JSON.parse(element.dataset.given, (_, value) => value ?? NaN);
  const arrays = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, [value]])), about = { ...subject, variables, arrays: {} };
  const rows = places.map(([symbol, value]) => rowOf(symbol, number(value), value));
  rows.push(...resultsOf(about, Object.keys(variables), 0, arrays).map(([label, text, name]) => rowOf(label, text, values[name])));
  element.replaceChildren(make("table", {}, make("caption", { textContent: caption }), ...rows));
}

function fillPointer(element) {
  const cell = pointer && shown && cellAt(pointer);
  if (!cell) {
    if (!pointer || !shown) element.replaceChildren(make("span", { className: "waiting", innerText: subject.help }));
    return;
  }
  const k = cell[1] * held.axes[0].count + cell[0], stage = Math.min(shown.values.stages[k], 3);
  const at = placeOf(cell, stage), here = { ...subject, arrays: held.arrays };
  const rows = held.axes.map(({ symbol }, along) => rowOf(symbol, number(at[along])));
  const names = Object.keys(shown.values).filter((name) => name in subject.variables);
  rows.push(...resultsOf(here, names, k, shown.values).map(([label, text, name]) => rowOf(name === subject.special.regime ? "regime" : label, text)));
  const block = held.axes.map(({ level }) => 2 ** Math.max(0, -level));
  const coarse = Math.max(...block) > 1 ? [make("span", { className: "waiting", textContent: `block of up to ${block.join(" × ")} cells` })] : [];
  element.replaceChildren(make("table", {}, ...rows), ...coarse);
}

function fillBar(element) {
  const share = Math.floor(100 * (models.sent.data.share?.[0] ?? 1));
  const bar = make("div", { role: "progressbar", ariaLabel: "how far the view is refined, coarse to fine", ariaValueMin: 0, ariaValueMax: 100, ariaValueNow: share, style: `width: ${share}%` });
  element.replaceChildren(...(share < 100 ? [bar] : []));
}

// Address

let rests = false, timer = 0, there = "";

/** Write the position and the style of the plane into the address. */
export function remember() {
  there = models.address.text || there;
  if (!there) return;
  history[rests ? "pushState" : "replaceState"](null, "", withToken(`${there}&${query()}`));
  window.onpopstate = () => window.location.reload();
  rests = false;
  clearTimeout(timer);
  timer = setTimeout(() => { rests = true; }, 1500); // a view that was shown for a while stays in the browser's history
}

/** Open the page of other axes or of another layer, in the style of this page as far as possible. */
export function turn(_, { data: { place: [other], overlays: [possible] } }) {
  look = { ...look, overlays: look.overlays.filter((name) => possible.includes(name)) };
  window.location.assign(withToken(`${other}&${query()}`));
}

function withToken(text) {
  const token = new URLSearchParams(window.location.search).get("token");
  return `?${text}${token ? `&token=${token}` : ""}`;
}

/** The custom element for parts of the page that this module fills, wherever Bokeh puts them. */
export const Part = class extends HTMLElement {
  connectedCallback() {
    take(this.dataset.of, this);
  }
};

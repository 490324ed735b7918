// The plane of the explorer's page: what the server has sent of the cells in view, and how the browser shows it.
//
// Whatever the page holds is shown without the server: another scale, another map of the same variables, lines that are
// switched, the cell under the pointer. The server is told how the plane looks before it is asked for anything more.

import { colorsOf } from "./colors.mjs";
import { fillKey, make, updateKey } from "./key.mjs";
import { inflated, unpacked } from "./numbers.mjs";
import { drawPlane } from "./plane.mjs";
import { inWords, isResult, number } from "./words.mjs";

const NUMBER = "number-", LOGARITHM = "-log";
const dark = matchMedia("(prefers-color-scheme: dark)");
const parts = {}; // the elements of the page that are filled here, by name
let models = null, told = null; // of Bokeh, and what is known of the subject: see pane.py
let look = null, lastTold = ""; // how the plane looks, and what of that the server knows
let held = null; // the cells in view, as the server has sent them
let shown = null; // the map that is drawn, its cells and their colours
let pointer = null, turns = 0;

/** Begin, once the document is there. */
export function begin(given) {
  models = given;
  told = JSON.parse(given.told);
  look = looking(told.look);
  lastTold = query();
  for (const range of [models.plot.x_range, models.plot.y_range])
    for (const end of ["start", "end"]) range.properties[end].change.connect(draw);
  for (const size of ["inner_width", "inner_height"]) models.plot.properties[size].change.connect(draw);
  models.sent.properties.data.change.connect(hear);
  dark.addEventListener("change", () => { fill("key"); draw(); });
  for (const name of Object.keys(parts)) fill(name);
  hear();
}

// How the plane looks

function looking(text) {
  const given = new URLSearchParams(text), list = (name) => (given.get(name) || "").split(",").filter(Boolean);
  const ends = ["vmin", "vmax"].map((name) => (given.get(name) ? Number(given.get(name)) : null));
  const isNumber = given.get("kind") === "scalar";
  return { map: isNumber ? NUMBER + given.get("variable") : given.get("kind"), log: given.get("log") === "1",
    overlays: list("overlay"), hidden: new Set(list("without")), ends: ends.some((end) => end !== null) ? ends : null };
}

function query() {
  const isNumber = look.map.startsWith(NUMBER), variable = look.map.slice(NUMBER.length);
  const pairs = isNumber ? [["kind", "scalar"], ["variable", variable], ...(look.log ? [["log", "1"]] : [])] : [["kind", look.map]];
  for (const [name, list] of [["overlay", look.overlays], ["without", [...look.hidden]]])
    if (list.length) pairs.push([name, list.join(",")]);
  (look.ends || []).forEach((end, k) => { if (end !== null) pairs.push([["vmin", "vmax"][k], end]); });
  return pairs.map(([name, value]) => `${name}=${encodeURIComponent(value).replaceAll("%2C", ",")}`).join("&");
}

const mapName = () => look.map + (look.log && look.map.startsWith(NUMBER) ? LOGARITHM : "");

/** Change how the plane looks. */
function change(given) {
  const before = look;
  look = { ...look, ...given };
  if (look.map !== before.map && !("ends" in given)) look.ends = null;
  remember();
  show();
}

/** Tell the server how the plane looks, unless it knows. */
export function tell() {
  if (!look || query() === lastTold) return;
  lastTold = query();
  models.look.data = { query: [lastTold] };
}

// What the server sends

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
  const old = held && held.of === about.of ? held : { maps: {}, lines: {}, names: {}, arrays: {}, read: new Map() };
  const arrays = Object.entries(about.arrays).map(([name, { at, size, ...each }]) =>
    [name, { ...each, packed: bytes.slice(body + at, body + at + size) }]);
  held = { ...about, axes: about.axes.map(axisOf), maps: { ...old.maps, ...Object.fromEntries(about.maps.map((map) => [map.name, map])) },
    lines: { ...old.lines, ...about.lines }, names: { ...old.names, ...about.names },
    arrays: { ...Object.fromEntries(arrays), ...old.arrays }, read: old.read };
  if ("regions" in about.arrays && !("boundaries" in old.lines)) held.arrays.regions = Object.fromEntries(arrays).regions;
  show();
}

function axisOf(axis, along) {
  const { log, label, symbol } = told.axes[along], to = log ? Math.log : (value) => value, from = log ? Math.exp : to;
  const [low, high] = [axis.edges[0], axis.edges.at(-1)].map(to);
  const cuts = axis.edges.length > 2 ? axis.edges.map(to)
    : Array.from({ length: axis.count + 1 }, (_, k) => low + ((high - low) * k) / axis.count);
  return { ...axis, log, label, symbol, to, from, cuts };
}

function numbers(name) {
  const { packed, type } = held.arrays[name];
  if (!held.read.has(name)) held.read.set(name, unpacked(packed, type, held.axes[0].count));
  return held.read.get(name);
}

// What is shown

async function show() {
  fill("look");
  if (!held) return tell();
  const of = held, map = of.maps[mapName()], lacks = look.overlays.some((name) => !(name in of.lines));
  if (!map || lacks) tell();
  if (!map) return;
  const { regime } = told.special, known = Object.keys(told.variables).filter((name) => name in of.arrays);
  const names = [...new Set([regime, ...map.needs, ...known])];
  const borders = look.overlays.includes("boundaries") && "regions" in of.arrays;
  const [codes, stages, regions, ...several] = await Promise.all(
    [map.codes, "stages", ...(borders ? ["regions"] : ["stages"]), ...names].map(numbers));
  if (of !== held || map !== held.maps[mapName()]) return;
  const values = Object.fromEntries(names.map((name, k) => [name, several[k]]));
  shown = { map, codes, values, stages, regions: borders ? regions : null, colors: colorsOf(map, codes, values, look.ends) };
  models.waiting.setv({ visible: false }, { sync: false });
  for (const name of ["key", "pointer"]) fill(name);
  draw();
}

function lines() {
  const on = look.overlays.map((name) => held.lines[name]).filter(Boolean);
  const all = (name) => on.flatMap((each) => each[name] || []);
  return { looks: Object.assign({}, ...on.map(({ looks }) => looks)), marks: Object.assign({}, ...on.map(({ marks }) => marks)),
    lines: all("lines"), corners: all("corners"), ends: all("ends"), names: all("names") };
}

let asked = false;
function draw() {
  if (!asked) requestAnimationFrame(() => { asked = false; drawNow(); });
  asked = true;
}

function drawNow() {
  const { plot, image, blank } = models, ranges = [plot.x_range, plot.y_range];
  const width = plot.inner_width, height = plot.inner_height, ratio = window.devicePixelRatio || 1;
  if (!shown || !(width > 0 && height > 0)) return;
  const { axes } = held, over = lines();
  const canvas = new OffscreenCanvas(Math.round(width * ratio), Math.round(height * ratio)), pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  drawPlane(pen, { axes, window: ranges.map(({ start, end }, along) => [start, end].map(axes[along].to)), plot: { left: 0, top: 0, width, height },
    shown, lines: over, hidden: look.hidden, names: [...(held.names[shown.map.name] || []), ...over.names] }, ratio);
  const pixels = new Uint32Array(pen.getImageData(0, 0, canvas.width, canvas.height).data.buffer);
  if (dark.matches) for (let k = 0; k < pixels.length; k++) pixels[k] ^= 0xffffff; // the page inverts them again
  const NDArray = blank.data.words[0].constructor, picture = new NDArray(pixels, [canvas.height, canvas.width]);
  const [x, y] = ranges.map(({ start }) => [start]), [dw, dh] = ranges.map(({ start, end }) => [end - start]);
  const [across, up] = axes.map(({ edges }) => [edges[0], edges.at(-1) - edges[0]]);
  image.setv({ data: { image: [picture], x, y, dw, dh, cells: [[across[0], up[0], across[1], up[1]]] } }, { sync: false });
}

/** Say what is shown of the cell at a point of the plane. */
export function point(_, { x, y }) {
  pointer = x == null || y == null ? null : [x, y];
  fill("pointer");
}

function cellAt(at) {
  const found = at.map((value, along) => {
    const { cuts, to } = held.axes[along], place = to(value);
    if (!(place >= cuts[0] && place < cuts.at(-1))) return -1;
    let [low, high] = [0, cuts.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (cuts[middle] <= place) low = middle;
      else high = middle;
    }
    return low;
  });
  return found.every((cell) => cell >= 0) ? found : null;
}

/** The place of the cell that is drawn at a cell of the view: that of a coarser one where no finer one is known. */
function placeOf(cell, stage) {
  return held.axes.map(({ cuts, from, first }, along) => {
    const half = (1 << stage) >> 1, own = (((cell[along] + first + half) >> stage) << stage) - first;
    const step = (cuts.at(-1) - cuts[0]) / (cuts.length - 1);
    const middle = own >= 0 && own < cuts.length - 1 ? (cuts[own] + cuts[own + 1]) / 2 : cuts[0] + (own + 0.5) * step;
    return from(middle);
  });
}

// The parts of the page

/** Take an element as a part of the page. */
export function take(name, element) {
  parts[name] = element;
  fill(name);
}

function fill(name) {
  if (parts[name] && models) ({ look: fillLook, key: fillMapKey, pointer: fillPointer, bar: fillBar })[name](parts[name]);
}

const chosen = { get ends() { return look.ends; }, get hidden() { return look.hidden; } };
let keyed = null; // what the key is of

function fillMapKey(element) {
  if (!shown) {
    keyed = null;
    return element.replaceChildren();
  }
  const over = lines(), of = JSON.stringify([shown.map.name, shown.map.bars.map(({ ends, fit }) => [ends, fit]), shown.map.legend, over.looks, Object.keys(over.marks), over.ends.length > 0]);
  if (of === keyed && element.firstChild) return updateKey(element);
  keyed = of;
  const at = element.getRootNode().activeElement, focused = at && [...element.querySelectorAll("input, button")].indexOf(at);
  fillKey(element, shown.map, Object.keys(over.looks).length ? over : {}, chosen, change);
  if (focused >= 0) element.querySelectorAll("input, button")[focused]?.focus();
}

function fillLook(element) {
  if (!element.firstChild) {
    const select = make("select", { ariaLabel: "map" });
    for (const [label, maps] of [["kinds", told.maps.filter(([name]) => !name.startsWith(NUMBER))], ["numbers of each cell", told.maps.filter(([name]) => name.startsWith(NUMBER))]])
      select.append(make("optgroup", { label }, ...maps.map(([value, textContent]) => make("option", { value, textContent }))));
    select.onchange = () => change({ map: select.value });
    select.update = () => { select.value = look.map; };
    const log = make("input", { type: "checkbox", onchange: () => change({ log: log.checked, ends: null }) });
    log.update = () => { Object.assign(log, { checked: look.log, disabled: !look.map.startsWith(NUMBER) }); };
    const over = told.overlays.map((name) => {
      const box = make("input", { type: "checkbox" });
      box.onchange = () => change({ overlays: told.overlays.filter((each) => (each === name ? box.checked : look.overlays.includes(each))) });
      box.update = () => { box.checked = look.overlays.includes(name); };
      return make("label", {}, box, name);
    });
    element.append(make("label", { className: "map" }, "map", select), make("label", {}, log, "logarithmic"), make("h4", { textContent: "lines over it" }), ...over);
  }
  updateKey(element);
}

function fillPointer(element) {
  const cell = pointer && shown && cellAt(pointer);
  if (!cell) {
    if (!pointer || !shown) element.replaceChildren(make("span", { className: "waiting", innerText: told.help }));
    return;
  }
  const k = cell[1] * held.axes[0].count + cell[0], stage = Math.min(shown.stages[k], 3), { special, variables } = told;
  const at = placeOf(cell, stage), row = (head, text) => make("tr", {}, make("td", { textContent: head }), make("td", { className: "number", textContent: text }));
  const rows = held.axes.map(({ symbol }, along) => row(symbol, number(at[along])));
  const names = Object.keys(shown.values).filter((name) => !(name === special.error && special.largest in shown.values) && isResult({ ...told, arrays: held.arrays }, name, k, shown.values));
  rows.push(...names.map((name) => row(name === special.regime ? "regime" : variables[name].label, inWords({ ...told, arrays: held.arrays }, name, k, shown.values))));
  const block = held.axes.map(({ level }) => 2 ** Math.max(0, -level));
  const coarse = Math.max(...block) > 1 ? [make("span", { className: "waiting", textContent: `block of up to ${block.join(" × ")} cells` })] : [];
  element.replaceChildren(make("table", {}, ...rows), ...coarse);
}

function fillBar(element) {
  const share = Math.floor(100 * (models.sent.data.share?.[0] ?? 1));
  const bar = make("div", { role: "progressbar", ariaLabel: "how far the view is refined, coarse to fine", ariaValueMin: 0, ariaValueMax: 100, ariaValueNow: share, style: `width: ${share}%` });
  element.replaceChildren(...(share < 100 ? [bar] : []));
}

// The address

let rests = false, timer = 0, there = "";

/** Have the address say where the plane is, and how it looks. */
export function remember() {
  there = models.address.text || there;
  if (!there) return;
  history[rests ? "pushState" : "replaceState"](null, "", withToken(`${there}&${query()}`));
  window.onpopstate = () => window.location.reload();
  rests = false;
  clearTimeout(timer);
  timer = setTimeout(() => { rests = true; }, 1500); // a view at which somebody rested stays in the browser's history
}

/** Open the page of other axes, or of another layer, with the look of this one as far as that page has it. */
export function turn(_, { data: { place: [other], overlays: [possible] } }) {
  look = { ...look, overlays: look.overlays.filter((name) => possible.includes(name)) };
  window.location.assign(withToken(`${other}&${query()}`));
}

function withToken(text) {
  const token = new URLSearchParams(window.location.search).get("token");
  return `?${text}${token ? `&token=${token}` : ""}`;
}

/** The element of a part of the page, wherever Bokeh puts it. */
export const Part = class extends HTMLElement {
  connectedCallback() {
    take(this.dataset.of, this);
  }
};

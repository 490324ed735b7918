// The live page: it draws the cells that the server knows in any window, and has the server solve those it does not know.
//
// All that is shown follows from the state, and from what the server has told. Each request carries the state, as the
// query of an address. Without the server the page shows another window of the cells at hand, other colour limits,
// another map of the same variables, overlays that are switched, and the cell under the pointer.

import { planeOn } from "../front/canvas.mjs";
import { by, make } from "../front/elements.mjs";
import { fillKey, updateKey } from "../front/key.mjs";
import { changed, fillLook, linesOf, lookOf, mapName, reader, shownAs } from "../front/look.mjs";
import { inflated } from "../front/numbers.mjs";
import { cellWith, drawnAxis, place, scaleOf } from "../front/plane.mjs";
import { number, sentence } from "../front/words.mjs";
import { INK, cellPanel, followPanel } from "./cell.mjs";
import { fillControls } from "./controls.mjs";
import { cutPanel } from "./cut.mjs";
import { linkTo } from "./link.mjs";
import { addressOf, chosen, escaped, isInPlane } from "./state.mjs";

const SOON = 40, WRITTEN = 250, RESTED = 1500; // milliseconds from a change to its request, to the address, to the history
const GESTURE = 500; // milliseconds within which changes of the window belong to one gesture
const FINEST = 3; // halvings of the full density, beyond which a cell is not told apart

const subject = JSON.parse(by("subject").textContent);
const bare = subject.axes.map((axis) => { const [to, from] = scaleOf(axis.log); return { ...axis, to, from, cuts: [] }; });
let state = { ...subject.view, box: null, ...lookOf(new URLSearchParams(subject.look)) };
let accepted = state; // the last state that the server has not refused
let size = null, asked = "", timer = 0; // of the plane in pixels, what the server was last asked to show
let held = null; // the visible cells from the server
let shown = null; // the map that is drawn, its cells and their colours
let enlarged = new Set(); // labels of classes whose single cells are drawn larger
let pointed = null, turns = 0, lastMove = -GESTURE, keyed = "", tool = "move", isClicked = false;
const past = [], future = []; // windows before and after this one

const stateNow = () => state, axesNow = () => held?.axes ?? bare, say = (id, text) => { if (by(id).textContent !== text) by(id).textContent = text; };

// Requests

/** Send a request about the state, and promise its answer. If it is refused, say so, call `failed`, and answer nothing. */
const request = (ask, given, failed) => link(ask, { query: addressOf(subject, state), ...given }).catch((error) => {
  complain(error.message);
  failed?.();
  return new Promise(() => {});
});
const complain = (text) => say("trouble", text);

/** Ask the server to show the state, soon; unless `rests`, a slider is moving. */
function ask(rests = true) {
  clearTimeout(timer);
  timer = setTimeout(show, SOON, rests);
}

async function show(rests) {
  const view = state, query = addressOf(subject, view), now = JSON.stringify([query, size, cut.shows(), rests]);
  if (!size || now === asked) return;
  asked = now;
  try {
    await link("view", { query, size, rests, shows: cut.shows() });
    accepted = view;
  } catch (error) {
    asked = "";
    if (error.isRefusal && view === state && state !== accepted) revert(error.message);
  }
}

function revert(reason) {
  state = accepted;
  refresh();
  complain(reason);
}

// State and address

/** Change fields of the state, and ask for what they need. */
function change(given, rests = true) {
  const before = state, looks = changed(state, given);
  state = chosen(before, { ...given, ends: looks.ends });
  if (given.x) moved(before);
  complain("");
  refresh();
  const isLook = Object.keys(given).every((name) => ["map", "log", "overlays", "hidden", "ends"].includes(name));
  if (!isLook || !hasAll()) ask(rests);
}

/** Keep the window before a gesture, which is a series of changes that follow each other at once. */
function moved({ x, y }) {
  if (performance.now() - lastMove > GESTURE) past.push([x, y]);
  lastMove = performance.now();
  future.splice(0);
}

function refresh() {
  update();
  follow.update();
  cut.update();
  titled();
  remember();
  look();
}

let hasRested = false, resting = 0, writing = 0;

/** Write the state into the address, not more often than browsers allow. */
function remember() {
  writing ||= setTimeout(() => { writing = 0; write(); }, WRITTEN);
}

function write() {
  const token = new URLSearchParams(location.search).get("token"), query = `?${addressOf(subject, state)}${token ? `&token=${token}` : ""}`;
  if (query !== location.search) history[hasRested ? "pushState" : "replaceState"](null, "", query);
  hasRested = false;
  clearTimeout(resting);
  resting = setTimeout(() => { hasRested = true; }, RESTED);
}

async function go(given) {
  const { query } = await request("turn", given), token = new URLSearchParams(location.search).get("token");
  location.assign(`?${query}${token ? `&token=${token}` : ""}`);
}

function titled() {
  const equations = subject.parameters.filter(({ name, initial }) => state.parameters[name] || !initial)
    .map(({ name, symbol }) => make("span", { className: "number" }, make("i", { textContent: symbol }), ` = ${number(state.parameters[name])} `));
  by("title").replaceChildren(make("b", { textContent: subject.name }), " ", ...equations);
}

// Cells from the server

async function receive(bytes) {
  const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true), body = 4 + length, turn = ++turns;
  const about = JSON.parse(new TextDecoder().decode(await inflated(bytes.slice(4, body))));
  if (turn !== turns) return;
  const old = held && held.of === about.of ? held : { maps: {}, lines: {}, names: {}, arrays: {} };
  const arrays = Object.fromEntries(Object.entries(about.arrays).map(([name, { at, size, ...array }]) => [name, { ...array, bytes: bytes.slice(body + at, body + at + size) }]));
  held = { ...about, axes: about.axes.map((axis, along) => drawnAxis({ ...subject.axes[along], ...axis })),
    maps: { ...old.maps, ...Object.fromEntries(about.maps.map((map) => [map.name, map])) },
    lines: { ...old.lines, ...about.lines }, names: { ...old.names, ...about.names }, arrays: { ...arrays, ...old.arrays } };
  if ("regions" in about.arrays && !("boundaries" in old.lines)) held.arrays.regions = arrays.regions;
  held.numbers = old.numbers ?? reader((name) => held.arrays[name], held.axes[0].count);
  look();
}

const hasAll = () => held && mapName(state) in held.maps && state.overlays.every((name) => name in held.lines);

async function look() {
  fillLook(by("look"), { ...subject, logs: true }, stateNow, change);
  if (!held) return plane.draw();
  const of = held, map = of.maps[mapName(state)];
  if (!hasAll()) ask();
  if (!map) return;
  const known = Object.keys(subject.variables).filter((name) => name in of.arrays);
  const made = await shownAs(map, state, of.numbers, [subject.special.regime, "stages", ...known], "regions" in of.arrays);
  if (of !== held || map !== held.maps[mapName(state)]) return;
  shown = made;
  legend();
  point(pointed);
  plane.draw();
}

const lines = () => (held ? linesOf(state, held.lines) : { looks: {}, marks: {}, lines: [], corners: [], ends: [] });

function legend() {
  const key = by("key"), over = lines();
  by("legend").hidden = !shown;
  if (!shown) return;
  const of = JSON.stringify([shown.map.name, shown.map.bar && [shown.map.bar.ends, shown.map.bar.fit], shown.map.legend, over.looks, Object.keys(over.marks), over.ends.length > 0]);
  if (of === keyed) return updateKey(key);
  keyed = of;
  const focused = [...key.querySelectorAll("input, button")].indexOf(document.activeElement);
  fillKey(key, shown.map, Object.keys(over.looks).length ? over : {}, stateNow, change, () => enlarged);
  if (focused >= 0) key.querySelectorAll("input, button")[focused]?.focus();
}

// The plane

const page = { subject, state: stateNow, axes: axesNow, change, go, request, ask, redraw: () => plane.draw() };
const follow = followPanel(page), details = cellPanel(page), cut = cutPanel(page), update = fillControls(page);

const plane = planeOn(by("map"), {
  keys: window, axes: axesNow, tool: () => (tool === "cut" ? "line" : tool),
  window: () => [state.x, state.y].map((limits, along) => limits.map(bare[along].to)),
  scene: () => ({ shown: shown && held ? shown : null, lines: lines(), hidden: state.hidden, names: held?.names[mapName(state)] || [],
    mark: isInPlane(state) ? state.cell.at.map((value) => [value, value]) : null, over }),
  move: (limits) => { const [x, y] = limits.map((pair, along) => pair.map(bare[along].from)); change({ x, y }); },
  whole: () => change({ x: subject.whole[0], y: subject.whole[1] }),
  choose: (at) => request("cell", { at }).then(({ cell }) => {
    change({ cell: { at: cell, parameters: state.parameters } });
    isClicked = true;
  }),
  point, escape: () => { state = escaped(state); refresh(); ask(); },
  resized: (width, height) => { size = [width, height]; ask(); },
  enlarged(labels) {
    if ([...labels].join() === [...enlarged].join()) return;
    enlarged = labels;
    updateKey(by("key"));
  },
  drawn(from, to) {
    const [x, y] = [0, 1].map((along) => [from[along], to[along]].sort((one, other) => one - other));
    if (tool === "cut") change({ cut: [...from, ...to] });
    else if (x[0] < x[1] && y[0] < y[1]) change(tool === "zoom" ? { x, y } : { box: [x, y] });
    use("move");
  },
});

function over(pen, scene) {
  cut.over(pen, scene);
  const rectangle = ([[left, right], [low, high]]) => {
    const [x0, x1, y0, y1] = [place(scene, left, 0), place(scene, right, 0), place(scene, high, 1), place(scene, low, 1)];
    for (const [color, width] of [["#ffffff", 4], ["#000000", 1.6]]) Object.assign(pen, { strokeStyle: color, lineWidth: width }), pen.strokeRect(x0, y0, x1 - x0, y1 - y0);
  };
  if (state.box) rectangle(state.box);
  const marks = follow.marks();
  if (!marks?.at) return;
  for (const [color, width, size] of [["#ffffff", 5, 12], [INK, 2, 9]])
    for (const { ends } of marks.arrows) arrow(pen, ends.map((value, k) => place(scene, value, k % 2)), color, width, size);
  const [x, y] = marks.at.map((value, along) => place(scene, value, along));
  Object.assign(pen, { fillStyle: INK, strokeStyle: "#ffffff", lineWidth: 1.5, font: "13px system-ui, sans-serif" });
  pen.beginPath();
  for (const [dx, dy] of [[0, -10], [7, 0], [0, 10], [-7, 0]]) pen.lineTo(x + dx, y + dy);
  pen.closePath();
  pen.fill();
  pen.stroke();
  for (const { text, align, baseline, right, down } of marks.arrows) {
    const width = pen.measureText(text).width, left = x + right - (align === "right" ? width : 0), top = y + down - (baseline === "bottom" ? 15 : 0);
    pen.fillStyle = "#ffffffd9";
    pen.fillRect(left - 2, top - 1, width + 4, 17);
    Object.assign(pen, { fillStyle: INK, textAlign: "left", textBaseline: "top" });
    pen.fillText(text, left, top + 1);
  }
}

function arrow(pen, [x0, y0, x1, y1], color, width, size) {
  const angle = Math.atan2(y1 - y0, x1 - x0);
  Object.assign(pen, { strokeStyle: color, fillStyle: color, lineWidth: width });
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
  pen.beginPath();
  for (const turn of [0, 2.6, -2.6]) pen.lineTo(x1 + (turn ? size * Math.cos(angle + turn) : 0), y1 + (turn ? size * Math.sin(angle + turn) : 0));
  pen.fill();
}

/** Say what is known of the cell at a point of the plane. */
function point(at) {
  const before = pointed;
  pointed = at;
  const cell = at && shown && held && at.map((value, along) => cellWith(held.axes[along], value));
  if (at !== before) cut.near(at);
  if (!cell || cell.some((index) => index < 0)) return say("readout", "\u00a0");
  const k = cell[1] * held.axes[0].count + cell[0], stage = Math.min(shown.values.stages[k], FINEST);
  const names = Object.keys(shown.values).filter((name) => name in subject.variables), here = { ...subject, arrays: held.arrays };
  const block = held.axes.map(({ level }) => 2 ** Math.max(0, -level)), coarse = Math.max(...block) > 1 ? `; block of up to ${block.join(" × ")} cells` : "";
  say("readout", `${placeAt(cell, stage).map((value, along) => `${held.axes[along].symbol} = ${number(value)}`).join(", ")}: ${sentence(here, { needs: names }, k, shown.values)}${coarse}`);
}

/** Return the values of the axes at the cell that is drawn at a cell of the viewport. If the viewport's own cell is not
 * known, this is a coarser cell, of `stage` halvings of the full density. */
function placeAt(cell, stage) {
  return held.axes.map(({ cuts, from, first }, along) => {
    const half = (1 << stage) >> 1, own = (((cell[along] + first + half) >> stage) << stage) - first;
    const step = (cuts.at(-1) - cuts[0]) / (cuts.length - 1);
    return from(own >= 0 && own < cuts.length - 1 ? (cuts[own] + cuts[own + 1]) / 2 : cuts[0] + (own + 0.5) * step);
  });
}

// Tools

function use(name) {
  tool = name;
  for (const button of document.querySelectorAll("#tools [data-tool]")) button.ariaPressed = String(button.dataset.tool === tool);
}

function step(from, to) {
  if (!from.length) return;
  const [x, y] = from.pop();
  to.push([state.x, state.y]);
  state = chosen(state, { x, y });
  refresh();
  ask();
}

for (const button of document.querySelectorAll("#tools [data-tool]")) button.onclick = () => use(button.dataset.tool);
by("undo").onclick = () => step(past, future);
by("redo").onclick = () => step(future, past);

// What the server tells

const HEARD = {
  open() { asked = ""; complain(subject.trouble); subject.trouble = ""; ask(); },
  lost() { complain("the explorer does not answer; trying again"); },
  picture({ bytes, reason }) {
    if (bytes) return receive(bytes);
    turns++;
    held = shown = null;
    keyed = "";
    by("key").replaceChildren();
    complain(reason);
    point(null);
    legend();
    plane.draw();
  },
  progress({ text, trouble, share }) {
    say("progress", text);
    say("missing", trouble);
    const bar = by("bar"), now = String(Math.floor(100 * share));
    bar.hidden = share >= 1;
    if (bar.getAttribute("aria-valuenow") !== now) bar.setAttribute("aria-valuenow", now), (bar.style.width = `${now}%`);
  },
  refused: ({ reason }) => complain(reason),
  cell(given) {
    details.cell(given);
    if (given.solving || !isClicked) return;
    isClicked = false;
    if (matchMedia("(min-width: 1100px)").matches) by("cell").scrollIntoView();
  },
  motion: details.motion, portraits: details.portraits, attractors: details.attractors,
  offer: follow.offer, follow: follow.follow, branch: follow.branch,
  orbit(given) { follow.orbit(given); plane.draw(); },
  cut: cut.tell,
};

window.onpopstate = () => location.reload();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { updateKey(by("key")); follow.draw(); details.draw(); cut.draw(); });
if (matchMedia("(max-width: 639px)").matches) by("controls").open = false;
by("map").ariaLabel = `map of ${subject.axes[0].label} across and ${subject.axes[1].label} up`;
use("move");
refresh();
const link = linkTo(() => new URL(`ws${location.search}`, location.href).href.replace(/^http/, "ws"), (message) => HEARD[message.tell](message));

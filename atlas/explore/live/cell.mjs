// What the live page shows of the chosen cell: its numbers, its attractors, its motion, and its orbit along a parameter.

import { by, copying, make } from "../front/elements.mjs";
import { drawDiagram, rangeOf } from "./diagram.mjs";
import { place } from "../front/plane.mjs";
import { number, resultsOf } from "../front/words.mjs";
import { menu } from "./controls.mjs";

const SECONDS = 3; // duration of one forcing period on the screen
const STABLE = "#3b7dc4", UNSTABLE = "#c25a6c", BLUE = "#4477aa", GREY = "#7a8696";
export const INK = "#aa3377"; // of the followed orbit

const cellsOf = (tag, texts) => texts.map((textContent) => make(tag, { textContent }));
const rowOf = (head, text, title = "") => make("tr", {}, make("th", { scope: "row", textContent: head }), make("td", { className: /^[−\d]/.test(text) ? "number" : "", title, textContent: text }));
const trouble = (textContent) => make("p", { className: "trouble", textContent });

/** Return an element that shows motions: portraits in the phase plane, and the machine, which a button sets in motion. */
export function motionPanel(lanes) {
  const phase = make("canvas", { className: "phase", role: "img", ariaLabel: "phase plane: velocity over gap coordinate" });
  const machine = make("canvas", { className: "machine", role: "img", ariaLabel: "the machine" });
  const play = make("button", { type: "button", textContent: "move the machine", ariaPressed: "false" });
  const made = make("div", { hidden: true }, phase, machine, play);
  machine.style.height = `${64 + 26 * lanes.length}px`;
  let portraits = [], motion = null, begun = null, at = 0;
  const draw = () => {
    if (!motion || made.hidden) return;
    const ranges = ["y", "v"].map((name) => rangeOf(portraits.flatMap(({ [name]: values }) => rangeOf(values, 0))));
    drawDiagram(phase, { x: { label: "gap coordinate", range: ranges[0] }, y: { label: "velocity", range: ranges[1] }, parts: [
      ...portraits.map(({ y: x, v: y, color }) => ({ kind: "line", x, y, color })),
      { kind: "dots", x: [motion.moving[0][at]], y: [motion.moving[1][at]] }] });
    const places = motion.moving.slice(2), stops = motion.stops.map((x) => ({ kind: "line", x: [x, x], y: [motion.lane - 0.4, motion.lane + 0.4], width: 5, color: GREY }));
    drawDiagram(machine, { x: { label: "", range: rangeOf([...places.flatMap((place) => rangeOf(place, 0)), ...motion.stops], 0.1) }, y: { label: "", range: [lanes.length - 0.4, -0.6], texts: lanes },
      parts: [...stops, { kind: "dots", x: places.map((place) => place[at]), y: places.map((_, lane) => lane), size: 17, square: true, color: BLUE }] });
  };
  const step = (now) => {
    if (begun === null || !motion || !made.isConnected) return;
    begun ||= now;
    at = Math.floor(((now - begun) / 1000 / SECONDS) * motion.per_period) % motion.moving[0].length;
    draw();
    requestAnimationFrame(step);
  };
  play.onclick = () => {
    begun = begun === null ? 0 : null;
    play.ariaPressed = String(begun !== null);
    requestAnimationFrame(step);
  };
  new ResizeObserver(draw).observe(made);
  return Object.assign(made, {
    draw,
    clear() { Object.assign(made, { hidden: true }); [portraits, motion, begun, at] = [[], null, null, 0]; play.ariaPressed = "false"; },
    portray(several) { portraits = several; draw(); },
    show(given) {
      [motion, at] = [given, 0];
      if (portraits.length < 2) portraits = [{ ...given, color: BLUE }];
      made.hidden = false;
      draw();
    },
  });
}

/** Return the part of the page about the chosen cell; its functions are called with what the server tells of the cell. */
export function cellPanel({ subject }) {
  const motion = motionPanel(subject.lanes), attractors = make("div", {}), reason = make("div", {}), numbers = make("div", {}), head = make("div", { ariaLive: "polite" });
  head.append(make("p", { className: "note", textContent: "Click a cell: its motion and all its attractors." }));
  by("cell").append(head, by("follow"), attractors, motion, reason, numbers);
  const empty = (...elements) => elements.forEach((element) => element.replaceChildren());
  return {
    draw: motion.draw,
    cell({ solving, places, regime, given, command, text }) {
      if (solving) {
        empty(attractors, reason, numbers);
        motion.clear();
        return head.replaceChildren(make("h2", { textContent: "cell clicked" }), make("p", { className: "note", textContent: "solving it" }));
      }
      const equations = places.flatMap(([symbol, value]) => [make("span", { className: "number" }, make("i", { textContent: symbol }), ` = ${value}`), ", "]);
      const line = make("code", { tabIndex: 0, textContent: command });
      head.replaceChildren(make("h2", { textContent: "cell clicked" }), make("p", {}, ...equations, regime), make("div", { className: "line" }, line, copying("copy", () => command)));
      const { caption, variables, values } = given, arrays = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, [Number(value ?? NaN)]]));
      const rows = given.places.map(([symbol, value]) => rowOf(symbol, number(value), value));
      rows.push(...resultsOf({ ...subject, variables, arrays: {} }, Object.keys(variables), 0, arrays).map(([label, words, name]) => rowOf(label, words, values[name])));
      numbers.replaceChildren(make("table", {}, make("caption", { textContent: caption }), ...rows), copying("copy all numbers, in full", () => text));
    },
    motion({ motion: found, reason: why }) {
      if (found) motion.show(found);
      reason.replaceChildren(...(why ? [make("p", { className: "note", textContent: why })] : []));
    },
    portraits: ({ portraits }) => motion.portray(portraits),
    attractors({ waiting, heads, rows, note, trouble: why }) {
      const title = make("h2", { textContent: "all attractors of this cell" });
      if (why) return attractors.replaceChildren(title, trouble(why));
      const table = heads ? [make("div", { className: "scrolled" }, make("table", { className: "list" }, make("tr", {}, ...cellsOf("th", ["", ...heads])),
        ...rows.map(([color, ...texts]) => make("tr", {}, make("td", { textContent: "●", style: `color: ${color}` }), ...cellsOf("td", texts)))))] : [];
      attractors.replaceChildren(title, ...table, make("p", { className: "note", textContent: waiting || note }));
    },
  };
}

/** Return the part of the page that follows the orbit of the chosen cell. The page has `subject`, `state()`, and the functions
 * change(given) and request(ask, given). */
export function followPanel({ subject, state, change, request }) {
  const says = make("p", { className: "note", role: "status" }), body = make("div", {}), motion = motionPanel(subject.lanes);
  let along = subject.follow[0][0], branch = null, here = null, parts = null;
  const follows = () => state().follow?.startsWith(`${along},`);
  const press = make("button", { type: "button", onclick: async () => {
    if (follows()) return change({ follow: null });
    const { follow } = await request("follow", { along });
    change({ follow });
  } });
  const choice = menu("its orbit along", subject.follow, along, (name) => { along = name; update(); }), select = choice.querySelector("select");
  const panel = by("follow");
  panel.append(make("div", { className: "line" }, choice, press), says, body);
  const go = (index, value) => {
    const [name, low, high] = state().follow.split(",");
    change({ follow: [name, low, high, index - branch.own, value].join(",") });
  };
  const drawBranch = () => {
    if (!here) return;
    const { diagram } = parts, y = rangeOf(branch.stretches.flatMap(([, , gap]) => rangeOf(gap, 0)));
    const ticked = branch.events.map(([, x]) => x), gaps = branch.events.map(([, , gap]) => gap);
    parts.scene = drawDiagram(diagram, { x: { label: branch.symbol, range: rangeOf(branch.values, 0.04) }, y: { label: "gap at t = kT", range: y }, parts: [
      ...branch.stretches.map(([stable, x, gap]) => ({ kind: "line", x, y: gap, color: stable ? STABLE : UNSTABLE, dash: stable ? [] : [5, 4] })),
      { kind: "dots", x: ticked, y: gaps, size: 6 },
      { kind: "line", x: [here.value, here.value], y, color: INK, width: 1 },
      { kind: "dots", x: here.gap.map(() => here.value), y: here.gap, color: INK }] });
  };
  const update = () => {
    if (!state().follow) [branch, here] = [null, null], motion.clear(), body.replaceChildren();
    press.textContent = follows() ? "end following" : "follow";
  };
  new ResizeObserver(drawBranch).observe(panel);
  return {
    update, draw() { motion.draw(); drawBranch(); },
    marks: () => (state().follow && here ? here : null),
    offer({ possible }) { panel.hidden = !possible && !state().follow; },
    follow({ along: name, says: text, ended }) {
      if (name) [along, select.value] = [name, name];
      panel.hidden = false;
      if (ended) change({ follow: null });
      says.textContent = text;
      update();
    },
    branch(given) {
      if (!state().follow) return;
      [branch, here] = [given, null];
      says.textContent = "";
      const range = make("input", { type: "range", min: 0, max: branch.values.length - 1, step: 1, ariaLabel: "along the branch" });
      const typed = make("input", { type: "number", step: "any", ariaLabel: branch.symbol });
      const diagram = make("canvas", { className: "branch", role: "img", ariaLabel: "branch of the orbit" }), table = make("div", { ariaLive: "polite" });
      range.oninput = () => go(Number(range.value), branch.values[Number(range.value)]);
      typed.onchange = () => request("find", { value: typed.valueAsNumber }, () => { typed.value = here.value; }).then(({ follow }) => change({ follow }));
      diagram.onpointermove = ({ offsetX, offsetY }) => {
        const near = parts.scene && branch.events.find(([, x, gap]) => Math.hypot(...[x, gap].map((value, k) => place(parts.scene, value, k) - [offsetX, offsetY][k])) < 8);
        diagram.title = near ? `${near[0]} at ${number(near[1], 10)}` : "";
      };
      parts = { range, typed, diagram, table };
      body.replaceChildren(make("div", { className: "line" }, range, typed), table, diagram, motion);
    },
    orbit(given) {
      if (!state().follow || !branch) return;
      here = given;
      parts.range.value = here.index;
      parts.typed.value = here.value;
      parts.table.replaceChildren(make("table", {}, make("caption", { textContent: here.caption }), ...here.rows.map(([head, text]) => rowOf(head, text))));
      motion.portray([]);
      motion.show(here.motion);
      drawBranch();
    },
  };
}

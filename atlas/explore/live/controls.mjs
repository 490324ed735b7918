// The controls of the live page: parameters, axes, layers, cuts, pictures and new atlases.

import { by, make } from "../front/elements.mjs";
import { middleOf } from "./state.mjs";

const button = (textContent, onclick) => make("button", { type: "button", textContent, onclick });

/** Return a menu with a label; `options` are pairs of a value and a text, and `act` is called with the chosen value. */
export function menu(label, options, value, act) {
  const select = make("select", { ariaLabel: label }, ...options.map(([value, textContent]) => make("option", { value, textContent })));
  select.value = value;
  select.onchange = () => act(select.value);
  return make("label", { className: "menu" }, label, select);
}

/** Return a slider and a number field of a parameter; `change(value, rests)` is called with its values, which `rests`
 * says are final. `show` on the element sets the value shown. */
export function slider({ label, low, high, step }, value, change) {
  const range = make("input", { type: "range", step: "any", ariaLabel: label }), typed = make("input", { type: "number", step: "any", ariaLabel: `${label}: value` });
  const show = (now) => {
    Object.assign(range, { min: Math.min(low, now), max: Math.max(high, now), step: "any", value: now });
    if (document.activeElement !== typed || typed.valueAsNumber !== now) typed.value = now;
  };
  range.oninput = () => change(Number(range.value), false);
  range.onkeydown = (event) => {
    const turn = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
    if (!turn) return;
    event.preventDefault();
    change(Math.min(Number(range.max), Math.max(Number(range.min), Number((Number(range.value) + turn * step).toPrecision(12)))), false);
  };
  typed.onchange = () => { if (!Number.isNaN(typed.valueAsNumber)) change(typed.valueAsNumber, true); };
  show(value);
  return Object.assign(make("div", { className: "slider" }, make("span", { textContent: label, ariaHidden: true }), range, typed), { show });
}

/** Fill the groups of controls. The page has `subject`, `state()`, `axes()`, and the functions change(given, rests), go(given) to
 * other axes or another layer, and request(ask, given), which promises an answer. */
export function fillControls({ subject, state, axes, change, go, request }) {
  const sliders = subject.parameters.map((parameter) => {
    const { name } = parameter, made = slider(parameter, state().parameters[name], (value, rests) => {
      if (value !== state().parameters[name]) change({ parameters: { ...state().parameters, [name]: value } }, rests);
    });
    made.update = () => made.show(state().parameters[name]);
    by(parameter.initial ? "initial" : "parameters").append(made);
    return made;
  });
  by("initial").hidden = !subject.parameters.some(({ initial }) => initial);
  const names = subject.names, other = (along, name) => (names[1 - along] === name ? names[along] : names[1 - along]);
  ["across", "up"].forEach((label, along) => by("axes").append(menu(label, subject.options, names[along], (name) =>
    go({ axes: along ? [other(1, name), name] : [name, other(0, name)] }))));
  if (subject.layers) by("axes").append(menu(subject.layers.label, subject.layers.values.map((value) => [value, value]), subject.layers.value, (value) => go({ layer: Number(value) })));
  const straight = (along) => {
    const [x, y] = middleOf(state(), axes()), { x: [left, right], y: [low, high] } = state();
    change({ cut: along ? [x, low, x, high] : [left, y, right, y] });
  };
  by("cutting").append(button("cut across", () => straight(0)), button("cut up", () => straight(1)));
  const saved = (suffix) => request("save", { suffix }).then(({ name, href }) => make("a", { href, download: name }).click());
  by("saving").append(...["png", "svg", "pdf"].map((suffix) => button(suffix.toUpperCase(), () => saved(suffix))));
  const cells = make("input", { type: "number", min: 2, max: 100000, value: subject.cells, ariaLabel: "cells across" });
  by("making").append(make("label", { className: "menu" }, "cells across", cells), button("make this an atlas", async () => {
    by("made").replaceChildren(make("p", { className: "note", textContent: "solving a few cells for its cost" }));
    const done = await request("make", { box: state().box, cells: Math.round(cells.valueAsNumber) || subject.cells }, () => by("made").replaceChildren());
    by("made").replaceChildren(make("h2", { textContent: `new atlas: ${done.file}` }), ...[done.text, done.line, done.cost].map((textContent) => make("pre", { tabIndex: 0, textContent })));
  }));
  return () => sliders.forEach((made) => made.update());
}

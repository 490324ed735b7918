// The cut of the live page: its line over the plane, and the diagrams of the cells along it.

import { drawDiagram, rangeOf } from "./diagram.mjs";
import { by, make } from "../front/elements.mjs";
import { place } from "../front/plane.mjs";
import { menu } from "./controls.mjs";

const LINE = "#3b7dc4", POINTED = "#c25a6c";
const pairsOf = ([x0, y0, x1, y1]) => [[x0, x1], [y0, y1]];

/** Return the part of the page about its cut. The page has `subject`, `state()`, `axes()`, and the functions change(given) and
 * redraw(), which draws the plane again. `shows()` is the quantity that is shown. */
export function cutPanel({ subject, state, axes, change, redraw, ask }) {
  const says = make("p", { className: "note", role: "status" });
  let cut = null, window = null, share = null, dragged = null;
  const canvases = ["section states along the cut", "exponent along the cut"].map((ariaLabel) => make("canvas", { role: "img", ariaLabel }));
  const choice = menu("", subject.shows.map((words) => [words, words]), subject.shows[0], () => ask());
  const [select] = choice.getElementsByTagName("select");
  select.ariaLabel = "what the cut shows";
  const close = make("button", { type: "button", textContent: "close the cut", onclick: () => change({ cut: null }) });
  by("cut").append(make("div", { className: "line" }, says, choice, close), ...canvases);

  const ends = () => pairsOf(state().cut).map((pair, along) => pair.map(axes()[along].to));
  const on = (along, at) => axes()[along].from(ends()[along][0] + at * (ends()[along][1] - ends()[along][0]));
  const point = (at) => {
    share = at === null ? null : Math.min(1, Math.max(0, at));
    draw();
    redraw();
  };
  const draw = () => {
    if (!cut || !state().cut) return;
    const marked = share === null ? [] : [on(cut.axis, share)];
    const { shown: { x, y }, exponents } = cut, { largest, low, high } = exponents, span = rangeOf([...low, ...high, 0]);
    const across = (y) => marked.map((at) => ({ kind: "line", x: [at, at], y, color: POINTED, width: 2, dash: [4, 4] }));
    cut.scenes = [
      drawDiagram(canvases[0], { x: { label: "", range: window, texts: [] }, y: { label: select.value, range: rangeOf(y) }, parts: [{ kind: "points", x, y }, ...across(rangeOf(y))] }),
      drawDiagram(canvases[1], { x: { label: cut.label, range: window }, y: { label: "exponent", range: span }, parts: [
        { kind: "line", x: window, y: [0, 0], color: "#9aa4b0", width: 1 }, { kind: "band", x: exponents.x, low, high, color: LINE },
        { kind: "line", x: exponents.x, y: largest, color: LINE }, ...across(span)] })];
  };
  const valueAt = ({ offsetX }) => {
    const { plot: { left, width } } = cut.scenes[0];
    return window[0] + ((offsetX - left) / width) * (window[1] - window[0]);
  };
  for (const canvas of canvases) {
    canvas.onpointermove = (event) => {
      if (dragged !== null) {
        const moved = dragged - valueAt(event);
        window = window.map((end) => end + moved);
        return draw();
      }
      const { to } = axes()[cut.axis], [first, last] = ends()[cut.axis];
      point((to(valueAt(event)) - first) / (last - first));
    };
    canvas.onpointerdown = (event) => { dragged = valueAt(event); canvas.setPointerCapture(event.pointerId); };
    canvas.onpointerup = canvas.onpointercancel = () => { dragged = null; };
    canvas.onpointerleave = () => point(null);
    canvas.ondblclick = () => { window = cut.range; draw(); };
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const at = valueAt(event), factor = Math.exp(Math.max(-0.5, Math.min(0.5, 0.002 * event.deltaY)));
      window = window.map((end) => at + factor * (end - at));
      draw();
    }, { passive: false });
  }
  new ResizeObserver(draw).observe(by("cut"));
  return {
    draw, shows: () => select.value,
    update() {
      by("cut").hidden = !state().cut;
      if (!state().cut) [cut, share] = [null, null];
    },
    /** Mark the point of the line that is nearest to a point of the plane. */
    near(at) {
      if (!cut || !state().cut) return;
      const limits = [state().x, state().y].map((pair, along) => pair.map(axes()[along].to));
      const scaled = (value, along) => value / (limits[along][1] - limits[along][0]);
      const reach = ends().map(([first, last], along) => scaled(last - first, along));
      const here = at && at.map((value, along) => scaled(axes()[along].to(value) - ends()[along][0], along));
      point(here && (reach[0] * here[0] + reach[1] * here[1]) / (reach[0] ** 2 + reach[1] ** 2));
    },
    tell(given) {
      if (!cut || cut.label !== given.label || String(cut.range) !== String(given.range)) window = given.range;
      cut = given;
      says.textContent = given.says;
      draw();
    },
    over(pen, scene) {
      if (!state().cut) return;
      const [[x0, x1], [y0, y1]] = pairsOf(state().cut).map((pair, along) => pair.map((value) => place(scene, value, along)));
      for (const [color, width] of [["#ffffff", 5], ["#000000", 2]]) {
        Object.assign(pen, { strokeStyle: color, lineWidth: width });
        pen.beginPath();
        pen.moveTo(x0, y0);
        pen.lineTo(x1, y1);
        pen.stroke();
      }
      if (share === null || !cut) return;
      pen.beginPath();
      pen.arc(place(scene, on(0, share), 0), place(scene, on(1, share), 1), 4.5, 0, 7);
      Object.assign(pen, { fillStyle: "#ffffff", strokeStyle: "#000000", lineWidth: 1.5 });
      pen.fill();
      pen.stroke();
    },
  };
}

// Actions of the explorer's widgets in the browser. Bokeh calls each with given models and the model that has changed.

import { copied } from "./elements.mjs";
import { scales } from "./live.mjs";

const SECONDS = 3; // duration of one forcing period on the screen

const find = (node) => [...node.querySelectorAll("*")].flatMap(
  (element) => [element, ...(element.shadowRoot ? find(element.shadowRoot) : [])]);

/** Give each focusable element without a label the name, for screen readers, of the nearest enclosing element. */
export function nameAll() {
  const above = (element) => element.parentNode instanceof ShadowRoot ? element.parentNode.host : element.parentElement
  const used = "input, select, [role=slider], .bk-events, .bk-spin-btn"
  const name = () => {
      for (const element of find(document).filter((element) => element.matches(used))) {
          if (element.ariaLabel || [...(element.labels ?? [])].some((label) => label.textContent.trim())) continue
          let from = element
          while (from && !from.ariaLabel) from = above(from)
          const step = {"bk-spin-btn-up": "more", "bk-spin-btn-down": "fewer"}[element.classList[1]]
          element.ariaLabel = step ?? from?.ariaLabel ?? (element.matches(".bk-events") ? "diagram" : "")
          if (element.matches(".bk-events")) element.role = "application"
      }
  }
  name()
  setTimeout(name, 1000)
}

/** Return the text of an axis tick: (tick - base) / unit with a number of decimals. */
export function tickText(tick, base, unit, decimals) {
  const text = Math.abs(unit) === 1 && base === 0
      ? (Math.abs(tick) >= 1e5 || (tick !== 0 && Math.abs(tick) < 1e-4) ? tick.toExponential(2)
         : Number(tick.toFixed(Math.max(decimals, 3))).toString())
      : Number(((tick - base) / unit).toFixed(decimals)).toString()
  return text.replace("-", "\u2212")
}

/** Mark the point of the cut that is nearest to the pointer, in the plane and in all diagrams of the cut. */
export function linkPointer({ line, plane, axis, spans_of, dot, of_plane }, cb_obj) {
  const [x0, x1] = line.data.xs[0] ? [line.data.xs[0][0], line.data.xs[0].at(-1)] : [NaN, NaN]
  const [y0, y1] = line.data.ys[0] ? [line.data.ys[0][0], line.data.ys[0].at(-1)] : [NaN, NaN]
  if (Number.isNaN(x0) || cb_obj.x == null) return
  const both = scales(), ends = [[x0, x1], [y0, y1]].map((pair, k) => pair.map(both[k][0]))
  const at = (k, share) => both[k][1](ends[k][0] + share * (ends[k][1] - ends[k][0]))
  let share
  if (of_plane) {
      const spans = [plane.x_range, plane.y_range].map((range, k) => both[k][0](range.end) - both[k][0](range.start))
      const along = ends.map((pair, k) => (pair[1] - pair[0]) / spans[k])
      const here = [cb_obj.x, cb_obj.y].map((v, k) => (both[k][0](v) - ends[k][0]) / spans[k])
      share = (along[0] * here[0] + along[1] * here[1]) / (along[0] ** 2 + along[1] ** 2)
  } else {
      const k = axis.data.along[0]
      share = (both[k][0](cb_obj.x) - ends[k][0]) / (ends[k][1] - ends[k][0])
  }
  share = Math.min(1, Math.max(0, share))
  for (const span of spans_of) span.setv({location: at(axis.data.along[0], share)}, {sync: false})
  dot.setv({data: {at_x: [at(0, share)], at_y: [at(1, share)]}}, {sync: false})
}

/** Animate the machine along its orbit while the toggle `cb_obj` is active. */
export function play({ path, here, machine, pace }, cb_obj) {
  let begin = null
  const step = (now) => {
      const {y, v, ...masses} = path.data
      const lanes = Object.keys(masses).filter((name) => name.startsWith("q")).sort()
      if (!cb_obj.active || !y.length) return
      begin ??= now
      const k = Math.floor((now - begin) / 1000 / SECONDS * pace.data.per_period[0]) % y.length
      here.setv({data: {now_y: [y[k]], now_v: [v[k]]}}, {sync: false})
      machine.setv({data: {at: lanes.map((name) => masses[name][k]), lane: lanes.map((_, i) => i)}}, {sync: false})
      requestAnimationFrame(step)
  }
  requestAnimationFrame(step)
}

/** Copy the value, or the first tag, of the model `source` to the clipboard. */
export const copy = ({ source }) => copied(source.value ?? source.tags[0]);

/** Save the file whose name and data URL a Bokeh data source holds. */
export function download(_, { data }) {
  const link = document.createElement("a");
  link.href = data.href[0];
  link.download = data.name[0];
  link.click();
}

/** Give `model` the CSS class `name` while a property of the model `cb_obj` is set, or with `unless` is not set. */
export function mark({ model, name, property, unless }, cb_obj) {
  model.css_classes = Boolean(cb_obj[property]) === !unless ? [name] : [];
}

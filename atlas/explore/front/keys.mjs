// Handles keys and touch: arrows move the window, + and - zoom it, Enter chooses the cell in its middle, Esc ends a
// followed orbit, the cut or an enlarged picture; two fingers zoom, each staying on its cell.

import { scales, tell } from "./live.mjs";

const SHARE = 0.1; // of the window, by which an arrow moves it
const FACTOR = 1.25; // factor of one zoom step

/** Listen to keys and fingers, and report to the server through the data of the model `heard`: new limits `x` and `y`
 * of the window of `plot`, a chosen `cell`, or `escape`. */
export function hearKeys({ heard, plot }) {
  const moves = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}
  window.addEventListener("keydown", (event) => {
      const at = event.composedPath()[0]
      const own = event.key === "Escape" ? "input, select, textarea" : "input, select, textarea, [role=slider]"
      if (event.ctrlKey || event.metaKey || event.altKey || at.closest?.(own)) return
      if (event.key === "Escape") {
          const find = (node) => [...node.querySelectorAll("*")].flatMap(
              (element) => [element, ...(element.shadowRoot ? find(element.shadowRoot) : [])])
          const large = find(document).filter((element) => element.classList.contains("large"))
          if (large.length) large.forEach((element) => element.classList.remove("large"))
          else heard.data = {escape: [(heard.data.escape?.[0] ?? 0) + 1]}
          return
      }
      if (event.key === "Enter" && at.matches?.(".bk-events")) {
          const middle = [plot.x_range, plot.y_range].map(({start, end}, k) => {
              const [to, from] = scales()[k]
              return from(0.5 * (to(start) + to(end)))
          })
          heard.data = {cell: [...middle, (heard.data.cell?.[2] ?? 0) + 1]}
          return
      }
      const zoom = {"+": 1 / FACTOR, "=": 1 / FACTOR, "-": FACTOR}[event.key]
      const move = moves[event.key]
      if (!zoom && !move) return
      event.preventDefault()
      const [x, y] = [plot.x_range, plot.y_range].map((range, k) => {
          const [to, from] = scales()[k]
          const [low, high] = [to(range.start), to(range.end)]
          const middle = 0.5 * (low + high) + (move ? move[k] * SHARE * (high - low) : 0)
          const half = 0.5 * (high - low) * (zoom ?? 1)
          range.setv({start: from(middle - half), end: from(middle + half)})
          return [range.start, range.end]
      })
      tell()
      heard.data = {x, y}
  })
  const fingers = new Map()
  let begun = null
  const two = () => {
      const [[a, b], [c, d]] = [...fingers.values()]
      return {apart: Math.hypot(a - c, b - d), middle: [(a + c) / 2, (b + d) / 2]}
  }
  window.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "touch" || !event.composedPath()[0].closest?.(".bk-events")) return
      fingers.set(event.pointerId, [event.clientX, event.clientY])
      const view = Bokeh.index.find_one(plot)
      if (fingers.size !== 2 || !view) return
      const box = view.el.getBoundingClientRect(), {left, top, width, height} = view.frame.bbox
      const inside = ([x, y]) => [(x - box.left - left) / width, 1 - (y - box.top - top) / height]
      if (inside(two().middle).every((share) => share >= 0 && share <= 1))
          begun = {...two(), inside, ends: [plot.x_range, plot.y_range].map(({start, end}) => [start, end])}
  }, true)
  window.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId)) return
      fingers.set(event.pointerId, [event.clientX, event.clientY])
      if (begun && fingers.size === 2) setTimeout(part, 0, begun, two()) // after Bokeh, which stops some of these events
  }, true)
  const part = (old, now) => [plot.x_range, plot.y_range].forEach((range, k) => {
      const [to, from] = scales()[k]
      const [low, high] = old.ends[k].map(to), span = high - low, zoom = old.apart / now.apart
      const start = low + span * (old.inside(old.middle)[k] - zoom * old.inside(now.middle)[k])
      range.setv({start: from(start), end: from(start + zoom * span)})
  })
  for (const kind of ["pointerup", "pointercancel"]) window.addEventListener(kind, (event) => {
      if (!fingers.delete(event.pointerId) || !begun) return
      begun = null
      setTimeout(() => {
          const [x, y] = [plot.x_range, plot.y_range].map(({start, end}) => [start, end])
          tell()
          heard.data = {x, y}
      }, 50)
  }, true)
}

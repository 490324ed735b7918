// The plane as an element: it draws the scene of a page in a canvas, and turns gestures and keys into windows of the
// plane, points and lines.

import { fitted, oncePerFrame, themed } from "./elements.mjs";
import { drawAxes, drawPlane, place } from "./plane.mjs";

const FACTOR = 0.7, SHARE = 0.2; // of a step of zooming, and of the window by which a key moves it
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const WHOLE = [0.5, 0.5];

/** Show the plane of a page in a canvas; return { draw, scene }: functions that draw it in the next
 * frame, and that give its present scene.
 *
 * The page has `axes()`, `window()` with limits in the drawn coordinates, and `scene()` with the rest of a scene. It is
 * called: move(window) with another window, whole() for that of the whole plane, choose(point) with the values of the
 * axes at a click, point(point or null) for the pointer, escape(), and enlarged(labels) after each picture. It may have
 * step(direction), called for arrows without Shift; resized(width, height); tool(), which names what a drag draws in
 * place of moving the plane, and then drawn(from, to); and `keys`, the element that hears keys in place of the canvas.
 */
export function planeOn(canvas, page) {
  const plot = { left: 64, top: 8, width: 1, height: 1 }, fingers = new Map();
  let pressed = null, line = null;
  const scene = () => ({ axes: page.axes(), window: page.window(), plot, ...page.scene() });

  const draw = oncePerFrame(() => {
    const { context, ratio, width, height } = fitted(canvas), before = [plot.width, plot.height];
    Object.assign(plot, { width: Math.max(1, Math.floor(width - plot.left - 12)), height: Math.max(1, Math.floor(height - plot.top - 46)) });
    if (before[0] !== plot.width || before[1] !== plot.height) page.resized?.(plot.width, plot.height);
    const now = scene();
    drawAxes(context, now, themed("--ink"), themed("--faint"));
    if (now.shown) page.enlarged(drawPlane(context, now, ratio));
    if (line) drawLine(context, now);
  });

  function drawLine(pen, now) {
    const [[x0, y0], [x1, y1]] = line.map((point) => point.map((value, along) => place(now, value, along)));
    for (const [color, width] of [["#ffffff", 4], ["#000000", 1.6]]) {
      Object.assign(pen, { strokeStyle: color, lineWidth: width });
      pen.beginPath();
      if (page.tool() === "line") pen.moveTo(x0, y0), pen.lineTo(x1, y1);
      else pen.rect(x0, y0, x1 - x0, y1 - y0);
      pen.stroke();
    }
  }

  /** Zoom by a factor about a point of the plot, given by shares of its width and height, and move by shares. */
  const zoom = (factor, shares = WHOLE, moved = [0, 0]) => page.move(page.window().map(([low, high], along) => {
    const at = low + shares[along] * (high - low), shift = moved[along] * (high - low);
    return [at + factor * (low - at) - shift, at + factor * (high - at) - shift];
  }));

  const sharesAt = ({ clientX, clientY }) => {
    const box = canvas.getBoundingClientRect();
    return [(clientX - box.left - plot.left) / plot.width, 1 - (clientY - box.top - plot.top) / plot.height];
  };
  const pointAt = (shares) => {
    const window = page.window();
    return page.axes().map(({ from }, along) => from(window[along][0] + shares[along] * (window[along][1] - window[along][0])));
  };
  const isInside = (shares) => shares.every((share) => share >= 0 && share < 1);
  const clipped = (shares) => shares.map((share) => Math.min(1, Math.max(0, share)));
  const draws = () => (page.tool?.() || "move") !== "move";

  canvas.onpointerdown = (event) => {
    if (event.button) return;
    fingers.set(event.pointerId, event);
    canvas.setPointerCapture(event.pointerId);
    pressed = fingers.size === 1 ? event : null;
  };

  canvas.onpointermove = (event) => {
    if (!fingers.has(event.pointerId)) {
      const shares = sharesAt(event);
      return page.point(isInside(shares) ? pointAt(shares) : null);
    }
    const before = [...fingers.values()], old = fingers.get(event.pointerId);
    if (pressed && Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) < 5) return;
    if (draws() && fingers.size === 1) {
      line = [line ? line[0] : pointAt(clipped(sharesAt(pressed || event))), pointAt(clipped(sharesAt(event)))];
      pressed = null;
      return draw();
    }
    pressed = null;
    fingers.set(event.pointerId, event);
    const now = [...fingers.values()];
    if (now.length === 1) return zoom(1, WHOLE, sharesAt(event).map((share, along) => share - sharesAt(old)[along]));
    const [one, other] = [before, now].map(([a, b]) => ({
      size: Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY),
      middle: sharesAt({ clientX: (a.clientX + b.clientX) / 2, clientY: (a.clientY + b.clientY) / 2 }),
    }));
    zoom(one.size / other.size, other.middle, other.middle.map((share, along) => share - one.middle[along]));
  };

  canvas.onpointerup = canvas.onpointercancel = (event) => {
    fingers.delete(event.pointerId);
    const ended = event.type === "pointerup", drawn = line;
    if (ended && pressed && isInside(sharesAt(event))) page.choose(pointAt(sharesAt(event)));
    pressed = line = null;
    if (drawn && ended) page.drawn(...drawn);
    if (drawn) draw();
  };

  canvas.onpointerleave = () => page.point(null);

  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1;
    zoom(Math.exp(Math.max(-0.5, Math.min(0.5, 0.002 * lines * event.deltaY))), sharesAt(event));
  }, { passive: false });

  (page.keys ?? canvas).addEventListener("keydown", (event) => {
    const step = ARROWS[event.key], used = event.key === "Escape" ? "input:not([type=range]), select" : "input, select, textarea";
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest?.(used)) return;
    if (step && !event.shiftKey && page.step) page.step(step);
    else if (step) zoom(1, WHOLE, step.map((share) => -SHARE * share));
    else if (event.key === "+" || event.key === "=") zoom(FACTOR);
    else if (event.key === "-") zoom(1 / FACTOR);
    else if (event.key === "0") page.whole();
    else if (event.key === "Enter" && event.target === canvas) page.choose(pointAt(WHOLE));
    else if (event.key === "Escape") page.escape();
    else return;
    event.preventDefault();
  });

  for (const [id, act] of [["closer", () => zoom(FACTOR)], ["farther", () => zoom(1 / FACTOR)], ["whole", () => page.whole()]])
    document.getElementById(id).onclick = act;
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  return { draw, scene };
}

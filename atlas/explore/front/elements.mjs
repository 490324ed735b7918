// Creates elements of a page, and helps with canvases and animation frames.

/** Return an element with these properties and children. */
export function make(tag, given, ...inside) {
  const made = Object.assign(document.createElement(tag), given);
  made.append(...inside);
  return made;
}

/** Return the context of a canvas whose size is in pixels of the screen. */
export function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  canvas.width = Math.round(box.width * ratio);
  canvas.height = Math.round(box.height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, ratio, width: box.width, height: box.height };
}

/** Return a function that draws in the next frame, once for any number of calls; it is `due` until then. */
export function oncePerFrame(act) {
  const ask = () => {
    if (!ask.due) requestAnimationFrame(() => { ask.due = false; act(); });
    ask.due = true;
  };
  return ask;
}

/** Copy a text, and return whether that was possible. */
export async function copied(text) {
  if (navigator.clipboard) return navigator.clipboard.writeText(text).then(() => true, () => false);
  const box = document.body.appendChild(make("textarea", { value: text })); // plain HTTP has no clipboard
  box.select();
  const done = document.execCommand("copy");
  box.remove();
  return done;
}

// Elements of a page, its canvases and frames.

/** An element with these properties and children. */
export function make(tag, given, ...inside) {
  const made = Object.assign(document.createElement(tag), given);
  made.append(...inside);
  return made;
}

/** The context of a canvas that has its size in pixels of the screen. */
export function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  canvas.width = Math.round(box.width * ratio);
  canvas.height = Math.round(box.height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, ratio, width: box.width, height: box.height };
}

/** A function that has something drawn in the next frame, once however often it is called; it is `due` until then. */
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
  const box = document.body.appendChild(make("textarea", { value: text })); // by plain HTTP there is no clipboard
  box.select();
  const done = document.execCommand("copy");
  box.remove();
  return done;
}

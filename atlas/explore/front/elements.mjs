// Finds and creates elements of a page, and helps with canvases and animation frames.

/** Return the element of the page with an id. */
export const by = (id) => document.getElementById(id);

/** Return the value of a colour of the page's style sheet. */
export const themed = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Return a new HTML element with the properties `given` and the children `inside`. */
export function make(tag, given, ...inside) {
  const made = Object.assign(document.createElement(tag), given);
  made.append(...inside);
  return made;
}

/** Give a canvas the resolution of the screen; return its context, its ratio of screen to CSS pixels, and its size. */
export function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  canvas.width = Math.round(box.width * ratio);
  canvas.height = Math.round(box.height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, ratio, width: box.width, height: box.height };
}

/** Return a function that has `act` called in the next animation frame, once for any number of calls. */
export function oncePerFrame(act) {
  const ask = () => {
    if (!ask.due) requestAnimationFrame(() => { ask.due = false; act(); });
    ask.due = true;
  };
  return ask;
}

/** Return a button with a label that copies the text which the function `text` returns. */
export function copying(label, text) {
  const button = make("button", { type: "button", textContent: label });
  button.onclick = async () => {
    button.textContent = await copied(await text()) ? "copied" : "not copied";
    setTimeout(() => { button.textContent = label; }, 1500);
  };
  return button;
}

async function copied(text) {
  if (navigator.clipboard) return navigator.clipboard.writeText(text).then(() => true, () => false);
  const box = document.body.appendChild(make("textarea", { value: text })); // plain HTTP has no clipboard
  box.select();
  const done = document.execCommand("copy");
  box.remove();
  return done;
}

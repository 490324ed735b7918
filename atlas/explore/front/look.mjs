// The style of a plane: its map, its overlays, its colour limits, and the kinds of curves that are hidden.

import { colorsOf } from "./colors.mjs";
import { make } from "./elements.mjs";
import { updateKey } from "./key.mjs";
import { unpacked } from "./numbers.mjs";

const NUMBER = "number-", LOGARITHM = "-log";
const isNumber = (look) => look.map.startsWith(NUMBER);

/** Return the name of the map that a style chooses: a kind, or a variable with its scale. */
export const mapName = (look) => look.map + (look.log && isNumber(look) ? LOGARITHM : "");

/** Return the style of a plane that an address gives; `given` are the URLSearchParams of the address. */
export function lookOf(given) {
  const list = (name) => (given.get(name) || "").split(",").filter(Boolean);
  const end = (name) => (Number.isFinite(parseFloat(given.get(name))) ? Number(given.get(name)) : null), ends = [end("vmin"), end("vmax")];
  return { map: given.get("kind") === "scalar" ? NUMBER + given.get("variable") : given.get("kind"), log: given.get("log") === "1",
    overlays: list("overlay"), hidden: new Set(list("without")), ends: ends.some((end) => end !== null) ? ends : null };
}

/** Return the query of an address from which `lookOf` reads the style again. */
export function queryOf(look) {
  const pairs = isNumber(look) ? [["kind", "scalar"], ["variable", look.map.slice(NUMBER.length)], ...(look.log ? [["log", "1"]] : [])] : [["kind", look.map]];
  for (const [name, list] of [["overlay", look.overlays], ["without", [...look.hidden]]])
    if (list.length) pairs.push([name, list.join(",")]);
  (look.ends || []).forEach((end, k) => { if (end !== null) pairs.push([["vmin", "vmax"][k], end]); });
  return pairs.map(([name, value]) => `${name}=${encodeURIComponent(value).replaceAll("%2C", ",")}`).join("&");
}

/** Return a style with the fields of `given` changed; if they choose another map, its limits are its own ones. */
export function changed(look, given) {
  const made = { ...look, ...given };
  return mapName(made) !== mapName(look) && !("ends" in given) ? { ...made, ends: null } : made;
}

/** Fill an element with the controls of a style: a menu of `maps` (name, label), with `logs` a switch for logarithms,
 * and a switch for each of `overlays`. `look` returns the style, and `change` is called with changed fields. */
export function fillLook(element, { maps, overlays, logs }, look, change) {
  if (!element.firstChild) {
    const select = make("select", { ariaLabel: "map" });
    for (const label of ["kinds", "numbers of each cell"]) {
      const these = maps.filter(([name]) => name.startsWith(NUMBER) === (label !== "kinds"));
      if (these.length) select.append(make("optgroup", { label }, ...these.map(([value, textContent]) => make("option", { value, textContent }))));
    }
    select.onchange = () => change({ map: select.value });
    select.update = () => { select.value = look().map; };
    element.append(make("label", { className: "map" }, "map", select));
    if (logs) {
      const log = make("input", { type: "checkbox", onchange: () => change({ log: log.checked }) });
      log.update = () => { Object.assign(log, { checked: look().log, disabled: !isNumber(look()) }); };
      element.append(make("label", {}, log, "logarithmic"));
    }
    const over = overlays.map((name) => {
      const box = make("input", { type: "checkbox" });
      box.onchange = () => change({ overlays: overlays.filter((overlay) => (overlay === name ? box.checked : look().overlays.includes(overlay))) });
      box.update = () => { box.checked = look().overlays.includes(name); };
      return make("label", {}, box, name);
    });
    if (over.length) element.append(make("span", { className: "head", textContent: "overlays" }), ...over);
  }
  updateKey(element);
}

/** Return the lines, marks and their styles of all chosen overlays; `lines` are those of a page by overlay. */
export function linesOf(look, lines) {
  const on = look.overlays.map((name) => lines[name]).filter(Boolean), all = (name) => on.flatMap((overlay) => overlay[name] || []);
  return { looks: Object.assign({}, ...on.map(({ looks }) => looks)), marks: Object.assign({}, ...on.map(({ marks }) => marks)),
    lines: all("lines"), corners: all("corners"), ends: all("ends") };
}

/** Return a function that gives the array of a name, unpacked once; `packed` returns its bytes and its type. */
export function reader(packed, width) {
  const read = new Map();
  return (name) => {
    if (!read.has(name)) {
      const { bytes, type } = packed(name);
      read.set(name, unpacked(bytes, type, width));
    }
    return read.get(name);
  };
}

/** Return a map with what is drawn of it: the codes, numbers and colours of its cells, and regions if the style has
 * their borders. `numbers` returns an array by name; `more` names arrays beyond those of the map. */
export async function shownAs(map, look, numbers, more, hasRegions) {
  const names = [...new Set([...map.needs, ...more])], borders = hasRegions && look.overlays.includes("boundaries");
  const [codes, regions, ...several] = await Promise.all([map.codes, borders ? "regions" : map.codes, ...names].map(numbers));
  const values = Object.fromEntries(names.map((name, k) => [name, several[k]]));
  return { map, codes, values, regions: borders ? regions : null, colors: colorsOf(map, codes, values, look.ends) };
}

// Shows the chosen cell of the static page with all its numbers, and the precision of the page's numbers.

import { by, copying, make } from "../front/elements.mjs";
import { number, resultsOf } from "../front/words.mjs";
import { LARGEST, NX, PENDING, REGIME, atlas, axes, numbers } from "./atlas.mjs";

const isCoarse = () => Math.max(...atlas.block) > 1;

/** Return the values of the axes at a cell, given by its column and row, as text. */
export const placeOf = (cell) => axes.map((axis, along) => `${axis.symbol} = ${number(axis.values[cell[along]])}`).join(", ");

async function allNumbers() {
  const names = Object.keys(atlas.arrays).filter((name) => name in atlas.variables || name in atlas.others);
  return Object.fromEntries(await Promise.all(names.map(async (name) => [name, await numbers(name)])));
}

async function fullNumbers(cell) {
  const arrays = await allNumbers(), k = cell[1] * NX + cell[0];
  const found = Object.fromEntries(axes.map(({ name, values }, along) => [name, values[cell[along]]]));
  for (const name in arrays) found[name] = name.split("-")[0] === REGIME ? atlas.regimes[arrays[name][k]] : arrays[name][k];
  return found;
}

function coexisting(k, arrays) {
  const one = (text) => make("td", { textContent: text }), rows = [];
  for (let place = 0; Object.keys(atlas.others).length; place++) {
    const [regime, period, upper, lower, largest, share] = [REGIME, "period", "impacts_upper", "impacts_lower", LARGEST, "share"]
      .map((name) => arrays[place ? `${name}-${place}` : name]?.[k]);
    if (regime === undefined || regime === PENDING) break;
    const isOrbit = atlas.variables.period.regimes.includes(regime), rests = Math.min(upper, lower) < 0;
    rows.push(make("tr", {}, make("th", { scope: "row", textContent: atlas.regimes[regime] }),
      one(isOrbit ? `${period}-${rests ? "rests" : `${upper}-${lower}`}` : ""),
      one(largest === undefined ? "" : number(largest, 4)), one(share === undefined ? "" : `${number(100 * share, 3)} %`)));
  }
  if (!rows.length) return [];
  const heads = ["regime", "n-p-q", "exponent", "share"].map((textContent) => make("th", { scope: "col", textContent }));
  return [make("p", { className: "note", textContent: "Its attractors; below, all numbers of the first:" }), make("table", { className: "all" }, make("tr", {}, ...heads), ...rows)];
}

/** Show all numbers of a cell, given by its column and row, or a hint if it is null. Do nothing if the function `stays`
 * says, once the numbers are read, that another cell has been chosen. */
export async function drawCell(cell, stays) {
  const panel = by("cell"), hint = "Click a cell to see all its numbers.";
  if (!cell) return panel.replaceChildren(make("p", { className: "note", textContent: hint }));
  const arrays = await allNumbers(), k = cell[1] * NX + cell[0];
  if (!stays(cell)) return;
  const names = Object.keys(atlas.variables).filter((name) => name in arrays && name !== REGIME);
  const rows = resultsOf(atlas, [REGIME, ...names], k, arrays).map(([label, text]) => make("tr", {},
    make("th", { scope: "row", textContent: label }), make("td", { textContent: text })));
  const where = placeOf(cell), title = isCoarse() ? `block of up to ${atlas.block.join(" × ")} cells around ${where}` : `cell at ${where}`;
  panel.replaceChildren(make("h2", { textContent: title }), ...coexisting(k, arrays), make("table", {}, ...rows),
    copying("copy all numbers", async () => JSON.stringify(await fullNumbers(cell))));
  if (!atlas.command) return;
  const retried = Object.keys(atlas.allowances).filter((name) => arrays[name]?.[k] > 0);
  const line = [atlas.command, ...axes.map(({ name, values }, along) => `--set ${name}=${values[cell[along]]}`),
    ...retried.map((name) => `${atlas.allowances[name]} ${arrays[name][k]}`)].join(" ");
  panel.append(make("p", { className: "note", textContent: "This command solves the cell again:" }),
    make("code", { textContent: line }), copying("copy command", () => line));
}

/** Fill in the fixed parameters of the page, and how exact its numbers are. */
export function describe() {
  const { fixed, variables, others, arrays, leftOut, block, attractor } = atlas;
  by("fixed").append(...fixed.flatMap(({ symbol, value, meaning }, k) =>
    [k ? ", " : "", make("span", { title: meaning }, make("i", { textContent: symbol }), ` = ${number(value)}`)]));
  const byDigits = new Map();
  const label = (name) => variables[name]?.label || others[name];
  for (const name of [...Object.keys(variables), ...Object.keys(others)])
    if (name in arrays) byDigits.set(arrays[name].digits, [...(byDigits.get(arrays[name].digits) || []), label(name)]);
  const rounded = [...byDigits].filter(([digits]) => digits).sort(([one], [other]) => other - one)
    .map(([digits, labels]) => `${labels.join(", ")}: ${digits} digits`);
  const says = rounded.length ? [`Rounded, to keep this file small: ${rounded.join("; ")}.`, "All other numbers are those of the atlas, to the last bit."]
    : ["All numbers are those of the atlas, to the last bit."];
  if (leftOut.length) says.push(`Left out: ${leftOut.map(label).join(", ")}.`);
  if (isCoarse()) says.push(`A cell of this page stands for up to ${block.join(" × ")} cells of the atlas: numbers are means, of yes and no the share of yes; period and impacts are the most frequent, and the regime too unless cells without a result or undetermined ones are among them.`);
  if (attractor !== null) {
    const rank = attractor ? `number ${attractor + 1} by its share` : "the one with the largest share";
    says.push(`A cell may have several attractors; this page shows ${rank} of the initial states.`);
  }
  by("precision").textContent = says.join(" ");
}

// Words

const raised = (text) => text.replace(/./g, (letter) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(letter)] || "");

function number(value, digits = 6) {
  if (!Number.isFinite(value)) return Number.isNaN(value) ? "none" : value > 0 ? "∞" : "−∞";
  const small = value !== 0 && Math.abs(value) < 1e-3, near = Number(value.toPrecision(digits));
  const [mantissa, power] = (small ? near.toExponential() : String(near)).split("e");
  if (!power) return mantissa.replace("-", "−");
  return `${mantissa === "1" ? "" : `${mantissa.replace("-", "−")}·`}10${raised(power)}`;
}

function withError(value, error, most) {
  if (!(error > 0) || !Number.isFinite(value) || value === 0) return number(value, most);
  const certain = Math.floor(Math.log10(Math.abs(value))) - Math.floor(Math.log10(error)) + 2;
  return `${number(value, Math.min(most, Math.max(1, certain)))} ± ${number(error, 2)}`;
}

const digitsOf = (name) => Math.min(6, atlas.arrays[name].digits || 6);

function inWords(name, k, arrays) {
  const value = arrays[name][k], { flag, endless } = atlas.variables[name];
  if (name === REGIME) return atlas.regimes[value];
  if (name === REASON) return atlas.reasons[value];
  if (name === LARGEST && arrays[ERROR]) return withError(value, arrays[ERROR][k], digitsOf(name));
  if (endless && value < 0) return "without end: at rest on a stop";
  return flag ? (value ? "yes" : "no") : number(value, digitsOf(name));
}

function isResult(name, k, arrays) {
  const value = arrays[name][k];
  if (name === REASON) return value !== 0;
  return name === REGIME || (atlas.variables[name].regimes.includes(arrays[REGIME][k]) && !Number.isNaN(value));
}

const placeOf = (cell) => axes.map((axis, along) => `${axis.symbol} = ${number(axis.values[cell[along]])}`).join(", ");

function sentence(cell) {
  const k = cell[1] * NX + cell[0];
  const rest = shown.map.needs.filter((name) => name !== REGIME && isResult(name, k, shown.values));
  const parts = rest.map((name) => `${atlas.variables[name].label} ${inWords(name, k, shown.values)}`);
  return `${placeOf(cell)}: ${[atlas.regimes[shown.values[REGIME][k]], ...parts].join("; ")}`;
}

// The legend and the cell

function make(tag, given, ...inside) {
  const made = Object.assign(document.createElement(tag), given);
  made.append(...inside);
  return made;
}

function swatch(paint) {
  const canvas = make("canvas", {});
  canvas.paint = () => paint(fitted(canvas));
  return canvas;
}

function boxOf({ color, dark, hatch, ink }) {
  return swatch(({ context, ratio, width, height }) => {
    const fill = context.createLinearGradient(0, 0, width, 0);
    fill.addColorStop(0, color);
    fill.addColorStop(1, dark ? `rgb(${rgb(color).map((part) => part * dark)})` : color);
    context.fillStyle = fill;
    context.fillRect(0, 0, width, height);
    context.fillStyle = ink || color;
    const fine = 1 / ratio;
    for (let y = 0; hatch && y < height; y += fine)
      for (let x = 0; x < width; x += fine) if (inkedBy(hatch, x, y, 8, 0.9)) context.fillRect(x, y, fine, fine);
    context.strokeStyle = "#707070";
    context.strokeRect(0.5, 0.5, width - 1, height - 1);
  });
}

function barOf(bar) {
  const canvas = swatch(({ context, width }) => {
    const table = bar.colors.match(/.{6}/g), [low, high] = scaleEnds(bar), inner = width - 24;
    for (let x = 0; x < inner; x += 0.5) {
      context.fillStyle = `#${table[Math.floor((x / inner) * table.length)]}`;
      context.fillRect(12 + x, 0, 1, 14);
    }
    context.fillStyle = look("--ink");
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    const values = isTwoSided(bar) ? [...ticks(low, 0, 2), ...ticks(0, high, 2).slice(1)] : ticks(low, high, 4, bar.scale === "log");
    for (const value of values) {
      const x = 12 + inner * shareOf(bar, [low, high], value);
      context.fillRect(x - 0.5, 14, 1, 4);
      context.fillText(number(value), x, 30);
    }
    canvas.ariaLabel = `colours from ${number(low)} to ${number(high)}`;
  });
  canvas.setAttribute("role", "img");
  const label = `${bar.title ? `${bar.title}: ` : ""}${bar.label}${isTwoSided(bar) ? " (two linear scales, joined at 0)" : ""}`;
  return make("div", { className: "bar" }, label, canvas);
}

const isTwoSided = (bar) => bar.scale === "two-sided";

function endsOf(bar) {
  const inputs = ["lower", "upper"].map((end) => make("input", { type: "number", step: "any", ariaLabel: `${end} end of the scale` }));
  const update = () => inputs.forEach((input, end) => { input.value = Number(scaleEnds(bar)[end].toPrecision(6)); });
  const set = () => {
    const [low, high] = inputs.map((input) => input.valueAsNumber);
    const fits = low < high && (bar.scale !== "log" || low > 0) && (!isTwoSided(bar) || (low < 0 && high > 0));
    if (fits) change({ ends: [low, high] });
    else update();
  };
  for (const input of inputs) input.onchange = set;
  const reset = make("button", { type: "button", textContent: "reset", onclick: () => change({ ends: null }) });
  return Object.assign(make("div", { className: "ends" }, "from", inputs[0], "to", inputs[1], reset), { update });
}

function lineEntry(kind, label, paint) {
  const box = make("input", { type: "checkbox" });
  box.onchange = () => {
    const hidden = new Set(state.hidden);
    hidden[box.checked ? "delete" : "add"](kind);
    change({ hidden });
  };
  box.update = () => { box.checked = !state.hidden.has(kind); };
  return make("li", {}, make("label", {}, box, swatch(paint), label));
}

function curveEntries() {
  const { looks, marks } = atlas.curves;
  const lines = Object.entries(looks).map(([kind, { label, color, dashes }]) => lineEntry(kind, label, ({ context, width, height }) => {
    for (const [ink, wide, broken] of [["#ffffff", 5, []], [color, 2, dashes.map((dash) => 1.6 * dash)]]) {
      context.strokeStyle = ink;
      context.lineWidth = wide;
      context.setLineDash(broken);
      context.strokeRect(-9, height / 2, width + 18, height);
    }
  }));
  const kinds = Object.values(marks);
  if (kinds.length)
    lines.push(lineEntry("codimension_two", `codimension two: ${kinds.map(({ label }) => label).join(", ")}`,
      ({ context, width, height }) => outlined(context, kinds[0].shape, width / 2, height / 2)));
  if (atlas.curves.ends.length) lines.push(make("li", {}, swatch((canvas) => dot(canvas.context, canvas.width / 2, canvas.height / 2)), "end of a curve"));
  return [make("h2", { textContent: "curves" }), make("ul", {}, ...lines)];
}

function makeKey() {
  const { meaning, title, bars, legend } = state.map, key = by("key");
  key.replaceChildren(make("h2", { textContent: meaning }), ...bars.map(barOf));
  if (bars.length === 1) key.append(endsOf(bars[0]));
  if (title) key.append(make("p", { className: "note", textContent: title }));
  key.append(make("ul", {}, ...legend.map((entry) => make("li", {}, boxOf(entry), entry.label))));
  if (atlas.curves.lines) key.append(...curveEntries());
  updateKey();
}

function updateKey() {
  for (const each of by("key").querySelectorAll("*")) {
    if (each.update) each.update();
    if (each.paint) each.paint();
  }
}

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

async function drawCell() {
  const cell = state.cell, panel = by("cell"), hint = "Click a cell to see all its numbers.";
  if (!cell) return panel.replaceChildren(make("p", { className: "note", textContent: hint }));
  const arrays = await allNumbers(), k = cell[1] * NX + cell[0];
  if (state.cell !== cell) return;
  const names = Object.keys(atlas.variables).filter((name) => name in arrays && name !== REGIME && name !== ERROR);
  const rows = [REGIME, ...names].filter((name) => isResult(name, k, arrays)).map((name) => make("tr", {},
    make("th", { scope: "row", textContent: atlas.variables[name].label }),
    make("td", { textContent: inWords(name, k, arrays) })));
  const where = placeOf(cell), title = isCoarse ? `block of up to ${atlas.block.join(" × ")} cells around ${where}` : `cell at ${where}`;
  panel.replaceChildren(make("h2", { textContent: title }), ...coexisting(k, arrays), make("table", {}, ...rows),
    copying("copy all numbers", async () => JSON.stringify(await fullNumbers(cell))));
  if (!atlas.command) return;
  const retried = Object.keys(atlas.allowances).filter((name) => arrays[name]?.[k] > 0);
  const line = [atlas.command, ...axes.map(({ name, values }, along) => `--set ${name}=${values[cell[along]]}`),
    ...retried.map((name) => `${atlas.allowances[name]} ${arrays[name][k]}`)].join(" ");
  panel.append(make("p", { className: "note", textContent: "This command solves the cell again:" }),
    make("code", { textContent: line }), copying("copy command", () => line));
}

async function copied(text) {
  if (navigator.clipboard) return navigator.clipboard.writeText(text).then(() => true, () => false);
  const box = document.body.appendChild(make("textarea", { value: text })); // by plain HTTP there is no clipboard
  box.select();
  const done = document.execCommand("copy");
  box.remove();
  return done;
}

function copying(label, text) {
  const button = make("button", { type: "button", textContent: label });
  button.onclick = async () => {
    button.textContent = await copied(await text()) ? "copied" : "not copied";
    setTimeout(() => { button.textContent = label; }, 1500);
  };
  return button;
}

function describe() {
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
  if (isCoarse) says.push(`A cell of this page stands for up to ${block.join(" × ")} cells of the atlas: numbers are means, of yes and no the share of yes; period and impacts are the most frequent, and the regime too unless cells without a result or undetermined ones are among them.`);
  if (attractor !== null) {
    const rank = attractor ? `number ${attractor + 1} by its share` : "the one with the largest share";
    says.push(`A cell may have several attractors; this page shows ${rank} of the initial states.`);
  }
  by("precision").textContent = says.join(" ");
}

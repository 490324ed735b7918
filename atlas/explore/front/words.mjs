// Formats the numbers of cells as text. A `subject` is plain JSON, see static/about.py.

const raised = (text) => text.replace(/./g, (letter) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(letter)] || "");

/** Return a number as text with at most this many digits. */
export function number(value, digits = 6) {
  if (!Number.isFinite(value)) return Number.isNaN(value) ? "none" : value > 0 ? "∞" : "−∞";
  const small = value !== 0 && Math.abs(value) < 1e-3, near = Number(value.toPrecision(digits));
  const [mantissa, power] = (small ? near.toExponential() : String(near)).split("e");
  if (!power) return mantissa.replace("-", "−");
  return `${mantissa === "1" ? "" : `${mantissa.replace("-", "−")}·`}10${raised(power)}`;
}

/** Return a number and its error as text: two digits of the error, the number to the same place, 4 to `most` digits. */
function withError(value, error, most) {
  if (!(error > 0) || !Number.isFinite(value)) return number(value, most);
  const size = value ? Math.floor(Math.log10(Math.abs(value))) : 0, certain = size - Math.floor(Math.log10(error)) + 2;
  return `${number(value, Math.min(most, Math.max(4, certain)))} ± ${number(error, 2)}`;
}

/** Return the value of a variable in cell k as text; `subject.arrays` gives its number of digits. */
function inWords(subject, name, k, values) {
  const value = values[name][k], { special, variables, arrays } = subject, { flag, endless } = variables[name];
  const digits = Math.min(6, arrays[name]?.digits || 6);
  if (name === special.regime) return subject.regimes[value];
  if (name === special.reason) return subject.reasons[value];
  if (name === special.largest && values[special.error]) return withError(value, values[special.error][k], digits);
  if (endless && value < 0) return "without end: at rest on a stop";
  return flag ? (value ? "yes" : "no") : number(value, digits);
}

/** Return true if a variable is a result in cell k. */
function isResult(subject, name, k, values) {
  const value = values[name][k], { regime, reason } = subject.special;
  if (name === reason) return value !== 0;
  return name === regime || (subject.variables[name].regimes.includes(values[regime][k]) && !Number.isNaN(value));
}

/** Return the results in cell k of the variables `names`: for each its label, its value as text and its name. The error
 * of an exponent is left out if the exponent is among them, whose text contains the error.
 */
export function resultsOf(subject, names, k, values) {
  const { largest, error } = subject.special;
  return names.filter((name) => !(name === error && largest in values) && isResult(subject, name, k, values))
    .map((name) => [subject.variables[name].label, inWords(subject, name, k, values), name]);
}

/** Return a sentence with the regime of cell k and the results that a map shows of the cell. */
export function sentence(subject, map, k, values) {
  const { regime } = subject.special, rest = map.needs.filter((name) => name !== regime);
  return [subject.regimes[values[regime][k]], ...resultsOf(subject, rest, k, values).map(([label, text]) => `${label} ${text}`)].join("; ");
}

// What the page knows of its atlas, and the numbers of its cells, which are unpacked once they are asked for.

import { unpacked } from "../front/numbers.mjs";

export const by = (id) => document.getElementById(id);
export const atlas = JSON.parse(by("atlas").textContent);
export const { regime: REGIME, pending: PENDING, largest: LARGEST, error: ERROR } = atlas.special;
export const axes = atlas.axes.map((axis) => {
  const to = axis.log ? Math.log : (value) => value;
  return { ...axis, to, from: axis.log ? Math.exp : (value) => value, cuts: axis.edges.map(to) };
});
export const [X, Y] = axes;
export const NX = X.values.length;

const read = new Map();

export function numbers(name) {
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  if (!read.has(name)) read.set(name, unpacked(bytes(by(name).textContent), atlas.arrays[name].type, NX));
  return read.get(name);
}

// The atlas that the page shows: its description, its axes, and the arrays of its cells, unpacked at their first use.

import { by } from "../front/elements.mjs";
import { reader } from "../front/look.mjs";
import { drawnAxis } from "../front/plane.mjs";

export const atlas = JSON.parse(by("atlas").textContent);
export const { regime: REGIME, pending: PENDING, largest: LARGEST } = atlas.special;
export const axes = atlas.axes.map(drawnAxis);
export const [X, Y] = axes;
export const NX = X.values.length;

const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
export const numbers = reader((name) => ({ bytes: bytesOf(by(name).textContent), ...atlas.arrays[name] }), NX);

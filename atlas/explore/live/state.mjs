// The state of the live page: one value from which all that the page shows follows, and which the address holds.
//
// It has the limits `x` and `y` of the axes, the fixed `parameters` by name, the chosen `cell` { at, parameters }, the
// ends of the `cut`, the followed orbit `follow` as text, the `box` for a new atlas, and the style of the plane.

import { queryOf } from "../front/look.mjs";

const isSame = (one, other) => JSON.stringify(one) === JSON.stringify(other);

/** Return a state with the fields of `given` changed. Another cell ends the followed orbit; another window or plane
 * drops the box that was drawn in the one before. */
export function chosen(state, given) {
  const made = { ...state, ...given };
  if (!isSame(made.cell, state.cell) && !("follow" in given)) made.follow = null;
  if (!("box" in given) && !["x", "y", "parameters"].every((name) => isSame(made[name], state[name]))) made.box = null;
  return made;
}

/** Return the state without the followed orbit if there is one, else without the cut. */
export const escaped = (state) => chosen(state, state.follow ? { follow: null } : { cut: null });

/** Return true if the chosen cell lies in the plane of the state. */
export const isInPlane = ({ cell, parameters }) => Boolean(cell) && isSame(cell.parameters, parameters);

/** Return the query of the address of a state of a `subject`, see page.py. */
export function addressOf(subject, state) {
  const { names: [x, y], plane, address } = subject, pairs = [[x, state.x.join(":")], [y, state.y.join(":")]];
  for (const [name, value] of Object.entries(state.parameters)) if (value !== plane[name]) pairs.push([name, value]);
  if (state.cut) pairs.push(["cut", state.cut.join(",")]);
  if (state.cell) {
    pairs.push(["cell", state.cell.at.join(",")]);
    for (const [name, value] of Object.entries(state.cell.parameters)) if (value !== state.parameters[name]) pairs.push([`cell.${name}`, value]);
    if (state.follow) pairs.push(["follow.orbit", state.follow]);
  }
  return [...(address ? [address] : []), ...pairs.map(([name, value]) => `${name}=${encodeURIComponent(value).replaceAll("%2C", ",").replaceAll("%3A", ":")}`), queryOf(state)].join("&");
}

/** Return the point of the chosen cell if it lies in the plane, else the middle of the window; `axes` have functions to
 * and from the drawn coordinates. */
export const middleOf = (state, axes) => isInPlane(state) ? state.cell.at
  : axes.map(({ to, from }, along) => from(0.5 * (to([state.x, state.y][along][0]) + to([state.x, state.y][along][1]))));

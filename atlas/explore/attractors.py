"""All attractors of the clicked cell, read from the store or else searched on the cluster, and their panel."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from atlas.explore.background import Show
from atlas.explore.cell_lookup import CellResult
from atlas.explore.grid_patch import solve_patch
from atlas.explore.jobs import Computation
from atlas.explore.motion import motions
from atlas.explore.panel import Panel
from atlas.explore.subject import Arrays, Subject
from atlas.explore.text import first_compile_notice, number
from atlas.formatting import plural
from atlas.query.attractors import attractors_solved
from atlas.query.queries import nearest_cell
from atlas.render.class_maps import PALETTE
from atlas.spec.system import impacts_of
from atlas.task.compile import ATTRACTORS
from workers.model.system import System
from workers.results import LARGEST, REGIME


@dataclass(frozen=True)
class AttractorListing:
    """The attractors of a cell, the attractor that most initial states reach first.

    listed      results of each listed attractor, such as its regime, period and share of the initial states, by name
    count       number of attractors, including those beyond ``listed``
    starts      number of initial states solved
    undecided   number of initial states whose attractor is unknown
    unseen      share of the smallest attractor that the search misses in at most one cell of twenty
    own_index   index of the attractor that the cell's own initial state reaches; -1 if it is not listed
    stored      True if the attractors are from the atlas, False if they were searched now
    trouble     reason why there are no attractors; empty if there is none
    """

    listed: tuple[dict[str, Any], ...] = ()
    count: int = 0
    starts: int = 0
    undecided: int = 0
    unseen: float = 1.0
    own_index: int = -1
    stored: bool = False
    trouble: str = ""


def stored_attractors(subject: Subject, cell: CellResult) -> AttractorListing | None:
    """Return the attractors that the store holds of a cell, or a listing with the reason why none can be found.

    Return None if the attractors are not stored and have to be searched.
    """
    if not subject.can_search_attractors:
        return AttractorListing(trouble='all attractors are found only by the method "adaptive"')
    if subject.all_attractors is None or not cell.of_atlas:
        return None
    results = nearest_cell(
        subject.all_attractors, {axis.name: cell.parameters[axis.name] for axis in subject.spec.axes}
    )
    return _answer(results, stored=True)


def attractor_computation(subject: Subject, cell: CellResult) -> Computation[AttractorListing]:
    """Return the computation that searches all attractors of a cell on a worker."""
    plane, x, y = subject.point(cell.parameters)
    patch = replace(subject.grid(plane, (x,), (y,)), starts=subject.starts)
    return Computation(solve_patch, patch, partial(_solved, subject), n_cells=1)


def _solved(subject: Subject, arrays: Arrays) -> AttractorListing:
    """Return the attractors of a single cell from the result arrays of a search."""
    variables = subject.system.variables(subject.settings, attractors=True)
    cell = {variable.name: arrays[variable.name][0] for variable in variables}
    return _answer(attractors_solved(cell, variables), stored=False)


def _answer(numbers: Mapping[str, Any], stored: bool) -> AttractorListing:
    return AttractorListing(
        tuple(numbers["coexisting"]), int(numbers["attractors"]), int(numbers["starts"]), int(numbers["undecided"]),
        float(numbers["unseen_share"]), int(numbers["own_attractor"]), stored,
    )  # fmt: skip


class AttractorsPanel(Panel[CellResult]):
    """The panel with the table of a cell's attractors, and with their portraits if there are several."""

    def start(self, cell: CellResult) -> None:
        """Look up the attractors of a cell in the store, and search them on the cluster if they are not stored."""
        self.run_in_background(lambda: partial(self._known, cell, stored_attractors(self._subject, cell)))

    def show_error(self, reason: str) -> None:
        """Tell the reason why no attractors can be listed."""
        self.tell("attractors", trouble=reason)

    def _known(self, cell: CellResult, listing: AttractorListing | None) -> None:
        if listing is None:
            first = first_compile_notice(self._subject.system, ATTRACTORS)
            self.tell("attractors", waiting=f"searching from {self._subject.starts.count} initial states{first}")
            self.submit([attractor_computation(self._subject, cell)], partial(self._take, cell))
        else:
            self._take(cell, listing)

    def _take(self, cell: CellResult, listing: AttractorListing) -> None:
        """Tell the attractors of a cell, and their phase portraits if there are several."""
        self.tell("attractors", **attractors_table(listing, self._subject))
        states = [attractor["state"] for attractor in listing.listed if "state" in attractor]

        def draw() -> Show:
            drawn = motions(self._subject, cell.parameters, states)
            portraits = [{"y": m.y, "v": m.v, "color": PALETTE[k % len(PALETTE)]} for k, m in drawn.items()]
            return lambda: self.tell("portraits", portraits=portraits) if portraits else None

        if len(listing.listed) > 1:
            self.run_in_background(draw)


def attractors_table(listing: AttractorListing, subject: Subject) -> dict[str, Any]:
    """Return the attractors of a cell as fields of a message: the table, and a note or the trouble.

    Each row begins with the colour of its portrait. The note bounds the share of an attractor that the list may lack.
    """
    if listing.trouble:
        return {"trouble": listing.trouble}
    if not listing.listed:
        return {"note": f"none of {plural(listing.starts, 'initial state')} is decided"}
    exponents = subject.settings.exponents != "none"
    notes = [
        f"of {plural(listing.starts, 'initial state')}",
        "► reached from the cell's own" if listing.own_index >= 0 else "",
        f"{listing.count - len(listing.listed)} more, of smaller shares" if len(listing.listed) < listing.count else "",
        f"{listing.undecided} undecided" if listing.undecided else "",
        f"a search like this misses an attractor of more than {math.ceil(1000 * listing.unseen) / 10:g} %"
        " in under 5 % of cases",
        "stored" if listing.stored else f"found now, tolerance {subject.settings.tolerance:g}",
    ]
    return {
        "heads": ["", "regime", "n-p-q", *([LARGEST.words] if exponents else []), "share, 95 %"],
        "rows": [
            [PALETTE[k % len(PALETTE)], *_attractor(attractor, k == listing.own_index, exponents, subject.system)]
            for k, attractor in enumerate(listing.listed)
        ],
        "note": "; ".join(filter(None, notes)),
    }


def _attractor(attractor: Mapping[str, Any], is_own: bool, exponents: bool, system: System) -> list[str]:
    """Return the texts of an attractor's table row.

    They are: a mark if the cell's own initial state reaches the attractor, its regime, its name by period and impacts,
    its largest Lyapunov exponent if ``exponents``, and its share of the initial states with the interval of 95 %
    confidence.
    """
    orbit = f"{attractor['period']}-{impacts_of(system, attractor)}" if attractor["period"] else ""
    largest = [number(attractor[LARGEST.name], 3)] if exponents else []
    share, low, high = (100 * attractor[name] for name in ("share", "share_low", "share_high"))
    regime = attractor[REGIME.name].replace("_", " ")
    return ["►" if is_own else "", regime, orbit, *largest, f"{share:.0f} % ({low:.0f}–{high:.0f})"]

"""The panel that follows the periodic orbit of the chosen cell along a parameter.

It tells the page the branch of the orbit, and of each orbit on it its properties, its motion, and marks over the plane.
"""

from atlas.errors import InputError
from atlas.explore.background import BackgroundTasks
from atlas.explore.branches import (
    BranchDiagram,
    BranchPosition,
    EventArrow,
    FollowedBranch,
    arrows,
    branch_computation,
    distance,
)
from atlas.explore.cell_lookup import CellResult
from atlas.explore.explorer import Explorer
from atlas.explore.panel import Panel, Tell
from atlas.explore.text import first_compile_notice, number, symbol_of
from atlas.explore.view_state import FollowedOrbit, Point, Range, ViewState
from atlas.formatting import plural
from atlas.orbits.branches.table import cycle_period, orbit_name
from atlas.task.compile import ORBITS

FOLLOWABLE = "periodic", "no_impact"
"""Regimes of cells that have an orbit to follow."""
ROOM = 0.3
"""Maximum share of the window's width that the label of an arrow may take; beside the border it changes sides."""
BOUND = 1e9
"""Largest finite multiplier. A larger one belongs to an impact without speed, whose multiplier is infinite but for
rounding.
"""


class FollowPanel(Panel[tuple[Point, tuple[str, float, float]]]):
    """The panel of a followed orbit.

    Its topic is the cell, and the parameter with the limits (low, high) between which the branch has smaller steps.
    """

    def __init__(self, explorer: Explorer, background: BackgroundTasks, tell: Tell) -> None:
        super().__init__(explorer, background, tell)
        self._view: ViewState | None = None
        self._branch: FollowedBranch | None = None
        self._shown: FollowedOrbit | None = None

    def offer_cell(self, cell: CellResult) -> None:
        """Tell whether the cell has an orbit to follow."""
        self.tell("offer", possible=cell.results["regime"] in FOLLOWABLE)

    def show(self, view: ViewState) -> None:
        """Follow the orbit that the view state chooses, and tell its position on the branch."""
        self._view, follow, cell = view, view.follow, view.cell
        self.set_topic(None if follow is None or cell is None else (cell, follow[:3]))
        if self._branch is not None and follow is not None and cell is not None:
            self._tell_orbit(view, cell, follow, self._branch)

    def start(self, about: tuple[Point, tuple[str, float, float]]) -> None:
        """Have the branch of a cell's orbit computed on a worker."""
        self.clear()
        cell, (along, low, high) = about
        system = self._subject.system
        says = f"following its branch along {symbol_of(system, along)}{first_compile_notice(system, ORBITS)}"
        self.tell("follow", along=along, says=says)
        self.submit([branch_computation(self._subject, cell, (along, low, high))], self._take)

    def clear(self) -> None:
        """Follow no orbit."""
        self._branch = None

    def show_error(self, reason: str) -> None:
        """Tell that following ends, and the reason."""
        self.tell("follow", ended=True, says=reason)

    def find(self, view: ViewState, value: float | None) -> FollowedOrbit:
        """Return the orbit with a value of the parameter, of several the nearest along the branch.

        Raise InputError if the branch does not reach the value, or if there is no branch.
        """
        branch, follow = self._branch, view.follow
        if branch is None or follow is None:
            raise InputError("no orbit is followed")
        position = branch.position_at(branch.own_index + follow.step, follow.value)
        index = None if value is None else branch.find_point(float(value), position)
        if value is None or index is None:
            symbol, low, high = self._symbol(branch), number(min(branch.values)), number(max(branch.values))
            value_text = "none" if value is None else number(float(value))
            raise InputError(f"{symbol}: found {value_text}, must be {low} to {high} on this branch")
        return follow._replace(step=index - branch.own_index, value=float(value))

    def _symbol(self, branch: FollowedBranch) -> str:
        return symbol_of(self._subject.system, branch.table.along)

    def _take(self, branch: FollowedBranch) -> None:
        self._branch, diagram = branch, BranchDiagram.from_table(branch.table)
        self.tell(
            "branch",
            symbol=self._symbol(branch),
            values=branch.values,
            own=branch.own_index,
            stretches=diagram.stretches,
            events=[(kind.replace("_", " "), x, gap) for kind, x, gap in diagram.events],
        )
        if self._view is not None:
            self.show(self._view)

    def _tell_orbit(self, view: ViewState, cell: Point, follow: FollowedOrbit, branch: FollowedBranch) -> None:
        """Tell the followed orbit, with its marks over the plane if its fixed parameters are those of the plane."""
        position = branch.position_at(branch.own_index + follow.step, follow.value)
        values = self._subject.values(*cell) | {branch.table.along: position.value}
        inside = all(values[name] == value for name, value in view.plane.parameters)
        reached = arrows(branch, position, self._subject, view, cell) if inside else []
        motion = branch.motion(position)
        self.tell(
            "orbit",
            index=position.point_index,
            value=position.value,
            caption=f"orbit followed, point {position.point_index + 1} of {len(branch.values)}",
            rows=orbit_table(branch, position, self._symbol(branch)),
            gap=motion.moving[0][:: int(motion.per_period)],
            motion=motion.fields,
            at=[values[name] for name in self._subject.axes] if inside else None,
            arrows=[
                {"ends": arrow[:4]} | dict(zip(_LABEL, label_of(arrow, k, view.x), strict=True))
                for k, arrow in enumerate(reached)
            ],
        )


_LABEL = "text", "align", "baseline", "right", "down"


def label_of(arrow: EventArrow, k: int, visible: Range) -> tuple[str, str, str, int, int]:
    """Return the label of an arrow to an event: its text, alignment, baseline, and offsets from the marker in pixels.

    arrow     the arrow
    k         index of the arrow, 0 or 1; it decides on which side of the line, or how far along it, the text stands
    visible   limits (low, high) of the horizontal axis

    The text lies on the side to which the arrow points, if the window has room there.
    """
    (low, high), across = visible, arrow.y0 == arrow.y1
    ahead = arrow.x1 + arrow.y1 > arrow.x0 + arrow.y0
    position = (arrow.x0 - low) / (high - low)
    if across:
        leftwards = ahead == ((1.0 - position if ahead else position) < ROOM)
        text, baseline, down = (f"{arrow.text} →" if ahead else f"← {arrow.text}"), ("bottom", "top")[k], (-8, 8)[k]
    else:
        leftwards = position > 1.0 - ROOM
        text, baseline = (f"↑ {arrow.text}", "bottom") if ahead else (f"↓ {arrow.text}", "top")
        down = (10 + 18 * k) * (-1 if ahead else 1)
    return text, "right" if leftwards else "left", baseline, -14 if leftwards else 14, down


def orbit_table(branch: FollowedBranch, position: BranchPosition, symbol: str) -> list[tuple[str, str]]:
    """Return the properties of an orbit on a branch as rows of a table, each with its head and its text.

    ``symbol`` is that of the parameter.
    """
    outside = f"unstable, {plural(position.point.unstable, 'multiplier')} outside the unit circle"
    stability = outside if position.point.unstable else "stable"
    largest = f"{number(position.multiplier, 5)} in modulus" if position.multiplier < BOUND else "without bound"
    orbit = position.point.orbit.itinerary
    period = plural(orbit.periods, "forcing period")
    if orbit.is_cycle:
        period = f"cycle of {number(cycle_period(position.point, orbit), 8)}"
    rows = [
        (symbol, number(position.value, 8)), ("period", period),
        ("orbit n-p-q", orbit_name(orbit, branch.table.system)),
        ("stability", f"changes here: {position.kind}" if position.kind else stability),
        ("largest multiplier", largest),
    ]  # fmt: skip
    for mark, side, end in zip(branch.neighbouring_events(position), ("◄", "►"), (0, -1), strict=True):
        text = f"none up to {number(branch.values[end])}, where the range ends"
        if mark is not None:
            text = f"{mark.kind} at {number(mark.value)} ({distance(mark, position)})"
        rows.append((f"{side} next event", text))
    folds = [f"{number(mark.value)} (point {mark.point_index + 1})" for mark in branch.events if mark.kind == "fold"]
    rows += [("turns back at", ", ".join(folds))] if folds else []
    return rows

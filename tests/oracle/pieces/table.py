"""The machines of the table of reference orbits, and the script that writes tests/data/piecewise.json.

    python -m tests.oracle.pieces.table

Published with 12 to 16 digits before this simulator was written, by a solver in modal blocks: test_oracle_pieces.py
holds the record against those digits.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mpmath import mp

from tests.oracle.linear import Number
from tests.oracle.pieces.bifurcations import bifurcation
from tests.oracle.pieces.law import Mode
from tests.oracle.pieces.machine import Contact, Force, Friction, Machine, Phase, Rows, Vector
from tests.oracle.pieces.measures import measures
from tests.oracle.pieces.motion import Event, Run, simulate
from tests.oracle.pieces.orbits import DIGITS, REST, orbit

PATH = Path(__file__).parents[2] / "data" / "piecewise.json"
TRANSIENT = 60  # periods from rest at zero to the neighbourhood of the orbit
SLOWEST = 1e-3  # impacts of a chatter below this speed are not listed
ZERO = 1e-20  # multipliers below this are lost directions


def oscillator(
    omega: Number, cos: Number = 0.0, *, damping: Number = 0.1, stiffness: Number = 1.0, load: Number = 0.0,
    contact: Contact | None = None, friction: Friction | None = None, phases: tuple[Phase, ...] = (Phase(0.0),),
) -> Machine:  # fmt: skip
    """x'' + damping x' + stiffness x = cos cos(omega t) + load."""
    return Machine(
        mass=[[1.0]],
        damping=[[damping]],
        stiffness=[[stiffness]],
        load=[load],
        omega=omega,
        forces=(Force(1, [0.0], [cos]),) if cos else (),
        contacts=() if contact is None else (contact,),
        friction=() if friction is None else (friction,),
        phases=phases,
    )


def soft(
    omega: Number, *, d: float = 0.02, k: float = 29.0, c: float = 0.0, p: float = 0.0, release: str = "displacement"
) -> Machine:
    """x'' + d x' + x = .8 omega^2 / 1.26 cos(omega t) with a soft stop at 1."""
    stop = Contact([1.0], 1.0, stiffness=k, damping=c, preload=p, release=release)
    return oscillator(omega, 0.8 * omega**2 / 1.26, damping=d, contact=stop)


def rubbed(omega: Number, static: float = 1.2, amplitude: float = 2.0) -> Machine:
    """x'' + .1 x' + x + sgn x' = amplitude cos(omega t)."""
    return oscillator(omega, amplitude, friction=Friction([1.0], 1.0, static))


def belt(velocity: Number = 0.5, omega: float = 1.0, amplitude: float = 0.0) -> Machine:
    """x'' + .1 x' + x + .4 sgn(x' - velocity) = amplitude cos(omega t), static friction 1."""
    return oscillator(omega, amplitude, friction=Friction([1.0], 0.4, 1.0, velocity))


def two_mass(omega: float, *contacts: Contact) -> Machine:
    """Two masses of Fig. 3 of Li & Tan (2011): mu_k = 5, mu_m = 2, zeta = .05, f2 = 0, tau = pi."""
    K = [[1.0, -1.0], [-1.0, 6.0]]
    C = [[0.1, -0.1], [-0.1, 0.6]]
    return Machine([[1.0, 0.0], [0.0, 2.0]], C, K, [0.0, 0.0], omega, (Force(1, [-1.0, 0.0], [0.0, 0.0]),), contacts)


def capsule() -> Machine:
    """Inner mass at r from its capsule at x2: soft stop at r = .02, ground friction .5, forced inside."""
    return Machine(
        mass=[[1.0, 1.0], [1.0, 6.0]],
        damping=[[0.1, 0.0], [0.0, 0.0]],
        stiffness=[[1.0, 0.0], [0.0, 0.0]],
        load=[0.0, 0.0],
        omega=0.9,
        forces=(Force(1, [0.0, 0.0], [1.0, 1.0]),),
        contacts=(Contact([1.0, 0.0], 0.02, stiffness=15.0),),
        friction=(Friction([0.0, 1.0], 0.5, 0.5),),
    )


def _between(omega: Number) -> Machine:
    return oscillator(omega, 2.0, contact=Contact([1.0], 1.0, -1.0, stiffness=10.0))


def _rubbed_and_stopped(omega: float) -> Machine:
    stop = Contact([1.0], 0.8, restitution=0.6)
    return oscillator(omega, 1.2, contact=stop, friction=Friction([1.0], 0.3, 0.4))


def _switched(omega: float, amplitude: float, at: float, contact: Contact | None = None) -> Machine:
    stiffness: Rows = [[0.5]]
    return oscillator(
        omega, amplitude, stiffness=1.5, contact=contact, phases=(Phase(0.0), Phase(at, stiffness=stiffness))
    )


def _stop(row: Vector, R: float, *, upper: float | None = None, lower: float | None = None) -> Contact:
    return Contact(row, upper, lower, restitution=R)


@dataclass(frozen=True)
class Row:
    """One orbit: that to which a transient from rest leads; ``later``: counted from so many sections after."""

    name: str
    machine: Machine
    periods: int = 1
    symmetric: bool = False
    drift: int | None = None
    later: int = 0


def orbits() -> list[Row]:
    """The periodic orbits of the table but those at bifurcation points."""
    first, second, between = [1.0, 0.0], [0.0, 1.0], [-1.0, 1.0]
    both = Contact(first, 0.15, -0.15, stiffness=100.0, damping=0.2)
    square = oscillator(
        1.0, load=0.5, phases=(Phase(0.0), Phase(0.5, load=[-0.5])),
        contact=Contact([1.0], 1.0, stiffness=20.0, damping=0.1),
    )  # fmt: skip
    rig = _stop([1.0], 0.7, upper=0.5)
    left = _stop(first, 0.8, upper=0.3)
    narrow = (_stop(first, 0.8, upper=0.15), _stop(second, 0.6, lower=-0.05))
    return [
        Row("row 2", soft(0.95)),
        Row("row 3", soft(0.86), 2),
        Row("row 4", soft(0.95, c=0.5)),
        Row("row 5", soft(0.95, c=0.5, release="force")),
        Row("row 6", soft(1.0, d=0.2, k=10.0, p=0.5)),
        Row("row 7", soft(0.8, d=0.2, k=10.0, p=0.5), 2, later=1),
        Row("row 8", soft(0.95, k=10.0, p=0.5, c=0.4, release="force")),
        Row("row 9", _between(1.4), symmetric=True),
        Row("row 11", two_mass(4.0, both), symmetric=True),
        Row("row 12", rubbed(0.9), symmetric=True),
        Row("row 13", rubbed(1.2), symmetric=True),
        Row("row 15", rubbed(0.4), symmetric=True),
        Row("row 16", rubbed(0.4, static=1.0), symmetric=True),
        Row("row 19", belt(amplitude=0.3)),
        Row("row 20", belt(omega=1.2, amplitude=0.3)),
        Row("row 21", _rubbed_and_stopped(1.0)),
        Row("row 22", _rubbed_and_stopped(0.8)),
        Row("row 23", two_mass(2.0, left, _stop(second, 0.6, lower=-0.1))),
        Row("row 24", two_mass(3.0, *narrow), 2),
        Row("row 25", two_mass(2.0, left, _stop(between, 0.6, upper=0.2))),
        Row("row 26, omega 2", _switched(2.0, 0.5, 0.5)),
        Row("row 26, omega 1.3", _switched(1.3, 0.5, 0.5)),
        Row("row 27, omega 1", _switched(1.0, 1.0, 0.4, rig)),
        Row("row 27, omega 1.5", _switched(1.5, 1.0, 0.4, rig)),
        Row("row 28", square),
        Row("row 29", capsule(), drift=1),
        Row("row 30", two_mass(1.0, _stop(first, 0.3, upper=0.15, lower=-0.15)), symmetric=True),
    ]


@dataclass(frozen=True)
class Critical:
    """An orbit with a multiplier 1 or -1, near a section state and a forcing frequency."""

    name: str
    kind: str
    machine_at: Callable[[Number], Machine]
    omega: float
    start: tuple[float, float]
    multiplier: int
    symmetric: bool = False


CRITICAL = (
    Critical("row 2, PD", "period doubling", soft, 0.9157, (1.12446, 0.15392), -1),
    Critical("row 10, SB", "symmetry breaking", _between, 1.052, (1.4752, 0.26603), -1, symmetric=True),
    Critical("row 10, fold", "fold", _between, 3.018, (-1.0002515, 18.8791616), 1, symmetric=True),
)

ONSETS = (
    ("row 14", rubbed(0.655453162351025)),
    ("row 14, lower", rubbed(0.658629504734325, 1.05, 1.8)),
    ("row 14, upper", rubbed(2.52030194267901, 1.05, 1.8)),
)
"""Orbits that turn where the force that would hold them is the static friction: here a stick begins."""

GRAZES = (0.782204086871376, 1.65477114143231)
"""Frequencies at which the linear answer of ``soft`` touches the stop."""


def entry(row: Row) -> dict[str, Any]:
    """The record of a row."""
    with mp.workdps(20):
        rough = simulate(row.machine, [0.0] * (2 * row.machine.n), TRANSIENT + row.later, digits=20, rest=1e-6)
        state, mode = list(rough.sections[-1]), rough.modes[-1]
    if row.drift is not None:
        state[row.drift] = mp.zero
    return refined(row, state, mode)


def refined(row: Row, state: Sequence[Number], mode: Mode | None, tolerance: float = 1e-30) -> dict[str, Any]:
    """The record of the orbit near a section state."""
    found = orbit(row.machine, state, row.periods, mode=mode, drift=row.drift, tolerance=tolerance)
    multipliers = [_plain(value) for value in found.multipliers]
    result = {
        "name": row.name,
        "machine": row.machine.record(),
        "periods": row.periods,
        "symmetric": row.symmetric,
        "drift": row.drift,
        "state": [float(value) for value in found.state],
        "mode": _mode(found.run.modes[0]),
        "events": _events(found.run),
        "multipliers": [[value.real, value.imag] for value in multipliers],
    }
    if row.symmetric:
        half = orbit(row.machine, found.state, mode=mode, symmetric=True, tolerance=tolerance)
        values = [_plain(value) for value in half.half_multipliers]
        result["half_multipliers"] = [[value.real, value.imag] for value in values]
    if all(multipliers):
        result["sum"] = sum(math.log(abs(value)) for value in multipliers) / row.periods
    result["measures"] = measures(row.machine, found.state, row.periods, mode=found.run.modes[0])
    return result


def critical(point: Critical) -> dict[str, Any]:
    """The record of an orbit at a bifurcation, whose parameter is found anew."""
    with mp.workdps(DIGITS):
        value, state = bifurcation(
            point.machine_at, point.omega, point.start, point.multiplier, symmetric=point.symmetric
        )
        row = Row(point.name, point.machine_at(value), symmetric=point.symmetric)
        result = refined(row, state, None, tolerance=1e-15)
    result["machine"] = point.machine_at(float(value)).record()
    result["bifurcation"] = {"kind": point.kind, "parameter": "omega", "value": float(value)}
    return result


def onset(name: str, machine: Machine) -> dict[str, Any]:
    """The record of a sliding orbit at the onset of stick."""
    lower = replace(machine, friction=(replace(machine.friction[0], static=machine.friction[0].kinetic),))
    result = entry(Row(name, lower, symmetric=True))
    result["machine"] = machine.record()
    result["bifurcation"] = {"kind": "onset of stick", "parameter": "omega", "value": machine.omega}
    return result


def graze(omega: float) -> dict[str, Any]:
    """The record of the linear answer that touches the stop."""
    machine = soft(omega)
    result = entry(Row(f"row 1, omega {omega:.3f}", replace(machine, contacts=())))
    result["machine"] = machine.record()
    result["mode"]["contacts"] = ["open"]
    result["bifurcation"] = {"kind": "graze", "parameter": "omega", "value": omega}
    return result


def cycle() -> dict[str, Any]:
    """The record of the unforced cycle on a belt, from the moment it begins to slip, where x + .1 v = static."""
    velocity = 0.5
    with mp.workdps(DIGITS):
        start = _break(velocity)
        run = simulate(belt(velocity), start, 2, mode=SLIPS, digits=DIGITS, rest=REST)
    return _cycle("row 17", velocity, start, run.events[:2])


def grazing_cycle() -> dict[str, Any]:
    """The record of that cycle where the slip that starts it only just comes to rest on the belt: v_r = a_r = 0.

    While it slips, u = x - .4 moves by u'' + .1 u' + u = 0 from u = 1 - .1 v - .4, u' = v.
    """
    with mp.workdps(DIGITS):
        eta = mp.mpf(0.1) / 2
        w = mp.sqrt(1 - eta**2)

        def motion(velocity: Number, t: Number) -> tuple[Number, Number]:
            u, v = _break(velocity)[0] - mp.mpf(0.4), velocity
            C, S = mp.cos(w * t), mp.sin(w * t) / w
            decay = mp.exp(-eta * t)
            return decay * (C * u + S * (v + eta * u)), decay * (C * v - S * (eta * v + u))

        def off(velocity: Number, t: Number) -> list[Number]:
            u, v = motion(velocity, t)
            return [v - velocity, u + 2 * eta * v]

        velocity, slip = mp.findroot(off, (mp.mpf("0.66"), mp.mpf("5.53")))
        place = motion(velocity, slip)[0] + mp.mpf(0.4)
        start = _break(velocity)
        stick = (start[0] - place) / velocity
        events = [Event(slip, "stick", 0, place), Event(slip + stick, "slip-", 0, start[0])]
    result = _cycle("row 18", float(velocity), start, events)
    result["bifurcation"] = {"kind": "grazing-sliding", "parameter": "belt", "value": float(velocity)}
    return result


SLIPS = Mode(0, (), ("slip-",))


def _break(velocity: Number) -> list[Number]:
    """(x, v) at which ``belt`` ends to stick: x + .1 v = 1."""
    return [1 - mp.mpf(0.1) * mp.mpf(velocity), mp.mpf(velocity)]


def _cycle(name: str, velocity: float, start: Sequence[Number], events: Sequence[Event]) -> dict[str, Any]:
    return {
        "name": name,
        "machine": belt(velocity).record(),
        "periods": None,
        "cycle": float(events[-1].t),
        "symmetric": False,
        "drift": None,
        "state": [float(value) for value in start],
        "mode": _mode(SLIPS),
        "events": [_event(event) for event in events],
        "multipliers": [[1.0, 0.0], [0.0, 0.0]],
    }


def table() -> list[dict[str, Any]]:
    """All records."""
    result = [graze(omega) for omega in GRAZES]
    result += [entry(row) for row in orbits()]
    result += [critical(point) for point in CRITICAL]
    result += [onset(name, machine) for name, machine in ONSETS]
    result += [cycle(), grazing_cycle()]
    return sorted(result, key=lambda record: int(record["name"].split(",")[0].removeprefix("row ")))


def _events(run: Run) -> list[list[Any]]:
    return [_event(e) for e in run.events if e.kind != "impact" or abs(e.value) > SLOWEST]


def _event(event: Event) -> list[Any]:
    return [float(event.t), event.kind, event.index, float(event.value)]


def _mode(mode: Mode) -> dict[str, list[str]]:
    return {"contacts": list(mode.contacts), "friction": list(mode.friction)}


def _plain(value: complex) -> complex:
    """A multiplier, zero if it is lost, real if it is real to rounding."""
    if abs(value) < ZERO:
        return 0j
    return complex(value.real, value.imag if abs(value.imag) > ZERO * abs(value) else 0.0)


def main() -> None:
    """Write the table, one record a line."""
    lines = ",\n".join(json.dumps(record) for record in table())
    PATH.write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()

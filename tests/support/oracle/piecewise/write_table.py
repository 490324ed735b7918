"""The machines of the table of reference orbits, and the script that writes tests/data/piecewise.json.

    python -m tests.support.oracle.piecewise.write_table

Published with 12 to 16 digits before this simulator was written, by a solver in modal blocks: test_oracle_pieces.py
holds the record against those digits.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mpmath import mp

from tests.support import ROOT
from tests.support.oracle.linear import Number
from tests.support.oracle.piecewise.bifurcations import bifurcation
from tests.support.oracle.piecewise.machine import PiecewiseMachine
from tests.support.oracle.piecewise.measures import measures
from tests.support.oracle.piecewise.mode_law import PiecewiseMode
from tests.support.oracle.piecewise.motion import PiecewiseEvent, PiecewiseRun, simulate
from tests.support.oracle.piecewise.orbits import DIGITS, REST, orbit
from tests.support.oracle.piecewise.reference_orbits import (
    CRITICAL,
    GRAZES,
    ONSETS,
    BifurcationOrbit,
    ReferenceOrbit,
    belt,
    orbits,
    soft,
)

PATH = ROOT / "tests" / "data" / "piecewise.json"
TRANSIENT = 60  # periods from rest at zero to the neighbourhood of the orbit
SLOWEST = 1e-3  # impacts of a chatter below this speed are not listed
ZERO = 1e-20  # multipliers below this are lost directions


def entry(row: ReferenceOrbit) -> dict[str, Any]:
    """The record of a row."""
    with mp.workdps(20):
        rough = simulate(row.machine, [0.0] * (2 * row.machine.n), TRANSIENT + row.later, digits=20, rest=1e-6)
        state, mode = list(rough.sections[-1]), rough.modes[-1]
    if row.drift is not None:
        state[row.drift] = mp.zero
    return refined(row, state, mode)


def refined(
    row: ReferenceOrbit, state: Sequence[Number], mode: PiecewiseMode | None, tolerance: float = 1e-30
) -> dict[str, Any]:
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


def critical(point: BifurcationOrbit) -> dict[str, Any]:
    """The record of an orbit at a bifurcation, with the parameter solved for."""
    with mp.workdps(DIGITS):
        value, state = bifurcation(
            point.machine_at, point.omega, point.start, point.multiplier, symmetric=point.symmetric
        )
        row = ReferenceOrbit(point.name, point.machine_at(value), symmetric=point.symmetric)
        result = refined(row, state, None, tolerance=1e-15)
    result["machine"] = (point.shown_at or point.machine_at)(float(value)).record()
    result["periods"] = point.periods
    result["bifurcation"] = {"kind": point.kind, "parameter": "omega", "value": float(value)}
    if point.shown_at is not None:
        result["admissible"] = False
        del result["measures"], result["sum"]  # of another machine's periods
    return result


def onset(name: str, machine: PiecewiseMachine) -> dict[str, Any]:
    """The record of a sliding orbit at the onset of stick."""
    lower = replace(machine, friction=(replace(machine.friction[0], static=machine.friction[0].kinetic),))
    result = entry(ReferenceOrbit(name, lower, symmetric=True))
    result["machine"] = machine.record()
    result["bifurcation"] = {"kind": "onset of stick", "parameter": "omega", "value": machine.omega}
    return result


def graze(omega: float) -> dict[str, Any]:
    """The record of the linear response that touches the stop."""
    machine = soft(omega)
    result = entry(ReferenceOrbit(f"row 1, omega {omega:.3f}", replace(machine, contacts=())))
    result["machine"] = machine.record()
    result["mode"]["contacts"] = ["open"]
    result["bifurcation"] = {"kind": "graze", "parameter": "omega", "value": omega}
    return result


def cycle() -> dict[str, Any]:
    """The record of the unforced cycle on a belt, from the beginning of its slip, where x + .1 v = static."""
    velocity = 0.5
    with mp.workdps(DIGITS):
        start = _break(velocity)
        run = simulate(belt(velocity), start, 2, mode=SLIPS, digits=DIGITS, rest=REST)
    return _cycle("row 17", velocity, start, run.events[:2])


def grazing_cycle() -> dict[str, Any]:
    """The record of that cycle at the velocity where its slip just comes to rest on the belt: v_r = a_r = 0.

    During the slip, u = x - .4 moves by u'' + .1 u' + u = 0 from u = 1 - .1 v - .4, u' = v.
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
        events = [PiecewiseEvent(slip, "stick", 0, place), PiecewiseEvent(slip + stick, "slip-", 0, start[0])]
    result = _cycle("row 18", float(velocity), start, events)
    result["bifurcation"] = {"kind": "grazing-sliding", "parameter": "belt", "value": float(velocity)}
    return result


SLIPS = PiecewiseMode(0, (), ("slip-",))


def _break(velocity: Number) -> list[Number]:
    """(x, v) at which ``belt`` ceases to stick: x + .1 v = 1."""
    return [1 - mp.mpf(0.1) * mp.mpf(velocity), mp.mpf(velocity)]


def _cycle(name: str, velocity: float, start: Sequence[Number], events: Sequence[PiecewiseEvent]) -> dict[str, Any]:
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


def _events(run: PiecewiseRun) -> list[list[Any]]:
    return [_event(e) for e in run.events if e.kind != "impact" or abs(e.value) > SLOWEST]


def _event(event: PiecewiseEvent) -> list[Any]:
    return [float(event.t), event.kind, event.index, float(event.value)]


def _mode(mode: PiecewiseMode) -> dict[str, list[str]]:
    return {"contacts": list(mode.contacts), "friction": list(mode.friction)}


def _plain(value: complex) -> complex:
    """A multiplier, zero if it is lost, real if it is real to rounding."""
    if abs(value) < ZERO:
        return 0j
    return complex(value.real, value.imag if abs(value.imag) > ZERO * abs(value) else 0.0)


def main() -> None:
    """Write the table, one record per line."""
    lines = ",\n".join(json.dumps(record) for record in table())
    PATH.write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()

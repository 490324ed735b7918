"""Time history of one cell as a table: time, state, forces of contacts and friction, and events by name."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from atlas.argument_checks import is_integer, validate_flag
from atlas.cell.motion import CellMotion
from atlas.cell.trajectory import HISTORY_SAMPLES
from atlas.errors import InputError, brief_repr
from atlas.spec.spec import given_values, validate_parameters
from atlas.spec.system import parse_system
from workers.kernel.hybrid.leg_record import LEG
from workers.model.hybrid_modes import SIGNALS, ModeCode, code_of, pushing, resisting
from workers.model.mode_table import build_hybrid
from workers.model.oscillator import Array, Oscillator, Rows
from workers.model.system import DEFAULT, System
from workers.orbit.recorded_legs import legs_of_periods, mode_code_of_state

if TYPE_CHECKING:
    import pandas as pd

NEXT = 1e-9
"""Distance in time from an event, as a share of a period, at which forces before or after the event are evaluated.

It exceeds the rounding by which two computed times of one event differ.
"""


def time_history(
    given: Mapping[str, Any] | None = None,
    /,
    *,
    periods: int,
    transient: int = 0,
    samples: int = HISTORY_SAMPLES,
    times: Sequence[float] | None = None,
    events_only: bool = False,
    system: str | Mapping[str, Any] | System = DEFAULT,
    **named: Any,
) -> "pd.DataFrame":
    """Return the motion of one cell as a pandas frame, from its initial state on, with a row per instant and event.

    given, named  parameters other than the defaults, as a mapping, or by name: ``omega=4.0``
    periods       number of forcing periods; of natural periods without a force
    transient     number of periods before them, which are followed and left out
    samples       number of instants per period
    times         instants in place of ``samples``, between 0 and the last of these periods
    events_only   True for the rows of events alone
    system        name, definition or ``System`` of the machine

    Columns:

    time          time since the initial state
    state         a column for each displacement and velocity, by name; at an event the state just after it
    NAME_force    force of a soft or rigid contact, or of friction, along its row; 0 while it is open. An impact on a
                  rigid stop is an impulse, and no force
    event         name of the event; empty at other instants
    impact_speed  speed of approach just before an impact; NaN in other rows

    An impact on a rigid stop has two rows: the state just before, whose event is empty, and just after. With
    ``events_only`` the second remains. Times of impacts are those of ``atlas.trace``. Raise InputError for a parameter
    that does not exist or is out of range, for instants out of range, for a motion that cannot be followed, and for a
    coordinate with the name of another column.

    >>> import atlas
    >>> history = atlas.time_history(omega=4.0, b=0.1, periods=1, events_only=True)
    >>> history["event"].tolist()
    ['impact on stop, lower', 'impact on stop, upper']
    """
    import pandas as pd

    validate_flag("events_only", events_only)
    record = parse_system(system)
    parameters = validate_parameters(record, given_values(given, named))
    for name, count, low in (("periods", periods, 1), ("transient", transient, 0), ("samples", samples, 1)):
        if not is_integer(count) or count < low:
            raise InputError(f"{name}: found {brief_repr(count)}, must be a whole number, {low} or more")
    columns = {"time", "event", "impact_speed", *_force_columns(record)}
    if clash := [name for name in record.states if name in columns]:
        raise InputError(f"{record.name}: the coordinate {clash[0]!r} has the name of a column of time histories")
    motion = CellMotion.follow(record, parameters, transient + periods, None)
    first, last = float(motion.followed.times[transient]), float(motion.followed.times[-1])
    instants = _instants(times, first, last, samples * periods)
    modes = _ModeHistory.of(record, motion, transient)
    impacts = motion.followed.impacts
    impacts = impacts[(impacts[:, 0] >= first) & (impacts[:, 2] > 0.0)]
    before, after, rigid = motion.states_at_impacts(impacts)
    changes = np.array([time for time, _ in modes.events])

    def part(times: Array, states: Array, since: float, event: Any = "", speed: Any = np.nan) -> "pd.DataFrame":
        """Return rows of the table with the forces just before, at, or just after the instants of the rows.

        ``since`` is the time from an instant to the time of its forces, in periods.
        """
        columns = {"time": times} | dict(zip(record.states, states.T, strict=True))
        columns |= modes.forces(times, states, times + since * motion.period)
        return pd.DataFrame(columns | {"event": event, "impact_speed": speed})

    names = [f"impact on {modes.stop(side)}" for side in impacts[:, 1]]
    table = pd.concat(
        [
            part(instants, motion.states_at(instants), 0.0),
            part(impacts[rigid, 0], before[rigid], -NEXT),
            part(impacts[:, 0], after, NEXT, names, impacts[:, 2]),
            part(changes, motion.states_at(changes), NEXT, [event for _, event in modes.events]),
        ]
    ).sort_values("time", kind="stable", ignore_index=True)
    return table[table["event"] != ""].reset_index(drop=True) if events_only else table


def _force_columns(system: System) -> list[str]:
    """Return the names of the table's columns with forces: contacts first, then friction."""
    definition = system.definition
    return [f"{element.name}_force" for elements in (definition.contacts, definition.friction) for element in elements]


def _instants(times: Sequence[float] | None, first: float, last: float, count: int) -> Array:
    """Return the instants of a time history: the given ``times``, sorted, or ``count`` even steps from ``first`` to
    ``last``.

    Raise InputError for times out of range.
    """
    if times is None:
        return np.linspace(first, last, count + 1)
    try:
        instants = np.sort(np.asarray(times, dtype=np.float64).reshape(-1))
    except (TypeError, ValueError):
        raise InputError(f"times: found {brief_repr(times)}, must be numbers") from None
    if not np.all((instants >= first) & (instants <= last)):
        raise InputError(f"times: found {brief_repr(times)}, must be from {first:.10g} to {last:.10g}")
    return instants


@dataclass(frozen=True)
class _ModeHistory:
    """The L modes of a motion, in order of time, and the events that are no impacts.

    A mode is one set of linear equations between two events: the phase, which contacts push, which friction slides.

    system    the system
    machine   the machine of the cell, with all modes of the motion
    starts    (L,) time from which each mode holds
    numbers   (L,) number of each mode, see ModeCode
    events    time and name of each event
    """

    system: System
    machine: Oscillator
    starts: Array
    numbers: Rows
    events: list[tuple[float, str]]

    @classmethod
    def of(cls, system: System, motion: CellMotion, transient: int) -> Self:
        """Return the modes of a motion after ``transient`` periods.

        Each period is followed anew from its initial state.
        """
        machine, _ = build_hybrid(motion.machines)
        starts, numbers = list[Array](), list[Array]()
        for k in range(transient, len(motion.followed.times) - 1):
            state = motion.followed.states[k]
            number = mode_code_of_state(machine.table.elements, state).number_of(*motion.machines.segments)
            try:
                legs = next(legs_of_periods(machine, state, number))
            except ValueError as error:
                raise InputError(f"this cell cannot be followed: {error}") from None
            starts.append(motion.followed.times[k] + legs[:, LEG.start] + legs[:, LEG.chatter])
            numbers.append(legs[:, LEG.number].astype(np.int64))
        history = cls(system, machine, np.concatenate(starts), np.concatenate(numbers), [])
        for k in np.flatnonzero(np.diff(history.numbers)).tolist():
            old, new = map(history._code, history.numbers[k : k + 2].tolist())
            history.events.extend((float(history.starts[k + 1]), event) for event in history._events(old, new))
        return history

    def _code(self, number: int) -> ModeCode:
        """Decode the number of a mode: its phase, the state of its contacts, and the direction of its friction."""
        machines = self.machine.table.machines
        return code_of(number, *machines.sizes[1:], *machines.segments)

    def stop(self, side: float) -> str:
        """Return the name of a stop: ``stop``, or ``stop, upper`` if its contact has two.

        ``side`` is 1 + the index of the contact, negative for the lower stop.
        """
        contact = self.system.definition.contacts[abs(int(side)) - 1]
        return contact.name if contact.stops < 2 else f"{contact.name}, {'upper' if side > 0 else 'lower'}"

    def _events(self, old: ModeCode, new: ModeCode) -> Iterator[str]:
        """Yield the names of the changes from one mode to the next, such as sticking; impacts and segments of laws are
        left out.
        """
        if old.phase != new.phase:
            yield f"phase {new.phase + 1}"
        for c, (was, now) in enumerate(zip(old.contacts, new.contacts, strict=True), 1):
            counted = c <= len(self.system.definition.contacts)
            rigid = counted and self.system.definition.contacts[c - 1].rigid
            if counted and was % 2 and not now % 2:
                yield f"leaves {self.stop(c * np.sign(was))}"
            if rigid and now % 2 and not was % 2:
                yield f"rests on {self.stop(c * np.sign(now))}"
        for friction, was, now in zip(self.system.definition.friction, old.slips, new.slips, strict=True):
            if np.sign(was) != np.sign(now):
                yield f"{friction.name} {('slips backward', 'sticks', 'slips forward')[int(np.sign(now)) + 1]}"

    def forces(self, times: Array, states: Array, at: Array) -> dict[str, Array]:
        """Return the forces (N,) of contacts and friction along their directions, by the name of the column.

        times, states  (N,) and (N, 2n) instants and states
        at             (N,) times at which the modes are looked up
        """
        table, n = self.machine.table, states.shape[1] // 2
        machines, pieces = table.machines, table.pieces
        numbers = self.numbers[np.maximum(np.searchsorted(self.starts, at, side="right") - 1, 0)]
        contacts, frictions = self.system.definition.contacts, self.system.definition.friction
        columns = {name: np.zeros(len(times)) for name in _force_columns(self.system)}
        orders = np.arange(1.0, machines.force_sin.shape[2] + 1.0)
        turns = orders * (machines.tau[0] + machines.omega[0] * times[:, None])
        waves = np.stack([np.sin(turns), np.cos(turns)], axis=-1)
        full = np.concatenate([states, np.ones((len(times), 1))], axis=1)
        for number in np.unique(numbers).tolist():
            rows, slot, code = (
                np.flatnonzero(numbers == number),
                int(np.argmax(table.codes[0] == number)),
                self._code(number),
            )
            x, v = states[rows, :n], states[rows, n:]
            # of each signal; that of a contact or friction which sticks is its force
            signals = full[rows] @ pieces.rows[0, slot].T + np.tensordot(
                waves[rows], pieces.direct[0, slot], ((1, 2), (1, 2))
            )
            for c, (contact, state) in enumerate(zip(contacts, code.contacts, strict=False)):
                side = int(np.sign(state))
                if state % 2 and contact.rigid:
                    columns[f"{contact.name}_force"][rows] = signals[:, SIGNALS * c]
                elif state % 2:
                    stiffness, damping, preload = pushing(machines, code.phase, c, state)
                    depth = side * (x @ machines.row[0, c] - machines.stops[0, c, int(side > 0)])
                    push = preload + stiffness * depth + damping * side * (v @ machines.row[0, c])
                    columns[f"{contact.name}_force"][rows] = -side * push
            for f, (friction, sign) in enumerate(zip(frictions, code.slips, strict=True)):
                force = signals[:, SIGNALS * machines.sizes[1] + f]
                if sign:
                    level, slope = resisting(machines, code.phase, f, sign)
                    sliding = v @ machines.friction_rows[0, f] - machines.belt[0, f]
                    force = -np.sign(sign) * level - slope * sliding
                columns[f"{friction.name}_force"][rows] = force
        return columns

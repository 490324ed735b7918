"""Machines over a few free parameters, whose modes are built at first use and shared.

For a machine with one rigid contact, everything that the fixed parameters decide is computed once; its flight equals,
to the bit, that of ``System.build_many`` at the same values.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.build import build
from workers.model.free import OF_STRUCTURE, Structure, centred, finite, free_motion, phase_of, structure_of
from workers.model.hybrid import Elements, build_hybrid, elements_of
from workers.model.hybrid_machines import HybridMachines, hybrid_faults
from workers.model.hybrid_modes import OPEN, Code, Pieces, pieces_of
from workers.model.oscillator import COLUMN, Array, Machines, Mask, Oscillator, Rows, at_rows
from workers.model.system import System
from workers.results import NO_REASON, OUT_OF_DOUBLES

FLYING = Code(0, (OPEN,), ())
"""The one mode of a machine with a single rigid contact while nothing rests on it."""


class NoOscillatorError(ValueError):
    """There is no oscillator at these parameters."""


@dataclass
class OrbitMachines:
    """N machines of n coordinates and their modes, each built at its first use.

    omega, tau (N,)  forcing frequency, forcing phase at a section
    elements         contacts and friction
    rest (N, 2n)     physical state from which states and stops are counted
    make             function that makes a mode of all N
    describe         function for the machines as numbers, also counted from rest
    build            function for their record for the kernels of cells
    """

    omega: Array
    tau: Array
    elements: Elements
    rest: Array
    make: Callable[[Code], Pieces]
    describe: Callable[[], HybridMachines]
    build: Callable[[], Oscillator]
    known: dict[Code, Pieces] = field(default_factory=dict)

    def mode(self, code: Code) -> Pieces:
        """A mode of all machines. NoOscillatorError if it does not exist."""
        if code not in self.known:
            self.known[code] = self.make(code)
        return self.known[code]

    @cached_property
    def machines(self) -> HybridMachines:
        """The machines as numbers."""
        return self.describe()

    @cached_property
    def oscillators(self) -> Oscillator:
        """The machines as records for the kernels of cells."""
        return self.build()

    def at_rows(self, rows: Rows) -> "OrbitMachines":
        """These rows, in this order, sharing the modes of the whole."""
        return OrbitMachines(
            self.omega[rows], self.tau[rows], at_rows(self.elements, rows), self.rest[rows],
            lambda code: at_rows(self.mode(code), rows), lambda: at_rows(self.machines, rows),
            lambda: at_rows(self.oscillators, rows),
        )  # fmt: skip

    @property
    def dimension(self) -> int:
        """Number of components of a state, 2n."""
        return self.rest.shape[1]

    @property
    def mirrored(self) -> Mask:
        """Mask (N,) of machines that are their own mirror images half a period later, in the same phase."""
        return self.machines.mirrored


def machines_over(system: System, fixed: Mapping[str, float], free: tuple[str, ...]) -> Callable[[Array], Any]:
    """A function from rows of values (N, free) to machines and the reason against each; other parameters are fixed."""
    return (_Over if system.has_modes else _Flying)(system, fixed, free)


def with_modes(machines: HybridMachines) -> OrbitMachines:
    """Machines with any law: every mode is built by itself."""

    def make(code: Code) -> Pieces:
        pieces, wrong = pieces_of(machines, code)
        if np.any(wrong):
            raise NoOscillatorError("a mode of this orbit has no bounded motion there")
        return pieces

    return OrbitMachines(
        machines.omega, machines.tau, elements_of(machines), np.zeros((len(machines.omega), machines.dimension)), make,
        lambda: machines, lambda: build_hybrid(machines)[0],
    )  # fmt: skip


class _Over:
    """Machines of a system over some of its parameters, with the others fixed. Every mode is built by itself."""

    def __init__(self, system: System, fixed: Mapping[str, float], free: tuple[str, ...]) -> None:
        self.system, self.free = system, free
        self.fixed = {p.name: float(fixed.get(p.name, p.default)) for p in system.parameters if p.name not in free}

    def named(self, rows: Array) -> dict[str, Array]:
        """Rows of values (N, free) by name."""
        return {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(self.free)}

    def others(self, rows: Array) -> dict[str, Array]:
        """The values (N,) of each fixed parameter."""
        return {name: np.full(len(rows), value) for name, value in self.fixed.items()}

    def __call__(self, rows: Array) -> tuple[OrbitMachines, NDArray[np.int8]]:
        """The machines of rows of values (N, free), and the reason against each."""
        values = self.others(rows) | self.named(rows)
        own = self.system.definition.hybrid(values)
        return with_modes(own), self.system.out_of_range(values, hybrid_faults(own))


class _Kept(NamedTuple):
    """Common parts of the machines of N rows of values: fixed values, machines, structure, mode, elements.

    Fields that depend on free parameters are computed again for each call, with everything that depends on them.
    """

    fixed: dict[str, Array]
    machines: Machines
    structure: Structure
    mode: Pieces
    elements: Elements


class _Flying(_Over):
    """Machines with one rigid contact: states are counted from the rest of y, and the only mode is the flight."""

    def __init__(self, system: System, fixed: Mapping[str, float], free: tuple[str, ...]) -> None:
        super().__init__(system, fixed, free)
        self._changing = system.definition.depending(free)
        self._kept: dict[int, _Kept] = {}

    @np.errstate(all="ignore")
    def __call__(self, rows: Array) -> tuple[OrbitMachines, NDArray[np.int8]]:
        """The machines of rows of values (N, free), and the reason against each."""
        values, kept = self.named(rows), self._kept.get(len(rows))
        if kept:
            fixed, fields = kept.fixed, self._changing
            machines = kept.machines._replace(**self.system.definition.fields(fixed | values, fields))
        else:
            fixed, fields = self.others(rows), frozenset(Machines._fields)
            values = fixed | values
            machines = self.system.definition.machines(values)
        if kept and fields.isdisjoint(OF_STRUCTURE):
            structure, mode, elements = kept[2:]
        else:
            structure = structure_of(machines)
            mode, elements = _flight(structure, machines), _contact(structure, machines)
        at_rest = centred(structure, machines)
        gap, against = free_motion(structure, at_rest, machines.omega)
        known = finite((gap.numbers,)) & ~np.isnan(at_rest.b_upper) & ~np.isnan(at_rest.b_lower)
        if not fields.isdisjoint(OF_STRUCTURE):
            known &= finite(structure)
        reasons = np.where(known, NO_REASON, OUT_OF_DOUBLES).astype(np.int8)
        for reason, holds in against.items():
            reasons[holds] = reason
        reasons = self.system.refused(machines, values, reasons, fields)
        if not kept and np.all(reasons == NO_REASON):
            self._kept[len(rows)] = _Kept(fixed, machines, structure, mode, elements)
        ways, (N, n), blocks = structure.flow.modes, machines.gap_row.shape, gap.blocks
        rest = (ways.to_physical @ at_rest.loading.rest.reshape(N, 2 * n, 1))[..., 0]
        blocks[..., COLUMN.rest0 :] = 0.0
        stops = np.stack([-at_rest.b_lower, at_rest.b_upper], axis=1)[:, None]
        acceleration = mode.acceleration
        if np.any(at_rest.loading.load):  # its motion is the origin of a damped motion driven by a load
            moving = np.concatenate([np.zeros((N, n)), rest[:, n:]], axis=1)[..., None]
            blocks[..., COLUMN.rest0 :] = (ways.to_blocks @ moving).reshape(N, n, 2)
            driven = ways.to_physical[:, n:, 1::2] @ at_rest.loading.load[..., None]
            acceleration = acceleration.copy()
            acceleration[..., -1] = (driven - acceleration[..., n : 2 * n] @ moving[:, n:])[..., 0]
        rest[:, n:] = 0.0
        mode = mode._replace(
            blocks=blocks[:, None], waves=gap.waves[:, None], numbers=gap.numbers[:, None], forced=gap.forced,
            ends=stops, acceleration=acceleration,
        )  # fmt: skip
        elements = elements._replace(stops=stops, R=machines.R[:, None])

        def describe() -> HybridMachines:
            load = (machines.mass @ acceleration[..., -1:])[..., 0]
            return self.system.definition.hybrid(fixed | values)._replace(load=load[:, None], stops=stops)

        orbit_machines = OrbitMachines(
            machines.omega, phase_of(machines.tau), elements, rest, {FLYING: mode}.__getitem__, describe,
            lambda: build(machines)[0],
        )  # fmt: skip
        return orbit_machines, reasons


def _flight(structure: Structure, machines: Machines) -> Pieces:
    """The mode of flight as far as matrices and force decide it; the remaining fields are to be replaced."""
    modes, inverse, (N, n) = structure.flow.modes, structure.flow.inverse_mass, machines.gap_row.shape
    H, none, nothing = machines.force_sin.shape[1], np.zeros(N), np.zeros((N, 0))
    rows, acceleration = np.zeros((N, 1, 2 * n + 1)), np.zeros((N, n, 2 * n + 1))
    rows[:, 0, :n] = machines.gap_row
    acceleration[..., :n], acceleration[..., n : 2 * n] = -inverse @ machines.stiffness, -inverse @ machines.damping
    force = np.stack([machines.force_sin, machines.force_cos], axis=-1)  # (N, H, n, 2)
    drive = np.ascontiguousarray(np.einsum("rij,rhjp->rihp", inverse, force))
    return Pieces(
        nothing, nothing, nothing, nothing, rows, np.zeros((N, 1, H, 2)), none[:, None], nothing,
        np.ascontiguousarray(modes.to_blocks), np.ascontiguousarray(modes.to_physical), acceleration,
        drive, none, none,
    )  # fmt: skip


def _contact(structure: Structure, machines: Machines) -> Elements:
    """The rigid contact of machines; its stops and R are to be replaced."""
    N, n = machines.gap_row.shape
    kick = structure.accelerance / structure.inverse_gap_mass[:, None]
    none, nothing = np.zeros((N, 1)), np.zeros((N, 0))
    rub = np.zeros((N, 0, n))
    return Elements(
        np.ascontiguousarray(machines.gap_row[:, None]), kick[:, None], 1.0 / structure.inverse_gap_mass[:, None],
        nothing, nothing, none, rub, rub, nothing, np.zeros((N, 1, 0)), np.zeros((N, 0, 1)),
        np.tile([0.0, 1.0], (N, 1)), none + 1.0, np.zeros((N, 1, 2, 1)), np.zeros((N, 0, 1)),
    )  # fmt: skip

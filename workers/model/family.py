"""Machines over a few free parameters, with their modes: linear equations between events, built at first use."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.model.free_flight import centred, structure_of, unbalanced
from workers.model.hybrid_modes import HybridModes, ModeCode, build_modes_at, structures_of
from workers.model.machines import Machines, faults
from workers.model.mode_table import ContactElements, build_hybrid, elements_of
from workers.model.oscillator import Array, Mask, Oscillator, Rows, at_rows
from workers.model.system import System
from workers.results import OUT_OF_DOUBLES


class NoOscillatorError(ValueError):
    """Error for parameters at which no oscillator exists."""


@dataclass
class OrbitMachines:
    """N machines of n coordinates and their modes, each built at its first use.

    omega     (N,) forcing frequency
    tau       (N,) forcing phase at a section t = k T, T the forcing period
    elements  contacts and friction
    rest      (N, 2n) physical state from which states and stops are counted
    make      function that builds a mode of all N machines
    describe  function that returns the matrices, contacts and friction of the machines, counted from rest
    build     function that returns the machines in the form for the compiled kernels of cells
    known     modes built so far

    A mode is a set of linear equations of motion between two events.
    """

    omega: Array
    tau: Array
    elements: ContactElements
    rest: Array
    make: Callable[[ModeCode], HybridModes]
    describe: Callable[[], Machines]
    build: Callable[[], Oscillator]
    known: dict[ModeCode, HybridModes] = field(default_factory=dict)

    def mode(self, code: ModeCode) -> HybridModes:
        """Return the mode ``code``, a set of linear equations between events, of all machines.

        Raise NoOscillatorError if the mode does not exist.
        """
        if code not in self.known:
            self.known[code] = self.make(code)
        return self.known[code]

    @cached_property
    def machines(self) -> Machines:
        """Matrices, force, contacts and friction of the machines as arrays."""
        return self.describe()

    @cached_property
    def oscillators(self) -> Oscillator:
        """The machines in the form for the compiled kernels of cells."""
        return self.build()

    def at_rows(self, rows: Rows) -> "OrbitMachines":
        """Return the machines of these rows, in this order; they share the modes, the linear equations, of all."""
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
    """Return a function that takes values (N, free) and returns N machines and codes (N,) of why one is invalid.

    system  the system of the machines
    fixed   values of other parameters by name; the rest have their defaults
    free    names of the parameters that vary

    The code of a valid machine is NO_REASON.
    """
    return _MachineFactory(system, fixed, free)


def with_modes(machines: Machines) -> OrbitMachines:
    """Return machines with their modes, the linear equations between events, which are built at their first use."""
    return _MachineParts(machines, np.zeros((len(machines.omega), machines.dimension))).at(machines.omega, machines.tau)


class _MachineParts:
    """Machines apart from forcing frequency and phase; their states are counted from ``rest`` (N, 2n)."""

    def __init__(self, machines: Machines, rest: Array) -> None:
        self.machines, self.rest = machines, rest
        self.structures = cache(lambda code: structures_of(machines, code))

    @cached_property
    def reasons(self) -> NDArray[np.int8]:
        """Code (N,) of the reason why each machine is invalid, NO_REASON if it is valid, see faults."""
        return faults(self.machines)

    @cached_property
    def elements(self) -> ContactElements:
        """Contacts and friction of the machines."""
        return elements_of(self.machines)

    def at(self, omega: Array, tau: Array) -> OrbitMachines:
        """Return the machines at forcing frequencies and phases (N,)."""
        machines = self.machines._replace(omega=omega, tau=tau)

        def make(code: ModeCode) -> HybridModes:
            pieces, wrong = build_modes_at(self.structures(code), omega)
            if np.any(wrong):
                raise NoOscillatorError("a mode of this orbit has no bounded motion at these parameters")
            return pieces

        return OrbitMachines(
            omega, tau, self.elements, self.rest, make, lambda: machines, lambda: build_hybrid(machines)[0]
        )


class _MachineFactory:
    """Function object that makes machines of a system from values of its free parameters; the others are fixed."""

    def __init__(self, system: System, fixed: Mapping[str, float], free: tuple[str, ...]) -> None:
        self.system, self.free = system, free
        self.fixed = {p.name: float(fixed.get(p.name, p.default)) for p in system.parameters if p.name not in free}
        self.parts: dict[int, _MachineParts] = {}
        self.changes = system.definition.unforced or system.definition.changes_with(free)

    @np.errstate(all="ignore")
    def __call__(self, rows: Array) -> tuple[OrbitMachines, NDArray[np.int8]]:
        """Return the machines at values ``rows`` (N, free), and codes (N,) of why one is invalid, NO_REASON if none."""
        definition = self.system.definition
        values = {name: np.full(len(rows), value) for name, value in self.fixed.items()}
        values |= {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(self.free)}
        parts = self.parts.get(len(rows))
        if parts is None or self.changes:
            parts = self.parts[len(rows)] = _MachineParts(*self.from_rest(values))
        machines = parts.at(*definition.forcing(values))
        known = np.isfinite(machines.omega) & np.isfinite(machines.tau)
        reasons = np.where(known, parts.reasons, OUT_OF_DOUBLES).astype(np.int8)
        return machines, self.system.out_of_range(values, reasons)

    def from_rest(self, values: Mapping[str, Array]) -> tuple[Machines, Array]:
        """Return machines with stops counted from a rest position, and the state of rest (N, 2n).

        ``values`` (N,) are those of each parameter. Machines with more elements than one rigid contact are counted from
        0. Counting from a rest far from the origin would cost digits, and hide that a motion is its own mirror image.
        """
        machines = self.system.definition.machines(values)
        N, n = len(machines.omega), machines.dimension // 2
        if self.system.has_modes:
            return machines, np.zeros((N, 2 * n))
        structure = structure_of(machines)
        at_rest = centred(structure, machines)
        rest = (structure.flow.modes.to_physical @ at_rest.loading.rest.reshape(N, 2 * n, 1))[..., 0]
        rest[:, n:] = 0.0
        stops = np.stack([-at_rest.b_lower, at_rest.b_upper], axis=1)
        load, _ = unbalanced(structure, at_rest, machines)
        return machines._replace(load=load[:, None], stops=stops[:, None]), rest

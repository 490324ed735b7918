"""Machines that several tests solve: oscillators from matrices, and one mass under a cosine."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from workers.model.build import build
from workers.model.machines import Machines
from workers.model.oscillator import Oscillator, take_one
from workers.model.system import System
from workers.results import NO_REASON, InvalidError

RIGID = (
    "mass", "damping", "stiffness", "gap_row", "force_sin", "force_cos", "load", "omega", "tau", "upper", "lower", "R",
)  # fmt: skip
"""The numbers of a machine with one rigid contact by name, the arguments of ``rigid_machines``."""


def rigid_machines(**fields: ArrayLike) -> Machines:
    """N machines with one rigid contact, from their numbers RIGID with an axis (N) before the others."""
    mass, damping, stiffness, row, sines, cosines, load, omega, tau, upper, lower, R = (
        np.ascontiguousarray(fields[name], dtype=np.float64) for name in RIGID
    )
    (N, n), none = row.shape, np.zeros((len(row), 1))
    return Machines(
        mass, damping[:, None], stiffness[:, None], load[:, None], sines[:, None], cosines[:, None], omega, tau,
        starts=np.tile([0.0, 1.0], (N, 1)), row=row[:, None], stops=np.stack([lower, upper], axis=-1)[:, None],
        R=R[:, None], soft=none, by_force=none, contact_constants=np.zeros((N, 1, 1, 3)),
        friction_rows=np.zeros((N, 0, n)), belt=np.zeros((N, 0)), friction_constants=np.zeros((N, 1, 0, 2, 3)),
        contact_laws=np.zeros((N, 1, 2, 1, 3)), friction_laws=np.zeros((N, 0, 2, 1, 3)), counted=none + 1.0,
        drift=np.full(N, -1.0),
    )  # fmt: skip


def rigid_numbers(machines: Machines) -> dict[str, np.ndarray]:
    """The numbers RIGID of machines with one rigid contact."""
    names = ("damping", "stiffness", "load", "force_sin", "force_cos")
    return {
        "mass": machines.mass, "omega": machines.omega, "tau": machines.tau, "gap_row": machines.row[:, 0],
        "lower": machines.stops[:, 0, 0], "upper": machines.stops[:, 0, 1], "R": machines.R[:, 0],
        **{name: getattr(machines, name)[:, 0] for name in names},
    }  # fmt: skip


def build_one(machine: Machines) -> Oscillator:
    """The oscillator of the only machine; InvalidError where there is a reason against it."""
    oscillators, reasons = build(machine)
    if reasons[0] != NO_REASON:
        raise InvalidError(int(reasons[0]))
    return take_one(oscillators, 0)


def mass_spring(
    *,
    mass: ArrayLike,
    damping: ArrayLike,
    stiffness: ArrayLike,
    gap_row: ArrayLike,
    force: ArrayLike,
    omega: float,
    tau: float,
    b_upper: float,
    b_lower: float,
    R: float,
    load: ArrayLike | None = None,
) -> Oscillator:
    """M x'' + C x' + K x = force sin(omega t + tau) + load with stops at b_upper and -b_lower on gap_row . x."""
    row = np.asarray(gap_row, dtype=np.float64)
    force = np.asarray(force, dtype=np.float64)[None]
    fields: tuple[Any, ...] = (
        mass, damping, stiffness, row, force, np.zeros_like(force), np.zeros(len(row)) if load is None else load,
        omega, tau, b_upper, -b_lower, R,
    )  # fmt: skip
    named = zip(RIGID, fields, strict=True)
    return build_one(rigid_machines(**{name: np.asarray(field)[None] for name, field in named}))


def cosine_mass(**given: Any) -> System:
    """One mass of 1 on a spring of 1, forced by A cos(omega t), with what else is given."""
    table = {
        "name": "one-mass", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "stiffness": [[1.0]],
        "force": ["A"], "phase": [0.5 * math.pi],
        "parameters": {"omega": {"default": 1.0}, "A": {"default": 2.0}},
    }  # fmt: skip
    parameters = {"parameters": table["parameters"] | given.pop("parameters", {})}  # type: ignore[operator]
    return System.from_mapping(table | given | parameters)

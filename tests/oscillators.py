"""Machines that several tests solve: oscillators from matrices, and one mass under a cosine."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from workers.model.build import build
from workers.model.oscillator import Oscillator, SingleContactMachines, take_one
from workers.model.system import System
from workers.results import NO_REASON, InvalidError


def build_one(machine: SingleContactMachines) -> Oscillator:
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
    return build_one(SingleContactMachines(*(np.asarray(field, dtype=np.float64)[None] for field in fields)))


def cosine_mass(**given: Any) -> System:
    """One mass of 1 on a spring of 1, forced by A cos(omega t), with what else is given."""
    table = {
        "name": "one-mass", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "stiffness": [[1.0]],
        "force": ["A"], "phase": [0.5 * math.pi],
        "parameters": {"omega": {"default": 1.0}, "A": {"default": 2.0}},
    }  # fmt: skip
    parameters = {"parameters": table["parameters"] | given.pop("parameters", {})}  # type: ignore[operator]
    return System.from_mapping(table | given | parameters)

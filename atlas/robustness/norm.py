"""The norm in which deviations of a state are measured: a weighted Euclidean norm."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from atlas.argument_checks import validate_type
from atlas.errors import InputError, check_names
from atlas.spec.axis import number
from workers.model.oscillator import Array
from workers.model.system import System


def validate_weights(parameters: Mapping[str, Any] | None, system: System) -> dict[str, float]:
    """Return the weights of a norm that a user gives, by component of the state.

    Raise InputError for an unknown name or a weight that is not above 0.

    >>> from workers.model.system import find_system
    >>> validate_weights({"v1": 2}, find_system("two-mass"))
    {'v1': 2.0}
    """
    parameters = (
        {}
        if parameters is None
        else validate_type("norm", parameters, Mapping, "weights by component, such as {'v1': 2}")
    )
    check_names("component of the state in norm", parameters, system.states)
    weights = {name: number(f"norm.{name}", value) for name, value in parameters.items()}
    for name, weight in weights.items():
        if weight <= 0.0:
            raise InputError(f"norm.{name}: found {weight:g}, must be above 0")
    return weights


def weights_of(parameters: Mapping[str, float], system: System, period: float) -> Array:
    """Return the weights w (2n,) of the norm |dz| = sqrt(sum (w_i dz_i)^2) of a deviation dz of the state.

    parameters   weights that a user gives, by component of the state
    system       the system
    period       forcing period T

    Weights that are not given are 1, and 1 / omega for velocities, so the norm has the unit of displacement by default.
    """
    n, time = len(system.states) // 2, period / (2.0 * np.pi * system.definition.turns)
    default = [1.0] * n + [time] * n
    return np.array([parameters.get(name, usual) for name, usual in zip(system.states, default, strict=True)])


def weight_matrices(matrices: Array, weights: Array) -> Array:
    """Return W J W^-1 of matrices J (..., d, d), with W the diagonal matrix of weights (d,).

    The 2-norm of a result is the norm of J with respect to the weighted norm |W z|.
    """
    return np.asarray(weights[:, None] * matrices / weights)

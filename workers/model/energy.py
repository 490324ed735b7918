"""The energy of machines with soft contacts and springs: an invariant if nothing drives or loses it."""

import numpy as np

from workers.model.machines import Machines
from workers.model.oscillator import Array


def energy(machines: Machines, states: Array) -> tuple[Array, Array]:
    """Return the energy (N,) of N machines in physical states (N, 2n), and the sum (N,) of the moduli of its terms.

    x' M x / 2 + x K x / 2 - load x, and of each soft contact or spring at depth d the integral of its force from 0 to
    d. Phases, forces, dampers and friction have no part in it.
    """
    x, v = np.split(states, 2, axis=1)
    terms = [
        0.5 * np.einsum("ni,nij,nj->n", v, machines.mass, v),
        0.5 * np.einsum("ni,nij,nj->n", x, machines.stiffness[:, 0], x),
        -np.vecdot(machines.load[:, 0], x),
    ]
    y = np.vecdot(machines.row, x[:, None])[..., None] - machines.stops  # (N, C, 2)
    depth = np.where(machines.soft[..., None] > 0.0, np.maximum([-1.0, 1.0] * y, 0.0), 0.0)
    stiffness, _, preload = np.moveaxis(machines.contact_constants[:, 0, :, None], -1, 0)
    terms += list(np.moveaxis(0.5 * stiffness * depth**2 + preload * depth, (1, 2), (0, 1)).reshape(-1, len(x)))
    starts, slopes, levels = np.moveaxis(machines.contact_laws, -1, 0)  # (N, C, 2, S)
    ends = np.concatenate([starts[..., 1:], np.full_like(starts[..., :1], np.inf)], axis=-1)
    low = np.minimum(starts, depth[..., None])
    high = np.minimum(ends, depth[..., None])
    laws = 0.5 * slopes * (high**2 - low**2) + levels * (high - low)
    terms.append(np.sum(laws, axis=(1, 2, 3)))
    return np.sum(terms, axis=0), np.sum(np.abs(terms), axis=0)

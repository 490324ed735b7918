"""A piecewise-linear machine in numbers, as in tests/data/piecewise.json and for the simulator.

M x'' + C x' + K x = sum_h (sin_h sin(h omega t) + cos_h cos(h omega t)) + load + forces of contacts and of friction
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from tests.support.oracle.linear import Number

Vector = Sequence[Number]
Rows = Sequence[Vector]


@dataclass(frozen=True)
class HarmonicForce:
    """Forces on the coordinates at ``order`` times omega: ``sin`` and ``cos`` (n,)."""

    order: int
    sin: Vector
    cos: Vector


@dataclass(frozen=True)
class PiecewiseContact:
    """Stops on y = row.x at ``upper`` and ``lower``, either of which may be absent.

    Rigid, with a ``restitution``: y' turns into -restitution y'. Soft, without: beyond a stop by delta, the force
    preload + stiffness delta + damping delta' pushes back. With ``release`` "force" it never pulls: at zero force the
    stop detaches until it would push again.
    """

    row: Vector
    upper: Number | None = None
    lower: Number | None = None
    restitution: Number | None = None
    stiffness: Number = 0.0
    damping: Number = 0.0
    preload: Number = 0.0
    release: str = "displacement"

    @property
    def stops(self) -> dict[int, Number]:
        """Position by side (+1 upper, -1 lower) of the stops that exist."""
        pairs = ((1, self.upper), (-1, self.lower))
        return {side: stop for side, stop in pairs if stop is not None and math.isfinite(stop)}


@dataclass(frozen=True)
class PiecewiseFriction:
    """Coulomb friction on v_r = row.x' - belt: kinetic + slope |v_r| against v_r, up to ``static`` at v_r = 0."""

    row: Vector
    kinetic: Number
    static: Number
    belt: Number = 0.0
    slope: Number = 0.0


@dataclass(frozen=True)
class PiecewisePhase:
    """Entries from ``start`` (a fraction of the forcing period) to the next phase, in place of the machine's own.

    ``contacts`` and ``friction``: by index, the changed numbers of the element's law.
    """

    start: Number
    stiffness: Rows | None = None
    damping: Rows | None = None
    load: Vector | None = None
    forces: tuple[HarmonicForce, ...] | None = None
    contacts: Mapping[int, Mapping[str, Number]] | None = None
    friction: Mapping[int, Mapping[str, Number]] | None = None


@dataclass(frozen=True)
class PiecewiseMachine:
    """``mass``, ``damping``, ``stiffness`` (n, n), ``load`` (n,); entries are exact doubles or mpmath's."""

    mass: Rows
    damping: Rows
    stiffness: Rows
    load: Vector
    omega: Number
    forces: tuple[HarmonicForce, ...] = ()
    contacts: tuple[PiecewiseContact, ...] = ()
    friction: tuple[PiecewiseFriction, ...] = ()
    phases: tuple[PiecewisePhase, ...] = (PiecewisePhase(0.0),)

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.mass)

    def during(self, phase: PiecewisePhase) -> "PiecewiseMachine":
        """The machine in one phase."""
        own = {key: getattr(phase, key) for key in ("stiffness", "damping", "load", "forces")}
        return replace(
            self,
            contacts=tuple(replace(c, **(phase.contacts or {}).get(i, {})) for i, c in enumerate(self.contacts)),
            friction=tuple(replace(f, **(phase.friction or {}).get(i, {})) for i, f in enumerate(self.friction)),
            phases=(PiecewisePhase(0.0),),
            **{key: value for key, value in own.items() if value is not None},
        )

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> "PiecewiseMachine":
        """The machine of a JSON record."""
        lists = {"contacts": PiecewiseContact, "friction": PiecewiseFriction, "forces": HarmonicForce}
        made = {key: tuple(kind(**entry) for entry in record[key]) for key, kind in lists.items()}
        phases = tuple(_phase(entry) for entry in record.get("phases", ())) or (PiecewisePhase(0.0),)
        plain = {key: record[key] for key in ("mass", "damping", "stiffness", "load", "omega")}
        return cls(**plain, **made, phases=phases)

    def record(self) -> dict[str, Any]:
        """The machine in JSON form; a contact has only the keys of its law."""
        result = asdict(self)
        for contact in result["contacts"]:
            rigid = contact["restitution"] is not None
            for key in ("stiffness", "damping", "preload", "release") if rigid else ("restitution",):
                del contact[key]
        result["phases"] = [{k: v for k, v in phase.items() if v is not None} for phase in result["phases"]]
        return result


def _phase(record: Mapping[str, Any]) -> PiecewisePhase:
    made = dict(record)
    if "forces" in made:
        made["forces"] = tuple(HarmonicForce(**entry) for entry in made["forces"])
    for key in ("contacts", "friction"):  # JSON's keys are strings
        if key in made:
            made[key] = {int(i): numbers for i, numbers in made[key].items()}
    return PiecewisePhase(**made)

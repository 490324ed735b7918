"""How far a store is, from the store alone."""

from dataclasses import dataclass
from typing import Any

from atlas.plan import Plan, make_plan
from atlas.store import Header, done_tiles, regime_counts


@dataclass(frozen=True)
class Status:
    """Tiles and cells done of a store, and the regimes of the cells done (those that occur)."""

    header: Header
    plan: Plan
    tiles_done: int
    cells_done: int
    regimes: dict[str, int]

    @property
    def fraction(self) -> float:
        """Share of the cells that is done."""
        return self.cells_done / self.plan.cells

    def __str__(self) -> str:
        axes = " x ".join(map(str, self.header.spec.axes))
        lines = [
            f"axes     {axes}",
            f"tiles    {self.tiles_done} of {self.plan.tile_count} done",
            f"cells    {self.cells_done} of {self.plan.cells} done ({100 * self.fraction:.1f} %)",
            f"solver   version {self.header.solver_version}",
        ]
        total = max(1, self.cells_done)
        lines += [f"  {name:<15}{count:>10}  {100 * count / total:6.2f} %" for name, count in self.regimes.items()]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """What ``atlas status --json`` prints."""
        spec = self.header.spec
        return {
            "store": str(self.header.place),
            "system": spec.system,
            "axes": [
                {"name": a.name, "start": a.values[0], "stop": a.values[-1], "num": len(a), "scale": a.scale}
                for a in spec.axes
            ],
            "parameters": spec.parameters,
            "solve": spec.resolved()["solve"],
            "tile": self.plan.tile,
            "tiles": self.plan.tile_count,
            "tiles_done": self.tiles_done,
            "tiles_pending": self.plan.tile_count - self.tiles_done,
            "cells": self.plan.cells,
            "cells_done": self.cells_done,
            "fraction": self.fraction,
            "regimes": self.regimes,
            "solver_version": self.header.solver_version,
            "run_id": self.header.run_id,
            "digest": self.header.digest,
        }


def read_status(header: Header) -> Status:
    """The status of a store; reads the regimes of the finished tiles."""
    plan = make_plan(header.spec, workers=1, tile=header.tile)
    done = done_tiles(header)
    return Status(header, plan, len(done), sum(map(plan.size, done)), regime_counts(header, done))

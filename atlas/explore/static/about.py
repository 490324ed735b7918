"""The texts of the HTML page of an atlas: its axes, variables and parameters, its origin, and what to cite."""

import shlex
from typing import TYPE_CHECKING, Any

from atlas.cell.point_command import point_words
from atlas.query.extremes import variable_of
from atlas.query.plane import PlaneAxis as PlaneAxis
from atlas.render import text
from atlas.render.coded_maps import text_of
from atlas.spec.citation import bibtex, software_version
from atlas.store.origin import ALLOWANCES
from atlas.store.store import AtlasStore
from workers.results import ATTRACTOR, ERROR, LARGEST, PENDING, REASON, REASONS, REGIME

if TYPE_CHECKING:
    import xarray as xr

_PROVENANCE = {
    "title": "atlas", "digest": "digest of the spec", "solver_version": "solver version", "software": "computed with",
    "run_id": "run", "origin": "grown from", "references": "sources of the machine",
}  # fmt: skip
"""Attributes of a store that a page lists, with their names on the page."""


def described(ds: "xr.Dataset", handle: AtlasStore, axes: tuple[PlaneAxis, PlaneAxis]) -> dict[str, Any]:
    """Return what the page's script must know of an atlas, as plain JSON: axes, fixed parameters, and words.

    ds       the plane of the atlas
    handle   handle of its store
    axes     axes of the plane
    """
    record, attractor = handle.spec.system_def, ds.attrs.get(ATTRACTOR)
    names = {meant.code: meant.text for meant in record.regime.codes}
    fixed = [p for p in record.parameters if p.name in ds.coords and ds[p.name].ndim == 0]
    return {
        "axes": [_axis(ds, axis) for axis in axes],
        "fixed": [
            {"symbol": _symbol(ds, p.name), "meaning": p.meaning, "value": float(ds[p.name])}
            for p in fixed
            if float(ds[p.name]) or p.name not in record.states
        ],
        "attractor": attractor,
        "allowances": {meant.name: f"--{meant.setting.replace('_', '-')}" for meant in ALLOWANCES},
        **meanings(),
        "regimes": names | ({PENDING: f"not more than {attractor}"} if attractor else {}),
    }


def meanings() -> dict[str, Any]:
    """Return the regimes and the reasons for them in words, and the names of variables that a page treats specially."""
    special = {"regime": REGIME, "reason": REASON, "largest": LARGEST, "error": ERROR}
    return {
        "regimes": {meant.code: meant.text for meant in REGIME.codes},
        "reasons": [reason.text for reason in REASONS],
        "special": {"pending": PENDING} | {name: meant.name for name, meant in special.items()},
    }


def command(ds: "xr.Dataset", handle: AtlasStore) -> str:
    """Return the shell command that solves a cell of the atlas again, without the values of the axes.

    The command is empty if cells start from a state that the page does not have. Such a state lies on one of several
    attractors, or is the end of a neighbouring cell's motion.
    """
    spec = handle.spec
    if spec.coexistence or spec.continuation is not None:
        return ""
    values = {
        p.name: float(ds[p.name]) for p in spec.system_def.parameters if p.name in ds.coords and not ds[p.name].ndim
    }
    return shlex.join(point_words(spec.system_def, values, spec.settings))


def variable(ds: "xr.Dataset", name: str) -> dict[str, Any]:
    """Return what the page's script must know of a variable, as plain JSON.

    It holds the label with its unit, True for a flag, and the regimes in which the variable is a result. ``endless`` is
    True if values below zero stand for infinity.
    """
    meant = variable_of(ds, name)
    return {
        "label": text_of(text.variable_label(ds, name)),
        "flag": ds[name].dtype.kind == "b",
        "endless": meant.allows_infinite,
        "regimes": sorted(meant.regimes),
    }


def provenance(ds: "xr.Dataset", handle: AtlasStore) -> dict[str, str]:
    """Return the origin of the numbers, such as digest, solver version and sources, as texts by name."""
    cells = " × ".join(f"{len(axis):,}".replace(",", "\N{NARROW NO-BREAK SPACE}") for axis in handle.spec.axes)
    named = {"cells": cells} | {_PROVENANCE[key]: str(ds.attrs[key]) for key in _PROVENANCE if key in ds.attrs}
    return {name: named[name] for name in ("atlas", *named) if name in named}


def citation(ds: "xr.Dataset", handle: AtlasStore) -> str:
    """Return what to cite for the atlas, as BibTeX entries."""
    return bibtex(handle.spec.system_def, software_version(str(ds.attrs.get("software", ""))), handle.solver_version)


def _axis(ds: "xr.Dataset", axis: PlaneAxis) -> dict[str, Any]:
    return {
        "name": axis.name,
        "symbol": _symbol(ds, axis.name),
        "label": text_of(text.axis_label(axis.name, axis.meaning)),
        "log": axis.log,
        "values": axis.values.tolist(),
        "edges": axis.edges.tolist(),
    }


def _symbol(ds: "xr.Dataset", name: str) -> str:
    return text_of(f"${text.symbol(ds, name)}$")

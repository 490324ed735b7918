"""Writing pictures to files, with metadata that tell where the numbers are from."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from atlas.argument_checks import validate_path
from atlas.query.export import check_target, replace_on_success
from atlas.query.window import axis_names
from atlas.spec.system import stored_name
from atlas.store.host import package_version
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from atlas.cell.trajectory import CellTrajectory
    from atlas.orbits.branches.table import BranchTable
    from atlas.render.layout import FigureLayout

FORMATS = ("png", "svg", "pdf")
"""Formats of a picture, by the suffix of the file."""
UNKNOWN = "unknown"


class Provenance(NamedTuple):
    """Where the numbers of a picture are from.

    title     title of the picture
    digest    digest of the spec
    solver    version of the solver
    spec      the spec as JSON
    software  versions of the software
    """

    title: str
    digest: str
    solver: str
    spec: str
    software: str


def check_path(path: str | Path) -> str:
    """Return the format of a picture's file, by its suffix. Call this function before long work.

    Raise InputError for an unknown suffix, and if the file cannot be written.
    """
    return check_target(validate_path(path), [f".{name}" for name in FORMATS]).removeprefix(".")


def save(fig: "Figure", target: Path, provenance: Provenance, layout: "FigureLayout") -> None:
    """Write a figure to the file ``target`` with its provenance.

    Raise InputError if the file cannot be written: an older picture then remains.
    """
    suffix = check_path(target)
    with replace_on_success(target) as unfinished, layout.context():
        fig.savefig(unfinished, format=suffix, metadata=metadata(provenance, suffix))


def provenance_of(*subjects: "xr.Dataset | CellTrajectory | BranchTable") -> Provenance:
    """Return the provenance of a picture of an atlas, an orbit or branches.

    For several atlases it names their digests and solver versions in order, and is otherwise that of the first.
    """
    every = [_of_one(subject) for subject in subjects]
    solvers = dict.fromkeys(one.solver for one in every)
    return every[0]._replace(digest=" ".join(one.digest for one in every), solver=" ".join(solvers))


def provenance_of_values(title: str, spec: Mapping[str, Any], digest: str = "none") -> Provenance:
    """Return the provenance of numbers computed by this process; ``spec`` has everything that decides the numbers."""
    return Provenance(f"impact-atlas: {title}", digest, str(SOLVER_VERSION), json.dumps(spec), _own())


def metadata(provenance: Provenance, suffix: str) -> dict[str, str | None]:
    """Return the provenance under the names that the file format ``suffix`` has for it, for ``Figure.savefig``.

    There is no date: equal pictures are equal files.
    """
    title, digest, solver, spec, computed_by = provenance
    software = f"{_own()}, matplotlib {package_version('matplotlib')}"
    source = f"computed by {computed_by}" + ("" if solver == UNKNOWN else f"; solver version {solver}")
    if suffix == "svg":
        named = {"Creator": software, "Identifier": digest, "Source": source, "Description": spec, "Date": None}
    elif suffix == "pdf":
        named = {"Creator": software, "Subject": digest, "Keywords": f"{source}; {spec}", "CreationDate": None}
    else:
        named = {"Software": software, "Digest": digest, "Source": source, "Solver": solver, "Spec": spec}
    return {"Title": title, **named}


def _own() -> str:
    return f"impact-atlas {package_version('impact-atlas')}"


def _of_one(subject: "xr.Dataset | CellTrajectory | BranchTable") -> Provenance:
    import xarray as xr

    if isinstance(subject, xr.Dataset):
        system, axes = stored_name(subject.attrs) or "unknown system", ", ".join(axis_names(subject))
        digest, solver, spec = (str(subject.attrs.get(name, UNKNOWN)) for name in ("digest", "solver_version", "spec"))
        software = str(subject.attrs.get("software", "unknown software"))
        return Provenance(f"impact-atlas: {system}, axes {axes}", digest, solver, spec, software)
    along = getattr(subject, "along", None)
    what = "one cell" if along is None else f"branches along {along}"
    return provenance_of_values(f"{subject.system.name}, {what}", subject.identity, subject.digest)

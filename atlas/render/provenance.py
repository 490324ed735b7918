"""What a picture's file says of its numbers: title, digest and spec, the solver's version, the software."""

import json
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib as mpl
import xarray as xr

from atlas.query.window import axis_names
from atlas.spec.system import stored_name
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    from atlas.branches.table import Branches
    from atlas.cell.orbit import CellOrbit


UNKNOWN = "unknown"


class Provenance(NamedTuple):
    """A title, the digest of the spec, the version of the solver, the spec as JSON, the software that computed."""

    title: str
    digest: str
    solver: str
    spec: str
    software: str


def provenance_of(*subjects: "xr.Dataset | CellOrbit | Branches") -> Provenance:
    """The provenance of a picture of an atlas, an orbit or branches; of several atlases, with what differs in order."""
    every = [_of_one(each) for each in subjects]
    return every[0]._replace(digest=" ".join(each.digest for each in every), solver=_listed(every, "solver"))


def computed_here(title: str, spec: Mapping[str, Any], digest: str = "none") -> Provenance:
    """The provenance of numbers that this process has computed, from all that decides them."""
    return Provenance(
        f"impact-atlas: {title}", digest, str(SOLVER_VERSION), json.dumps(spec), f"impact-atlas {own_version()}"
    )


def metadata(provenance: Provenance, suffix: str) -> dict[str, str | None]:
    """The provenance in the words that a format has for it, for ``Figure.savefig``.

    No time of day: a date would make equal pictures unequal files.
    """
    software = f"impact-atlas {own_version()}, matplotlib {mpl.__version__}"
    solver = "" if provenance.solver == UNKNOWN else f"; solver version {provenance.solver}"
    source = f"computed by {provenance.software}{solver}"
    title, digest, spec = provenance.title, provenance.digest, provenance.spec
    if suffix == "svg":
        named = {"Title": title, "Creator": software, "Identifier": digest, "Source": source, "Description": spec}
        return {**named, "Date": None}
    if suffix == "pdf":
        return {"Title": title, "Creator": software, "Subject": digest, "Keywords": source, "CreationDate": None}
    words = {"Title": title, "Software": software, "Digest": digest, "Source": source}
    return {**words, "Solver": provenance.solver, "Spec": spec}


def own_version() -> str:
    """The version of this distribution, as files name it."""
    try:
        return version("impact-atlas")
    except PackageNotFoundError:
        return "(not installed)"


def _of_one(subject: "xr.Dataset | CellOrbit | Branches") -> Provenance:
    if isinstance(subject, xr.Dataset):
        attrs = {name: str(value) for name, value in subject.attrs.items()}
        system, axes = stored_name(subject.attrs) or "unknown system", ", ".join(axis_names(subject))
        return Provenance(
            f"impact-atlas: {system}, axes {axes}",
            attrs.get("digest", UNKNOWN),
            attrs.get("solver_version", UNKNOWN),
            attrs.get("spec", UNKNOWN),
            attrs.get("software", "unknown software"),
        )
    along = getattr(subject, "along", None)
    what = "one cell" if along is None else f"branches along {along}"
    return computed_here(f"{subject.system.name}, {what}", subject.decided_by, subject.digest)


def _listed(every: list[Provenance], name: str) -> str:
    return " ".join(dict.fromkeys(getattr(each, name) for each in every))

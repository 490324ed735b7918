"""The values of a store's axes, or of its table of points, which lie in coordinates, not in attributes.

Values that are not evenly spaced cannot be computed from the attributes, so they have a copy beside their coordinate.
"""

import itertools
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from atlas.errors import ChunkError, InputError, message_of
from atlas.spec.axis import Values, values_from_outline
from atlas.spec.resolved import outline_names, resolved_digest, with_values
from atlas.spec.spec import Spec
from atlas.store.object_backend import StoreBackend

ROOT = "zarr.json"
"""The name of the object with the metadata of an array or a group. A store exists once its root has one."""
MOST_MIXED = 64
"""Most sets of values that are tried, some of them stored and others copied: each takes a digest of all."""
_DTYPE = np.dtype("<f8")


def read_values(place: StoreBackend, outline: Mapping[str, Any], digest: str) -> Values:
    """The values of all axes or columns of a spec's outline, the same to the bit as in its digest.

    A damaged or changed coordinate is replaced by its copy, or computed if it was evenly spaced, as the digest shows.
    Otherwise ChunkError, which names the damaged object.
    """
    faults: dict[str, str] = {}
    candidates: dict[str, list[tuple[float, ...]]] = {name: [] for name in outline_names(outline)}
    axes = {axis["name"]: axis for axis in outline["axes"]}
    sources: tuple[Callable[[str], tuple[float, ...] | None], ...] = (
        lambda name: _stored(place, name, faults),
        lambda name: _copied(place, name),
        lambda name: _made(axes[name]) if name in axes else None,
    )
    for read in sources:
        for name, of_axis in candidates.items():
            if (values := read(name)) is not None and values not in of_axis:
                of_axis.append(values)
        newest = [of_axis[-1] for of_axis in candidates.values() if of_axis]  # all of them may have been changed
        mixed = itertools.product(*candidates.values()) if len(newest) == len(candidates) else ()
        for chosen in (newest, *itertools.islice(mixed, MOST_MIXED)) if mixed else ():
            together = dict(zip(candidates, chosen, strict=True))
            if resolved_digest(with_values(outline, together)) == digest:
                return together
    raise ChunkError(place, faults or {ROOT: "has a digest that does not match the spec and its coordinates"})


def matches_coordinates(place: StoreBackend, outline: Mapping[str, Any], digest: str) -> bool:
    """Whether a spec's outline has this digest with the coordinates stored at a place."""
    stored = {name: _stored(place, name, {}) for name in outline_names(outline)}
    known = {name: values for name, values in stored.items() if values is not None}
    return known.keys() == stored.keys() and resolved_digest(with_values(outline, known)) == digest


def changed_values(
    place: StoreBackend, outline: Mapping[str, Any], stored: Values, read: Callable[[], Values]
) -> list[str]:
    """The names of the axes or columns whose stored values are not the spec's.

    Equal to the copies or to even spacing they are right. ``read``, see ``read_values``, decides all other cases.
    """
    axes = {axis["name"]: axis for axis in outline["axes"]}
    others = ((_made(axes[name]) if name in axes else None) or _copied(place, name) for name in stored)
    if all(values == other for values, other in zip(stored.values(), others, strict=True)):
        return []
    right = read()
    return [name for name, values in stored.items() if values != right[name]]


def copies(spec: Spec) -> dict[str, bytes]:
    """The copies of values that cannot be computed from the outline of a spec, by their keys."""
    listed = spec.points or {axis.name: axis.values for axis in spec.axes if _made(axis.outline()) != axis.values}
    return {copy_key(name): np.array(values, dtype=_DTYPE).tobytes() for name, values in listed.items()}


def copy_key(name: str) -> str:
    """The key of the copy of a coordinate's values."""
    return f"{name}/copy"


def _stored(place: StoreBackend, name: str, faults: dict[str, str]) -> tuple[float, ...] | None:
    """The values of a coordinate; None if it is damaged, with the damage added to ``faults``."""
    import zarr

    from atlas.store.zarr_stores import zarr_store  # with it Zarr, which takes a while to load

    try:
        array: Any = zarr.open_array(zarr_store(place, read_only=True), path=name, mode="r", zarr_format=3)
        values = np.asarray(array[...], dtype=np.float64)
        if values.any() or place.exists(f"{name}/c/0"):  # a missing chunk reads as zeros
            return tuple(values.tolist())
        faults[name] = "is missing"
    except FileNotFoundError:
        faults[name] = "is missing"
    except (OSError, MemoryError):
        raise
    except Exception as error:  # a codec, or a parser of metadata, may raise anything
        faults[name] = f"is damaged ({message_of(error)})"
    return None


def _copied(place: StoreBackend, name: str) -> tuple[float, ...] | None:
    try:
        return tuple(np.frombuffer(place.get(copy_key(name)) or b"", dtype=_DTYPE).tolist()) or None
    except ValueError:
        return None


def _made(outline: Mapping[str, Any]) -> tuple[float, ...] | None:
    with suppress(InputError):
        return values_from_outline(outline)
    return None

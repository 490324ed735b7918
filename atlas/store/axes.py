"""The values of the axes of a store, or of the columns of its table of points; they are stored in coordinates.

Attributes have only the outline of the spec. Values that are not evenly spaced cannot be computed from the outline, so
they have a second copy beside their coordinate.
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
"""Name of the object with the metadata of an array or a group. A store exists once its root has this object."""
MOST_MIXED = 64
"""Maximum number of combinations of stored, copied and computed values to try; each needs a digest of all values."""
_DTYPE = np.dtype("<f8")


def read_values(place: StoreBackend, outline: Mapping[str, Any], digest: str) -> Values:
    """Return the values of all axes or columns of a spec's outline, bit for bit those of the digest.

    place     backend of the store
    outline   outline of the spec, without values
    digest    digest of the resolved spec

    A damaged or changed coordinate is replaced by its copy, or by computed values if it was evenly spaced; the digest
    confirms the choice. Otherwise raise ChunkError, which names the damaged object.
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
    """Return True if the outline of a spec has this digest with the coordinates stored in a backend."""
    stored = {name: _stored(place, name, {}) for name in outline_names(outline)}
    known = {name: values for name, values in stored.items() if values is not None}
    return known.keys() == stored.keys() and resolved_digest(with_values(outline, known)) == digest


def changed_values(
    place: StoreBackend, outline: Mapping[str, Any], stored: Values, read: Callable[[], Values]
) -> list[str]:
    """Return the names of the axes or columns whose stored values are not those of the spec.

    Values that equal their copies or are evenly spaced as in the outline are right. In all other cases ``read``, a call
    of ``read_values``, returns the right values.
    """
    axes = {axis["name"]: axis for axis in outline["axes"]}
    others = ((_made(axes[name]) if name in axes else None) or _copied(place, name) for name in stored)
    if all(values == other for values, other in zip(stored.values(), others, strict=True)):
        return []
    right = read()
    return [name for name, values in stored.items() if values != right[name]]


def copies(spec: Spec) -> dict[str, bytes]:
    """Return the copies, by key, of the values that cannot be computed from the outline of a spec."""
    listed = spec.points or {axis.name: axis.values for axis in spec.axes if _made(axis.outline()) != axis.values}
    return {copy_key(name): np.array(values, dtype=_DTYPE).tobytes() for name, values in listed.items()}


def copy_key(name: str) -> str:
    """Return the key of the copy of a coordinate's values."""
    return f"{name}/copy"


def _stored(place: StoreBackend, name: str, faults: dict[str, str]) -> tuple[float, ...] | None:
    """Return the stored values of a coordinate; None if it is missing or damaged.

    The damage is added to ``faults``.
    """
    import zarr

    from atlas.store.zarr_stores import zarr_store  # loads Zarr, which takes a while

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

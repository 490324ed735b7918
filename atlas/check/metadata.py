"""A store's metadata and coordinates, held against its spec, and its two copies of the metadata against each other."""

import numpy as np

from atlas.errors import message_of
from atlas.spec.spec import resolved_digest
from atlas.store.digests import DIGESTS
from atlas.store.schema import ALLOWANCES, extra_sizes
from atlas.store.store import ROOT, Header, open_arrays, open_digests
from atlas.store.tiles import covered_variables


def metadata_faults(header: Header) -> list[str]:
    """Contradictions between a store's metadata and its spec, or within its metadata; each in a few words.

    The store itself says which results it has: one made before a result was added has none of it.
    """
    spec = header.spec
    faults = []
    if resolved_digest(header.resolved) != header.digest:
        faults.append(f"{ROOT}: the digest is not that of the spec")
    try:
        own, copied = open_arrays(header), open_arrays(header, consolidated=True)
        digests = open_digests(header), open_digests(header, consolidated=True)
    except OSError:
        raise
    except Exception as error:  # metadata that are no longer JSON, or no longer make sense, may raise anything
        return [*faults, f"metadata are damaged: {message_of(error)}"]
    sizes, variables = extra_sizes(spec), header.variables
    shapes = {name: coordinate.values.shape for name, coordinate in header.coordinates.items()}
    shapes |= {v.name: spec.shape + tuple(sizes[dim] for dim in v.extra) for v in variables}
    given = {each.name for each in ALLOWANCES}
    for name in [*shapes, *(own.keys() | copied.keys()) - shapes.keys()]:
        where = f"{name}/{ROOT}"
        if name in given and name not in copied:
            continue  # a kill has come between the two; the next run copies it
        if name not in own:
            faults.append(f"{where} is missing")
        elif name in shapes and own[name].shape != shapes[name]:
            faults.append(f"{where}: shape {own[name].shape}, must be {shapes[name]}")
        elif name not in copied or str(copied[name].metadata.to_dict()) != str(own[name].metadata.to_dict()):
            faults.append(f"{ROOT}: its consolidated metadata are not those of {where}")
    for variable in spec.variables:
        if variable.name not in shapes and any(header.place.list_keys(f"{variable.name}/c/")):
            faults.append(f"{variable.name}/{ROOT} is missing")
    if len({str(array.metadata.to_dict()) if array else "" for array in digests}) > 1:
        faults.append(f"{ROOT}: its consolidated metadata are not those of {DIGESTS}/{ROOT}")
    elif digests[0] is not None:
        try:
            covered_variables(header, digests[0])
        except KeyError as error:
            faults.append(f"{DIGESTS}/{ROOT}: covers {error}, which the store does not have")
    for variable in variables:
        array = own.get(variable.name)
        if array is None:
            continue
        where = f"{variable.name}/{ROOT}"
        if (array.dtype, array.chunks[: len(header.tile)]) != (np.dtype(variable.dtype), header.tile):
            found = f"{array.dtype} in chunks of {array.chunks}"
            faults.append(f"{where}: {found}, must be {variable.dtype} in tiles of {header.tile}")
        if not np.array_equal(array.fill_value, variable.fill, equal_nan=np.dtype(variable.dtype).kind == "f"):
            faults.append(f"{where}: fill value {array.fill_value}, must be {variable.fill}")
    return faults


def coordinate_faults(header: Header) -> list[str]:
    """Coordinates that cannot be read or are not the spec's to the bit; each in a few words."""
    arrays, faults = open_arrays(header), []
    for name, coordinate in header.coordinates.items():
        try:
            values = np.asarray(arrays[name][...])
        except OSError:
            raise
        except Exception as error:  # a codec that meets bytes it never wrote may raise anything
            faults.append(f"coordinate {name} is damaged ({message_of(error)})")
            continue
        if not np.array_equal(values, coordinate.values):
            faults.append(f"coordinate {name} is not the spec's, or missing")
    return faults

"""What a store's metadata and coordinates say, held against what its spec says that they must."""

import numpy as np

from atlas.errors import message_of
from atlas.store.digests import PATH as DIGESTS
from atlas.store.schema import coordinates, extra_sizes
from atlas.store.store import ROOT, Header, open_arrays, open_digests
from workers.results import result_variables


def metadata_faults(header: Header) -> list[str]:
    """What of the metadata is not as a new store has them; each in a few words."""
    spec = header.spec
    faults = [] if spec.digest == header.digest else [f"{ROOT}: the digest is not that of the spec"]
    try:
        own, copied = open_arrays(header), open_arrays(header, consolidated=True)
        digests = open_digests(header), open_digests(header, consolidated=True)
    except OSError:
        raise
    except Exception as error:  # metadata that are no longer JSON, or no longer make sense, may raise anything
        return [*faults, f"metadata are damaged: {message_of(error)}"]
    variables, sizes = result_variables(spec.settings), extra_sizes(spec)
    shapes = {name: coordinate.values.shape for name, coordinate in coordinates(spec).items()}
    shapes |= {v.name: spec.shape + tuple(sizes[dim] for dim in v.extra) for v in variables}
    later = {v.name for v in variables if v.sparse}  # an older store has none
    for name, shape in shapes.items():
        if name in later and name not in own and name not in copied:
            continue
        where = f"{name}/{ROOT}"
        if name not in own:
            faults.append(f"{where} is missing")
        elif own[name].shape != shape:
            faults.append(f"{where}: shape {own[name].shape}, must be {shape}")
        elif name not in copied or str(copied[name].metadata.to_dict()) != str(own[name].metadata.to_dict()):
            faults.append(f"{ROOT}: its consolidated metadata are not those of {where}")
    if len({str(array.metadata.to_dict()) if array else "" for array in digests}) > 1:
        faults.append(f"{ROOT}: its consolidated metadata are not those of {DIGESTS}/{ROOT}")
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
    for name, coordinate in coordinates(header.spec).items():
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

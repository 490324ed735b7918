"""The differences of two specs, as text."""

from dataclasses import asdict

from atlas.spec.points import describe_difference
from atlas.spec.spec import Spec
from workers.model.system import identity


def differences(stored: Spec, given: Spec) -> list[str]:
    """Return the differences of two specs, a short line for each."""
    texts = []
    if stored.system != given.system:
        texts.append(f"system {stored.system} in the store, {given.system} in the spec")
    elif identity(stored.system_def.to_resolved()) != identity(given.system_def.to_resolved()):
        texts.append(f"system {stored.system} is defined differently in the store: {_defined_otherwise(stored, given)}")
    names, given_names = [axis.name for axis in stored.axes], [axis.name for axis in given.axes]
    if stored.points or given.points:
        texts += describe_difference(stored.points, given.points)
    elif names != given_names:
        what = "axis order differs" if sorted(names) == sorted(given_names) else "axes differ"
        texts.append(f"{what}: ({', '.join(names)}) in the store, ({', '.join(given_names)}) in the spec")
    else:
        pairs = zip(stored.axes, given.axes, strict=True)
        texts += [
            f"axis {old} in the store, {new} in the spec"
            for old, new in pairs
            if (old.values, old.continuation) != (new.values, new.continuation)
        ]
    if (stored.attractors is None) != (given.attractors is None):
        one, all_of_them = ("store", "spec") if stored.attractors is None else ("spec", "store")
        texts.append(f"one attractor for each cell in the {one}, all attractors in the {all_of_them}")
    for before, after in (
        (stored.parameters, given.parameters),
        (asdict(stored.settings), asdict(given.settings)),
        (stored.to_resolved().get("attractors", {}), given.to_resolved().get("attractors", {})),
    ):
        common = before.keys() & after.keys()
        texts += [
            f"{name} = {before[name]!r} in the store, {after[name]!r} in the spec"
            for name in before
            if name in common and before[name] != after[name]
        ]
    return texts


def _defined_otherwise(stored: Spec, given: Spec) -> str:
    """Return the entries that differ between two systems of the same name, as text."""
    if stored.system_def.packaged or given.system_def.packaged:
        return "only one of the two is in the package"
    one, other = (identity(spec.system_def.to_resolved())["system"] for spec in (stored, given))
    return ", ".join(key for key in one | other if one.get(key) != other.get(key))

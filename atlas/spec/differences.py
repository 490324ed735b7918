"""The differences between two specs, as text for messages."""

from dataclasses import asdict

from atlas.spec.points import describe_difference
from atlas.spec.spec import Spec
from workers.model.system import identity


def differences(stored: Spec, spec: Spec) -> list[str]:
    """Return a short line of text for each difference between a stored spec and another."""
    texts = []
    if stored.system != spec.system:
        texts.append(f"system {stored.system} in the store, {spec.system} in the spec")
    elif identity(stored.system_def.to_resolved()) != identity(spec.system_def.to_resolved()):
        texts.append(f"system {stored.system} is defined differently in the store: {_defined_otherwise(stored, spec)}")
    names, spec_names = [axis.name for axis in stored.axes], [axis.name for axis in spec.axes]
    if stored.points or spec.points:
        texts += describe_difference(stored.points, spec.points)
    elif names != spec_names:
        what = "axis order differs" if sorted(names) == sorted(spec_names) else "axes differ"
        texts.append(f"{what}: ({', '.join(names)}) in the store, ({', '.join(spec_names)}) in the spec")
    else:
        pairs = zip(stored.axes, spec.axes, strict=True)
        texts += [
            f"axis {old} in the store, {new} in the spec"
            for old, new in pairs
            if (old.values, old.continuation) != (new.values, new.continuation)
        ]
    if (stored.attractors is None) != (spec.attractors is None):
        one, all_of_them = ("store", "spec") if stored.attractors is None else ("spec", "store")
        texts.append(f"one attractor for each cell in the {one}, all attractors in the {all_of_them}")
    for before, after in (
        (stored.parameters, spec.parameters),
        (asdict(stored.settings), asdict(spec.settings)),
        (stored.to_resolved().get("attractors", {}), spec.to_resolved().get("attractors", {})),
    ):
        common = before.keys() & after.keys()
        texts += [
            f"{name} = {before[name]!r} in the store, {after[name]!r} in the spec"
            for name in before
            if name in common and before[name] != after[name]
        ]
    return texts


def _defined_otherwise(stored: Spec, spec: Spec) -> str:
    """Return text about the entries in which the systems of two specs differ although they have the same name."""
    if stored.system_def.packaged or spec.system_def.packaged:
        return "only one of the two is in the package"
    one, other = (identity(one_spec.system_def.to_resolved())["system"] for one_spec in (stored, spec))
    return ", ".join(key for key in one | other if one.get(key) != other.get(key))

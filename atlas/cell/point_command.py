"""The command line ``atlas point`` that solves a given cell again."""

from collections.abc import Collection, Mapping
from dataclasses import fields

from workers import Settings
from workers.model.system import DEFAULT, System


def point_words(
    system: System, parameters: Mapping[str, float], settings: Settings, always: Collection[str] = ()
) -> list[str]:
    """Return the words of the command line ``atlas point`` that solves a cell with these parameters, exact to the bit.

    Defaults are omitted unless their names are in ``always``. A system of the user's own is read from the file of its
    name.
    """
    words = ["atlas", "point"]
    if not system.packaged:
        words += ["--system", f"{system.name}.toml"]
    elif system.name != DEFAULT:
        words += ["--system", system.name]
    defaults = {p.name: None if p.formula else p.default for p in system.parameters}
    for name, value in parameters.items():
        if value != defaults[name] or name in always:
            words += ["--set", f"{name}={value!r}"]
    for field in fields(Settings):
        value = getattr(settings, field.name)
        if value != field.default:
            words += [f"--{field.name.replace('_', '-')}", str(value)]
    return words

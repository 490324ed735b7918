"""The values in the upper plot of a sweep, an atlas over one axis: for each cell section values or an observable.

Section values are the values of the gap coordinate at t = k T, the start of each forcing period.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.formatting import plural
from atlas.query import machine
from atlas.render import text
from atlas.spec.system import stored_spec, stored_system
from workers.model.observables import Observable, observables_of
from workers.model.system import System
from workers.results import PERIODIC, REGIME, SECTION

if TYPE_CHECKING:
    import xarray as xr

    from atlas.query.plane import PlaneAxis


@dataclass(frozen=True)
class PlottedValues:
    """The values that a sweep plots: those of an observable, or section values if ``observable`` is None.

    Section values, the gap coordinate at t = k T, exist in every atlas with ``section_samples``.
    """

    observable: Observable | None = None

    @classmethod
    def resolve(cls, requested: str | None, *atlases: "xr.Dataset") -> "PlottedValues | None":
        """Return the values to plot: the observable ``requested``, or the first choice that all of these atlases have.

        The first choice is section values, then observables in the order of the first atlas. Return None if there is no
        common choice. Raise InputError for a requested observable that an atlas lacks.
        """
        if requested is None and all(SECTION.name in ds and ds[SECTION.name].size for ds in atlases):
            return cls()
        stored = [atlas_observables(ds) for ds in atlases]
        if requested is None:
            common = [
                observable for observable in stored[0] if all(observable in observables for observables in stored)
            ]
            return cls(common[0]) if common else None
        for observables in stored:
            if requested not in [observable.name for observable in observables]:
                possible = (
                    f"it has {', '.join(observable.name for observable in observables)}"
                    if observables
                    else "see [solve] observe"
                )
                raise InputError(f"observe: this atlas has no {requested!r}; {possible}")
        return cls(next(observable for observable in stored[0] if observable.name == requested))

    @property
    def name(self) -> str:
        """The name of the variable that holds the values."""
        return SECTION.name if self.observable is None else self.observable.variable

    @property
    def reads(self) -> tuple[str, ...]:
        """The names of the variables that must be read to plot the values."""
        return (self.name,) if self.observable is None else (self.name, self.observable.number)

    def values(self, ds: "xr.Dataset", x: "PlaneAxis") -> NDArray[np.float64]:
        """Return the values (N, K) of the N cells along a sweep, up to K for each."""
        if self.observable is None:
            return machine.gap_values(ds, x.name, ds[self.name])
        return np.asarray(ds[self.name].values)

    def label(self, ds: "xr.Dataset") -> str:
        """Return the label of the values' axis."""
        return shown_label(self.observable, stored_system(ds.attrs))

    def notes(self, ds: "xr.Dataset") -> list[str]:
        """Return legend entries that count the orbits of which only the first values are stored."""
        if self.observable is None or self.observable.number not in ds:
            return []
        number, n_stored = ds[self.observable.number].values, ds[self.name].shape[-1]
        orbits = ds[REGIME.name].values == PERIODIC
        more, endless = (int(np.count_nonzero(orbits & mask)) for mask in (number > n_stored, number < 0))
        says = [f"{plural(more, 'orbit')} with more than\n{n_stored} values: the first of them"] if more else []
        says += [f"{plural(endless, 'orbit')} with endless values:\nat most the first {n_stored}"] if endless else []
        return says


def atlas_observables(ds: "xr.Dataset") -> tuple[Observable, ...]:
    """Return the observables that an atlas stores, from its spec."""
    system, observe = stored_system(ds.attrs), stored_spec(ds.attrs).get("solve", {}).get("observe", "")
    if system is None or not observe:
        return ()
    return tuple(observable for observable in observables_of(observe, system.definition) if observable.variable in ds)


def shown_label(observable: Observable | None, system: System | None) -> str:
    """Return the axis label of an observable, in two lines with its unit; of section values if it is None."""
    if observable is None:
        return text.gap_label(system)
    link = "at" if observable.kind.startswith("impact") else "of"
    first, _, second = observable.words.partition(f" {link} ")
    return (f"{first}\n{link} {second}" if second else first) + text.unit_ending(observable.unit)

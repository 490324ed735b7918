"""All attractors of one cell, found in this process from many initial states.

They are the result of ``attractors``, and the basis of stability measures and saddles.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

from atlas.query.attractors import attractors_solved
from atlas.robustness.norm import weights_of
from atlas.spec.attractors import cell_attractors, search_to_json
from atlas.spec.spec import given_settings, given_values, validate_parameters
from atlas.spec.system import parse_system
from workers import Settings
from workers.attractors.initial_states import AttractorSettings
from workers.model.system import DEFAULT, System

if TYPE_CHECKING:
    from workers.attractors.basins import AttractorTable
    from workers.model.oscillator import Array


@dataclass(frozen=True, eq=False)
class AttractorSearch:
    """A search for all attractors of one cell from many initial states; results are computed when first used.

    record      system of the cell
    parameters  value of each parameter
    settings    settings of the solver
    starts      settings of the search
    """

    record: System
    parameters: Mapping[str, float]
    settings: Settings
    starts: AttractorSettings

    @classmethod
    def from_arguments(
        cls,
        parameters: Mapping[str, Any],
        system: str | Mapping[str, Any] | System,
        settings: Settings | None,
        starts: int,
    ) -> Self:
        """Return the search for the arguments of ``attractors``.

        Raise InputError for an invalid argument, such as an unknown parameter.
        """
        record, settings = parse_system(system), given_settings(settings)
        return cls(record, validate_parameters(record, parameters), settings, cell_attractors(starts, record, settings))

    @property
    def described(self) -> dict[str, Any]:
        """System, parameters, settings and search in full, as plain JSON."""
        return search_to_json(self.record, self.parameters, self.settings, self.starts)

    def weights(self, norm: Mapping[str, float] | None) -> "Array":
        """Return the weights (2n,) of the components of the state in a norm of deviations.

        ``norm`` gives some of them by component; the others have their default values.
        """
        return weights_of(norm or {}, self.record, float(self.table.oscillators.period[0]))

    @cached_property
    def table(self) -> "AttractorTable":
        """The attractors found, that with the largest share of the initial states first."""
        from workers.attractors.basins import AttractorTable

        return AttractorTable(self.record, self.parameters, self.settings, self.starts)

    @cached_property
    def results(self) -> dict[str, Any]:
        """The results of the cell, with the list ``coexisting`` of the stored attractors and their results.

        If there are none, the regime and the reason are those of the cell's own initial state.
        """
        from workers.tile import result_arrays

        variables, size = self.record.variables(self.settings, attractors=True), len(self.record.states)
        arrays = result_arrays(variables, self.settings, 1, size, self.starts.keep, self.record.exponents)
        self.table.write(arrays)
        return attractors_solved({name: array[0] for name, array in arrays.items()}, variables)


def attractors(
    parameters: Mapping[str, Any] | None = None,
    /,
    *,
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    starts: int = AttractorSettings.count,
    **named: Any,
) -> dict[str, Any]:
    """Return all attractors that initial states of one cell reach, with the shares of initial states that reach them.

    The search is that of the table ``[attractors]`` in a spec. ``omega=4.0`` or a mapping gives parameters other than
    the defaults. ``starts`` initial states are solved: the cell's own, and others that fill a box evenly; only half of
    them if these all reach one attractor. The results are:

    attractors     number of attractors found
    starts         number of initial states solved
    own_attractor  index of the attractor that the cell's own initial state reaches
    undecided      number of undecided initial states
    unseen_share   share of an attractor that 5 % of such searches miss
    periods_used   forcing periods simulated for all initial states
    coexisting     list of the attractors with all their results, the largest share first
    regime         regime of the cell's own initial state, if ``coexisting`` is empty
    reason         reason of the cell's own initial state, likewise
    system         the system in full
    parameters     value of each parameter
    solve          settings of the solver
    search         settings of the search

    Raise InputError for a parameter that does not exist or is out of range, and for settings that find no attractors.

    >>> import atlas
    >>> found = atlas.attractors(omega=4.0, b=0.1, starts=8)
    >>> [(one["regime"], one["period"], one["share"]) for one in found["coexisting"]]
    [('periodic', 1, 0.625), ('periodic', 3, 0.375)]
    """
    search = AttractorSearch.from_arguments(given_values(parameters, named), system, settings, starts)
    return search.described | search.results

"""Retry: solve some cells of an atlas again, into a new store that takes over all other cells of the old store."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from atlas.argument_checks import check_name, is_integer, validate_type
from atlas.errors import InputError, check_names
from atlas.formatting import plural
from atlas.service.extend import handle_from, origin_for
from atlas.service.options import DEFAULTS, RunOptions, with_fields
from atlas.service.progress import Progress
from atlas.service.run import complete
from atlas.service.status import read_status
from atlas.service.store_call import store_call
from atlas.service.summary import RunSummary
from atlas.store.object_backend import Given
from atlas.store.origin import ALLOWANCES, BUDGET, SURVIVAL, BudgetVariable, RetryRequest
from atlas.store.store import AtlasStore
from workers.results import APERIODIC, CHAOTIC, REGIMES, UNDETERMINED
from workers.settings import MAX_PERIODS

if TYPE_CHECKING:
    from distributed import Client

_NEED = {UNDETERMINED: BUDGET, CHAOTIC: SURVIVAL, APERIODIC: SURVIVAL}
DECIDED_BY = {regime.name: _NEED[regime.code] for regime in REGIMES if regime.code in _NEED}
"""For each regime that a retry may change, the budget in periods to raise; cells of other regimes never change."""


@with_fields
def retry(
    store: Given,
    into: Given,
    regimes: str | Iterable[str],
    max_periods: int | None = None,
    survival: int | None = None,
    client: "Client | None" = None,
    options: RunOptions = DEFAULTS,
    **fields: Any,
) -> RunSummary:
    """Solve some cells of a complete atlas again, with more periods, into a new store that takes over all other cells.

    ``regimes`` are one or more of undetermined, chaotic and aperiodic. A larger budget ``max_periods`` may decide
    undetermined cells; a longer ``survival`` watches chaotic and aperiodic cells for longer. Each of these cells is
    solved from its beginning, and has the bits of an atlas whose spec has these settings. The variables ``budget`` and
    ``survival`` of the new store say how many periods each cell was given.

    All other cells are those of ``store`` to the bit. If both stores lie on one disk, or in one bucket, tiles without a
    cell to solve take no further space and no time on the network. ``store`` does not change, and must stay in place
    until the new store is complete. The same call resumes a retry that was stopped. ``client``, ``options`` and
    ``fields`` are those of ``run``. Raise InputError, before anything is written, for a retry that could change no
    cell; see also ``run``.

    >>> import atlas
    >>> summary = atlas.retry("plane.zarr", "again.zarr", "chaotic", survival=100_000, client=client)
    >>> summary.retried, atlas.status("again.zarr").fraction
    (True, 1.0)
    """
    with store_call(into, client, options, fields) as call:
        old = handle_from(store, call.options.storage_options)
        if old.spec.attractors is not None:
            raise InputError(
                f"{old.backend}: an atlas of all attractors cannot be retried: run it again with more periods"
            )
        if old.spec.continuation is not None:
            raise InputError(
                f"{old.backend}: a continued sweep cannot be retried: each cell depends on the cells before it"
            )
        names = regimes.split(",") if isinstance(regimes, str) else validate_type("regimes", regimes, Iterable, "names")
        request = validate_retry(old, tuple(names), max_periods, survival)
        origin = origin_for(call.backend, old, request)
        status = read_status(old)
        if status.fraction < 1:
            tiles_text = f"{status.tiles_done} of {plural(old.tiling.count, 'tile')}"
            raise InputError(f"{old.backend}: {tiles_text} done: complete it first, with the command that began it")
        count = sum(status.regimes.get(name, 0) for name in request.regimes)
        call.options.report(Progress(f"solving {count} of {plural(old.tiling.cells, 'cell')} of {old.backend} again"))
        return complete(old.spec.in_tiles(old.tile), call, origin)


def validate_retry(
    old: AtlasStore, regimes: tuple[str, ...], max_periods: int | None = None, survival: int | None = None
) -> RetryRequest:
    """Check a user's arguments of ``retry`` and return them as a request.

    Raise InputError if they are invalid, or if the retry could not change a cell of the old store.
    """
    for name in regimes:
        check_name("regimes", name)
    names = [name.strip() for name in regimes if name.strip()]
    check_names("regime to retry", names, DECIDED_BY)
    if not names:
        raise InputError(f"regimes: found no name, must be one or more of {', '.join(DECIDED_BY)}")
    request = RetryRequest(tuple(dict.fromkeys(names)), max_periods, survival)
    for allowance in ALLOWANCES:
        _check_amount(old, allowance, getattr(request, allowance.setting))
    for name in names:
        needs = DECIDED_BY[name]
        if not request.least_budget(needs):
            option, least = f"--{needs.setting.replace('_', '-')}", _least(old, needs)
            more = f"give {option} above {least}"
            raise InputError(f"retry: {name} cells come out the same within the same {needs.name}; {more}")
    for allowance in ALLOWANCES:
        if request.least_budget(allowance) and allowance not in {DECIDED_BY[name] for name in names}:
            decided = " or ".join(name for name, needs in DECIDED_BY.items() if needs is allowance)
            raise InputError(f"{allowance.setting}: is for {decided} cells, found {','.join(names)}")
    return request


def _check_amount(old: AtlasStore, allowance: BudgetVariable, amount: int | None) -> None:
    if amount is None:
        return
    least = _least(old, allowance)
    if old.spec.settings.method == "fixed":
        raise InputError(f'{allowance.setting}: a spec with method = "fixed" has no {allowance.name} to raise')
    if not is_integer(amount) or not least < amount <= MAX_PERIODS:
        bounds = f"must exceed the {least} that such cells were given and be at most {MAX_PERIODS}"
        raise InputError(f"{allowance.setting}: found {amount}, {bounds}")


def _least(old: AtlasStore, allowance: BudgetVariable) -> int:
    """Return the largest budget, in periods, that any cell of a store was given; a retry must exceed it."""
    retried = old.origin.retry if old.origin is not None else None
    return max(allowance.from_spec(old.spec), retried.least_budget(allowance) if retried is not None else 0)

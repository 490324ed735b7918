"""Find the curves of a finished two-parameter atlas on the workers, and write them into its store.

The search is a sequence of stages of jobs. Results of jobs are kept in the store as parts, so that a search resumes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from atlas.argument_checks import validate_type
from atlas.errors import ChunkError
from atlas.formatting import PrintableResult, duration, plural
from atlas.orbits.curves.job import CurveJob, read_part, run_and_store
from atlas.orbits.curves.plane import plane_of
from atlas.orbits.curves.search import CurveSearch
from atlas.orbits.curves.search_result import edge_share, finish_search
from atlas.orbits.curves.settings import CurveSettings
from atlas.orbits.curves.table import Curves, read_curves, write_curves
from atlas.service.options import DEFAULTS, RunOptions, with_fields
from atlas.service.part_run import PartCost, PartRun
from atlas.service.progress import Progress
from atlas.service.store_call import store_call
from atlas.store.groups import CURVES
from atlas.store.object_backend import Given
from atlas.store.parts import drop_parts, part_names
from atlas.store.store import AtlasStore
from atlas.task.compile import ORBITS, kernels_for

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True, repr=False)
class CurveSummary(PartCost, PrintableResult):
    """The curves of a store, and the cost of finding them.

    store   path or URL of the store
    curves  the curves
    """

    store: str
    curves: Curves

    def as_dict(self) -> dict[str, Any]:
        """Return the dict that ``atlas find curves --json`` prints."""
        report, kinds = self.curves.report, [curve.kind for curve in self.curves]
        edges: Mapping[str, Any] = report["edges"]
        return {
            "store": self.store,
            "curves": len(kinds),
            "kinds": {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)},
            **report,
            "explained": {name: edge_share(counts) for name, counts in edges.items()},
            "tasks": self.tasks,
            "seconds": self.seconds,
            "processor_seconds": self.processor_seconds,
            "workers": self.workers,
        }

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The curves, the borders that they explain, and the cost, as sentences."""
        facts = self.as_dict()
        kinds = ", ".join(f"{kind} {count}" for kind, count in facts["kinds"].items())
        lines = [f"{self.store}: {plural(len(self.curves), 'curve')}" + (f" ({kinds})" if kinds else "")]
        if self.tasks:
            busy = f"{duration(self.processor_seconds)} of processor time"
            lines.append(
                f"{facts['points']} points in {duration(self.seconds)} on {plural(self.workers, 'worker')}, {busy}"
            )
        least = facts["settings"]["min_cells"]
        names = {
            "regions": f"borders between regions of {least} cells or more",
            "small": f"borders of regions below {least} cells",
            "others": "borders to cells without a known orbit",
        }
        lines += [_edge_line(names[name], counts) for name, counts in facts["edges"].items() if counts["all"]]
        if facts["events_not_followed"]:
            lines.append(f"budget spent: {plural(facts['events_not_followed'], 'event')} not followed")
        lines += [_why_line(location) for location in facts["unexplained"]]
        lines += [f"{plural(count, 'place')}: {text}" for text, count in facts["troubles"].items()]
        return [(line,) for line in lines]


@with_fields
def find_curves(
    store: Given,
    settings: CurveSettings | None = None,
    client: "Client | None" = None,
    options: RunOptions = DEFAULTS,
    **fields: Any,
) -> CurveSummary:
    """Find the curves of a finished plane, and write them into its store.

    Return at once if the store has the curves for these settings. The search runs on ``client`` or on the workers of
    the options, like ``run``. The same call resumes a search that was stopped. Raise InputError if the store is not a
    finished plane; see also ``run``.
    """
    with store_call(store, client, options, fields) as call:
        handle = call.open()
        settings = CurveSettings() if settings is None else settings
        validate_type("settings", settings, CurveSettings, "an atlas.CurveSettings")
        search = CurveSearch(plane_of(handle), settings)
        digest = settings.digest(search.plane)
        stored = _stored(handle, digest)
        if stored is not None:
            return CurveSummary(str(handle.backend), stored)
        kernels = kernels_for(handle.spec.system_def, ORBITS)
        parts = PartRun(call, handle, run_and_store, kernels, {CURVES: digest})
        while tasks := search.tasks():
            jobs = [
                CurveJob((search.stage, k), name, task, settings, digest, parts.pool.store_ref)
                for k, (name, task) in enumerate(tasks.items())
            ]
            parts.run(jobs, partial(_progress, search))
            search.add_results([read_part(parts.handle, name) for name in tasks])
        curves = finish_search(search)
        write_curves(parts.handle, curves)
        return CurveSummary(str(handle.backend), curves, **vars(parts.end()))


def _stored(handle: AtlasStore, digest: str) -> Curves | None:
    """Return the stored curves if a search with this digest found them, else None."""
    try:
        stored = read_curves(handle)
    except ChunkError:
        return None  # the search runs again
    if stored is None or stored.report.get("digest") != digest:
        return None
    if not handle.backend.read_only_reason and any(part_names(handle, CURVES)):
        drop_parts(handle, CURVES)  # left by a run that was killed at its very end
    return stored


def _progress(search: CurveSearch) -> Progress:
    settled, edges = search.n_settled, len(search.edges)
    curves = f"{plural(len(search.curves), 'curve')}, {search.points} points"
    detail = f"{curves}, {settled} of {edges} edges settled"
    return Progress(search.doing, cells=edges, cells_done=settled, detail=detail)


def _why_line(unexplained: Mapping[str, Any]) -> str:
    where = ", ".join(f"{name} = {value:.6g}" for name, value in unexplained["at"].items())
    return f"unexplained: {plural(unexplained['edges'], 'edge')} of the border at {where}: {unexplained['why']}"


def _edge_line(name: str, counts: Mapping[str, int]) -> str:
    share = 100.0 * edge_share(dict(counts))
    parts = [f"by curves {counts['curve']}", f"as borders of basins {counts['basins']}"]
    left = [
        f"{text} {counts[key]}"
        for key, text in (("unexplained", "unexplained"), ("not_tried", "not tried"))
        if counts[key]
    ]
    return f"{name}: {plural(counts['all'], 'edge')}, {share:.1f} % explained: {', '.join(parts + left)}"

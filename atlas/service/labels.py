"""Label the attractors of a finished atlas, in this process, and write the labels into its store."""

import time
from dataclasses import asdict, dataclass
from typing import Any

from atlas.formatting import PrintableResult, duration, plural
from atlas.orbits.labels.table import LabelCounts, labels_of, stored_count, write_labels
from atlas.service.options import DEFAULTS, RunOptions, with_fields
from atlas.service.progress import Progress, prepare_kernels
from atlas.service.store_call import store_call
from atlas.spec.system import must_offer
from atlas.store.groups import check_table_size
from atlas.store.object_backend import Given
from atlas.store.zarr_backend import check_not_packed
from atlas.task.compile import ORBITS, kernels_for
from workers.results import LABEL


@dataclass(frozen=True, repr=False)
class LabelSummary(PrintableResult):
    """The counts of a store's labels, and the seconds spent on labelling; 0 if the store had labels already."""

    store: str
    count: LabelCounts
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return the dict that ``atlas attractors label --json`` prints."""
        return {"store": self.store, **asdict(self.count), "seconds": self.seconds}

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The counts of labels and attractors to show, as sentences."""
        count = self.count
        rest = count.attractors - count.followed
        lines = [f"{self.store}: {plural(count.branches, 'label')}, {count.alone} of them of one cell alone"]
        if rest:
            stuck = count.orbits - count.followed
            others = f"; {plural(stuck, 'orbit')} cannot be followed" if stuck else ""
            lines.append(f"{plural(count.followed, 'attractor')} labelled; {rest} not, chaos and tori{others}")
        if count.cut:
            lines.append(f"{plural(count.cut, 'link')} cut, which would put two attractors of a cell on one branch")
        if self.seconds:
            lines.append(f"{plural(count.links, 'link')} between cells in {duration(self.seconds)}")
        return [(line,) for line in lines]


@with_fields
def label_attractors(store: Given, options: RunOptions = DEFAULTS, **fields: Any) -> LabelSummary:
    """Label the attractors of a finished atlas, one label per branch from cell to cell, and store the labels.

    Return at once if the store has labels. Raise InputError if the store is not a finished atlas of all attractors.
    """
    with store_call(store, None, options, fields) as call:
        handle = call.open()
        stored = stored_count(handle)
        if stored is not None:
            return LabelSummary(str(handle.backend), stored)
        check_not_packed(handle.backend)
        must_offer(handle.spec.system_def, "labels")
        check_table_size(handle, [LABEL])
        begin = time.monotonic()
        call.acquire_lease()
        prepare_kernels(call.options.report, *kernels_for(handle.spec.system_def, ORBITS))
        call.options.report(Progress("following orbits from cell to cell"))
        labels = labels_of(handle)
        write_labels(handle.with_backend(call.backend), labels)
        return LabelSummary(str(handle.backend), labels.count, time.monotonic() - begin)

"""Actions of an explorer page: saving its picture as a file, the motion of a cell, and the spec of a new atlas."""

import tempfile
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

from atlas.cell.trajectory import CellTrajectory, cell_orbit
from atlas.explore.cell_lookup import CellResult
from atlas.explore.explorer import Explorer
from atlas.explore.subject import Subject
from atlas.explore.text import data_address
from atlas.explore.view_state import Ends, Range, ViewState
from atlas.explore.viewport import Viewport
from atlas.render import render
from atlas.service.plan import make_plan
from atlas.service.probe import probe
from atlas.spec.spec import Spec
from atlas.spec.toml_text import spec_toml

MEDIA = {"png": "image/png", "svg": "image/svg+xml", "pdf": "application/pdf"}


def picture_file(explorer: Explorer, view: ViewState, viewport: Viewport, suffix: str, limits: Ends) -> tuple[str, str]:
    """Return the picture of the visible cells as a file: its name, and its content as a data URL.

    explorer   the explorer that knows the cells
    view       the view state of the page, with the kind of map and the overlays
    viewport   the visible cells
    suffix     format of the file: png, svg or pdf
    limits     colour limits of the map
    """
    subject = explorer.subject
    ds = explorer.known.visible_cells(view.plane, viewport, view.names).ds
    look = replace(view, overlays=view.visible_overlays(subject)).figure_options(limits)
    name = f"{Path(subject.name).stem}-{view.kind}.{suffix}"
    with tempfile.TemporaryDirectory() as folder:
        path = render(ds, Path(folder) / name, view.kind, **look)
        return name, data_address(MEDIA[suffix], path.read_bytes())


def orbit_of(subject: Subject, cell: CellResult) -> CellTrajectory:
    """Return the motion of a cell, simulated with the settings with which the cell was solved.

    Raise InputError if the cell has no motion to show.
    """
    settings = subject.spec.settings if cell.of_atlas else subject.settings
    return cell_orbit(cell.parameters, subject.system, settings)


@dataclass(frozen=True)
class NewAtlasSpec:
    """The spec file of a new atlas, as written from an explorer page.

    file   path of the spec
    text   contents of the spec
    line   command that computes the atlas
    cost   estimated cost of the computation, as text
    """

    file: Path
    text: str
    line: str
    cost: str


def new_atlas(subject: Subject, view: ViewState, x: Range, y: Range, cells: int, folder: Path) -> NewAtlasSpec:
    """Write the spec of a window of the plane as a new file in a folder, and return it with its estimated cost.

    subject   the subject that is explored, whose system and settings the spec takes over
    view      the view state of the page, which gives the values of the fixed parameters
    x, y      limits (low, high) of the axes of the new atlas
    cells     number of cells along the horizontal axis
    folder    the folder of the new file

    If the subject's spec searches all attractors, the new spec does, too, from the same initial states. Raise OSError
    if the file cannot be written.
    """
    shape = (x[1] - x[0], y[1] - y[0]), (view.x[1] - view.x[0], view.y[1] - view.y[0])
    up = max(2, round(cells * (shape[0][1] / shape[1][1]) / (shape[0][0] / shape[1][0]) * 0.75))
    axes = {
        lattice.axis.name: {"start": low, "stop": high, "num": num, "scale": lattice.axis.scale}
        for lattice, (low, high), num in ((subject.x, x, cells), (subject.y, y, up))
    }
    parameters, settings = dict(view.plane.parameters), subject.spec.settings
    spec = Spec(subject.system, axes, parameters, settings, attractors=subject.attractors)
    text = spec_toml(spec)
    for number in count(1):
        file = folder / f"{Path(subject.name).stem}-{number}.toml"
        try:
            with file.open("x", encoding="utf-8") as opened:
                opened.write(text)
            break
        except FileExistsError:
            continue
    plan = make_plan(spec)
    plan = replace(plan, probe=probe(spec, plan.tiling.tile))
    return NewAtlasSpec(file, text, f"atlas run {file.name} -o {file.stem}.zarr", str(plan))

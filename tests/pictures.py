"""Atlases made by hand, and what tests read off the pictures of them."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import xarray as xr
from matplotlib import colors
from matplotlib.figure import Figure
from PIL import Image

from atlas.cell.trajectory import CellTrajectory
from atlas.orbits.curves.table import CodimTwoPoint, Curve, Curves
from atlas.render import style
from atlas.render.kinds import KIND_TABLE
from atlas.render.layers import MapLayers, MapView
from atlas.render.layout import STANDARD
from atlas.render.painters import PAINTERS
from atlas.render.request import PictureRequest
from atlas.store.schema import REGIME_COLORS
from workers import Settings
from workers.model.system import find_system
from workers.results import CHAOTIC, FAILED, INVALID, NO_IMPACT, PENDING, PERIODIC, QUASIPERIODIC, UNDETERMINED

TWO_MASS = find_system("two-mass")

NAN = float("nan")
EVERY = [PENDING, NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC, UNDETERMINED, INVALID, FAILED]
"""One cell of each regime, as in ``every_regime``."""


def atlas(axes: dict[str, Any], scales: dict[str, str] | None = None, **variables: Any) -> xr.Dataset:
    """An atlas with the coordinates and attributes of a store; variables are arrays (y, x, ...)."""
    dims = tuple(reversed(axes))
    coords: dict[str, Any] = {}
    for p in TWO_MASS.parameters:
        values = np.asarray(axes.get(p.name, p.default), dtype=float)
        coords[p.name] = ((p.name,) * values.ndim, values, {"long_name": p.meaning, "units": p.unit})
    extra = ("sample", "component")
    arrays = {name: np.asarray(values) for name, values in variables.items()}
    spec = {"system": "two-mass", "axes": [{"name": n, "scale": s} for n, s in (scales or {}).items()]}
    return xr.Dataset(
        {name: (dims + extra[: array.ndim - len(dims)], array) for name, array in arrays.items()},
        coords,
        {"digest": "d1ge57", "spec": json.dumps(spec), "software": "numpy 2"},
    )


def layers(kind: str, *scale: Any, **variables: np.ndarray) -> MapLayers:
    """The layers of a kind of map of variables (y, x), on the scale of others where that is given."""
    rows, columns = variables["regime"].shape
    ds = atlas({"omega": 1.0 + np.arange(columns), "b": 0.1 + 0.1 * np.arange(rows)}, **variables)
    found: MapLayers = PAINTERS[kind](MapView.read(KIND_TABLE[kind], ds, PictureRequest(STANDARD)), *scale)
    return found


def every_regime() -> xr.Dataset:
    largest = [[NAN, -0.3, -0.5, 0.0], [1.0, NAN, NAN, NAN]]
    return atlas(
        {"omega": [1, 2, 3, 4], "b": [0.1, 0.2]},
        regime=np.array(EVERY, np.int8).reshape(2, 4),
        largest=largest,
        period=np.array([[0, 1, 1, 0], [0, 0, 0, 0]], np.int32),
    )


def sweep(**variables: Any) -> xr.Dataset:
    return atlas({"omega": [2.0, 2.5, 3.0, 4.0]}, regime=np.array([3, 1, 1, 3], np.int8), **variables)


def section() -> np.ndarray:
    return np.broadcast_to(np.arange(3.0)[:, None] / 10, (4, 3, 4))


def colour(code: int) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in colors.to_rgba(REGIME_COLORS[code]))


def labels(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def pixel(path: Path, figure: Figure, x: float, y: float) -> tuple[int, ...]:
    """The colour of a written PNG at data coordinates of the first plot area."""
    with Image.open(path) as written:
        image = np.asarray(written.convert("RGB"))
    figure.savefig(path.with_suffix(".again.png"))  # lays the figure out, at its own resolution
    right, up = figure.axes[0].transData.transform((x, y)) / figure.dpi * style.DPI
    return tuple(int(part) for part in image[image.shape[0] - 1 - int(up), int(right)])


def plane() -> xr.Dataset:
    """9 x 6 cells that hold every variable of a map: bands of motions, and one cell of each regime."""
    ny, nx = 6, 9
    regime = np.full((ny, nx), PERIODIC, np.int8)
    regime[0, :8] = EVERY
    regime[3:, :3] = CHAOTIC
    regime[5, 6:] = NO_IMPACT
    periodic, chaotic = regime == PERIODIC, regime == CHAOTIC
    column = np.arange(nx)[None, :] + np.zeros((ny, 1), int)
    solved = periodic | chaotic | (regime == NO_IMPACT)
    period = np.where(periodic, 1 + column // 3, np.where(regime == NO_IMPACT, 1, 0))
    upper = np.where(periodic, period, 0)
    lower = np.where(periodic, period + (column == 4), 0)
    upper[2, 8] = lower[2, 8] = -1
    stuck = np.where(solved, 0.0, NAN)
    stuck[2, 8] = 0.25
    return atlas(
        {"omega": np.linspace(1, 5, nx), "b": np.linspace(0.1, 0.6, ny)},
        regime=regime,
        largest=np.where(chaotic, 0.2 + 0.1 * column, np.where(solved, -0.1 * (1 + column), NAN)),
        error=np.where(chaotic, 1e-2, np.where(solved, 1e-14 * (1 + column), NAN)),
        period=period.astype(np.int32),
        impacts_upper=upper.astype(np.int32),
        impacts_lower=lower.astype(np.int32),
        periods_used=np.where(chaotic, 5000, np.where(regime == NO_IMPACT, 0, np.where(solved, 40, 20000))).astype(
            np.int32
        ),
        stuck_fraction=stuck,
        attractors=np.where(solved, 1 + column % 7, 0).astype(np.int32),
        share=np.where(solved, 1.0 / (1 + column % 7), NAN),
        symmetric=periodic & (upper == lower),
        return_time=np.where(solved, 1.0 + column, NAN),
        reactivity=np.where(solved, 0.1 * column, NAN),
        amplification=np.where(solved, 2.0 + column, NAN),
        fatal_shock=np.where(solved, 1e-3 * (1 + column), NAN),
        margin=np.where(solved, 0.05 * (1 + column), NAN),
    )


def line(direction: str | None = None, jump: int = 4) -> xr.Dataset:
    """A sweep of 8 cells that jumps from one motion to another at cell ``jump``."""
    n = 8
    after = np.arange(n) >= jump
    section = np.where(after[:, None, None], 0.1, -0.05) + np.zeros((n, 3, 4))
    largest = np.where(after, -0.2, -0.4)
    ds = atlas(
        {"omega": np.linspace(2, 4, n)},
        {"omega": "linear"},
        regime=np.full(n, PERIODIC, np.int8),
        period=np.full(n, 1, np.int32),
        largest=largest,
        error=np.full(n, 1e-12),
        section=section,
    )
    ds["spectrum"] = (("omega", "exponent"), np.stack([largest - 0.1 * i for i in range(4)], axis=-1))
    spec = json.loads(ds.attrs["spec"])
    if direction:
        spec["axes"][0]["continuation"] = direction
    return ds.assign_attrs(spec=json.dumps(spec), digest=f"d1ge57-{direction}")


def branches() -> xr.Dataset:
    """A sweep of 8 cells beside each of which a second attractor lies, but for the last ones."""
    one = line()
    second = one.copy(deep=True)
    second["regime"][6:], second["section"][:] = PENDING, 0.02
    second["section"][6:] = NAN
    share = np.array([0.5, 0.6, 0.7, 0.8, 0.9, 0.9, 1.0, 1.0])
    other = np.where(share < 1.0, 1.0 - share, NAN)
    for ds, values in ((one, share), (second, other)):
        for name, away in (("share", 0.0), ("share_low", -0.1), ("share_high", 0.1)):
            ds[name] = ("omega", np.clip(values + away, 0.0, 1.0))
    made = xr.concat([one, second], "attractor", coords="minimal", compat="override", join="override")
    return made.transpose("omega", "attractor", ...)


def basin() -> tuple[xr.Dataset, xr.Dataset]:
    """A plane of 8 x 6 initial states, and the table of the four attractors that they reach."""
    labels = np.tile(np.array([0, 0, 1, 1, 2, 3, 3, -1]), (6, 1))
    regime = np.where(labels == 2, NO_IMPACT, np.where(labels < 0, UNDETERMINED, PERIODIC)).astype(np.int8)
    settled = np.where(labels >= 0, 10 + 5 * np.arange(6)[:, None], 0)
    ds = atlas(
        {"x1": np.linspace(-0.1, 0.1, 8), "v1": np.linspace(-1, 1, 6)}, regime=regime, label=labels, settled=settled
    )
    points = np.full((4, 3, 4), NAN)
    points[:, 0] = 0.02 * np.arange(4)[:, None] * np.array([1.0, 0.0, 5.0, 0.0])
    table = xr.Dataset(
        {
            "regime": ("attractor", np.array([PERIODIC, PERIODIC, NO_IMPACT, PERIODIC], np.int8)),
            "period": ("attractor", np.array([1, 3, 1, 3], np.int32)),
            "share": ("attractor", np.array([0.25, 0.25, 0.125, 0.25])),
            "mirror": ("attractor", np.array([0, 3, 2, 1], np.int32)),
            "points": (("attractor", "point", "component"), points),
        },
        {"component": ["x1", "x2", "v1", "v2"]},
    )
    return ds, table


def labelled() -> tuple[xr.Dataset, xr.Dataset]:
    """A plane of 8 x 6 cells on twenty branches, some of them twins, and on none; and the table of these."""
    column = np.tile(np.arange(8), (6, 1))
    label = np.where(column == 7, -1, (column + 2 * np.arange(6)[:, None]) % 20)
    regime = np.where(label < 0, CHAOTIC, np.where(label == 4, NO_IMPACT, PERIODIC)).astype(np.int8)
    ds = atlas(
        {"omega": np.linspace(2, 4, 8), "b": np.linspace(0.1, 0.6, 6)},
        regime=regime,
        label=label,
        share=np.full(label.shape, 0.5),
    )
    number = np.arange(20)
    table = {
        "regime": np.where(number == 4, NO_IMPACT, PERIODIC).astype(np.int8),
        "period": 1 + number % 3,
        "impacts_upper": 1 + number % 5,
        "impacts_lower": 1 + number % 2,
        "mirror": np.where(number < 4, number ^ 1, number),
    }
    return ds, xr.Dataset({name: ("branch", values) for name, values in table.items()})


def orbit() -> CellTrajectory:
    """A made-up periodic orbit of one impact at the upper stop: no solver is behind it."""
    parameters = {p.name: p.default for p in TWO_MASS.parameters}
    phase = np.linspace(0.0, 2 * np.pi, 201)
    states = np.stack([0.15 * np.cos(phase), 0.05 * np.sin(phase), -0.15 * np.sin(phase), 0.05 * np.cos(phase)], axis=1)
    exact = np.array([-0.2, -0.3, -0.5, -np.inf])
    settled = 1.0 + 1.0 / np.arange(1, 101)[:, None]
    return CellTrajectory(
        system=TWO_MASS,
        parameters=parameters,
        settings=Settings(exponents="spectrum"),
        cell={
            "regime": PERIODIC,
            "period": 1,
            "impacts_upper": 1,
            "impacts_lower": 0,
            "impacts_per_period": 1.0,
            "symmetric": False,
            "sticks": False,
            "stuck_fraction": 0.0,
            "largest": -0.2,
            "error": 1e-14,
            "spectrum": exact,
        },
        period=np.pi / 2,
        stops=(-0.15, 0.15),
        times=phase / 4,
        states=states,
        impacts=np.array([[0.0, 1.0, 0.4]]),
        section=states[:1],
        running=exact * settled,
    )


def curve(kind: str, points: Any, unstable: Any = 0, corners: tuple[CodimTwoPoint, ...] = (), **orbit: Any) -> Curve:
    """A curve of the 1-1-1 orbit, or of another; ``unstable`` along all of it or point by point."""
    at = np.asarray(points, dtype=float)
    own: dict[str, Any] = {"period": 1, "impacts_upper": 1, "impacts_lower": 1, "symmetric": False} | orbit
    own |= {name: np.broadcast_to(own[name], len(at)) for name in ("impacts_upper", "impacts_lower")}
    return Curve(kind, points=at, unstable=np.broadcast_to(unstable, len(at)), ends=("edge", "edge"), corners=corners,
                 **own)  # fmt: skip


def curves() -> Curves:
    """Three curves over ``plane``, that of the doubling with a part where its orbit is otherwise unstable."""
    x = np.linspace(1.0, 5.0, 41)
    corner = CodimTwoPoint("graze_period_doubling", 3.0, 0.37, 20)
    return Curves(
        ("omega", "b"),
        (
            curve("fold", np.column_stack([x, 0.2 + 0.02 * x])),
            curve("period_doubling", np.column_stack([x, 0.31 + 0.02 * x]), np.where(x > 3.0, 1, 0), (corner,)),
            curve("graze", np.column_stack([x, 0.58 - 0.07 * x]), np.where(x < 3.0, 1, 0), (corner,)),
        ),
    )


@contextmanager
def keeping(found: Curves) -> Iterator[None]:
    """Every atlas, made by hand too, keeps these curves."""
    with patch("atlas.orbits.curves.queries.curves_of", return_value=found):
        yield

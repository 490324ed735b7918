"""How well a probe foretells the processor time of a run: measured over foretold, for examples on coarse planes.

    python -m scripts.bench_probe [--every 6] [NAME ...]

Each example is probed as `atlas plan` does, then solved with every sixth value along each axis, in one process; both
count the seconds of their own threads. On a loaded machine, where threads share a processor, they count more.
"""

import argparse
import tempfile
from pathlib import Path

from distributed import Client

import atlas
from atlas.service.plan import make_plan
from atlas.service.probe import probe

NAMES = ("omega-b", "omega-b-fine", "single-mass", "bouncing-ball")


def coarse(name: str, every: int) -> atlas.Spec:
    """The example over the same window, with fewer values along each axis."""
    spec = atlas.Spec.from_toml(name)
    axes = {axis.name: list(axis.values[::every]) for axis in spec.axes}
    return atlas.Spec(spec.system, axes, spec.parameters, spec.settings)


def main() -> None:
    """Print a line for each example."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    parser.add_argument("--every", type=int, default=6)
    asked = parser.parse_args()
    print(f"{'example':15s}{'cells':>7s}{'probed':>8s}{'periods':>9s}{'seconds':>9s}   (measured over foretold)")
    with Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
        for name in asked.names:
            spec = coarse(name, asked.every)
            found = probe(spec, make_plan(spec, workers=1).tiling.tile)
            with tempfile.TemporaryDirectory() as folder:
                done = atlas.run(spec, Path(folder) / "out.zarr", client=client)
            cells = done.cells_solved
            periods = done.periods / (found.periods_per_cell * cells)
            seconds = done.processor_seconds / (found.seconds_per_cell * cells)
            print(f"{name:15s}{cells:7d}{found.cells:8d}{periods:9.2f}{seconds:9.2f}")


if __name__ == "__main__":
    main()

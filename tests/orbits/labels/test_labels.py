"""Claims about labels: which attractors of neighbouring cells have one, how branches are cut, what a store keeps."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from distributed import Client
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import atlas
from atlas import render
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.orbits.labels.attractor_orbits import AttractorOrbitTable, attractors_of
from atlas.orbits.labels.components import branches
from atlas.orbits.labels.links import AttractorOrbits, OrbitLinks, find_links
from atlas.orbits.labels.table import labels_of, mirror_labels
from atlas.service.labels import label_attractors
from atlas.store.store import open_store
from workers.continuation import branch, family_of, orbit_from_state, section_state
from workers.model.system import find_system
from workers.results import NO_IMPACT, PERIODIC

pytestmark = pytest.mark.slow

OMEGA = np.linspace(3.475, 3.85, 6)
"""Across the break of symmetry, at b = 0.1: a pair of twins below omega = 3.71, one symmetric orbit above."""


def spec_of(**changes: object) -> atlas.Spec:
    given = {
        "axes": {"omega": {"values": OMEGA.tolist()}, "b": {"values": [0.1, 0.104]}},
        "solve": {"exponents": "none", "max_periods": 2000, "survival": 2000, "section_samples": 3},
        "attractors": {"starts": 8},
        "store": {"tile": [2, 3]},
    }
    return atlas.Spec("two-mass", **(given | changes))


@pytest.fixture(scope="module")
def unlabelled(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    return solved_once(spec_of())


@pytest.fixture(scope="module")
def labelled(unlabelled: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = Path(shutil.copytree(unlabelled, tmp_path_factory.mktemp("labelled") / "out.zarr"))
    label_attractors(path)
    return path


# Components

NO_IMAGES = np.full(200, -1)


def test_links_without_conflict_make_the_connected_components() -> None:
    """Truth: scipy's components of a random graph whose vertices are all in cells of their own."""
    rng = np.random.default_rng(3)
    pairs = rng.integers(0, 200, (150, 2))
    found, cut = branches(200, pairs, rng.random(150), np.arange(200), NO_IMAGES)
    _, expected = connected_components(coo_array((np.ones(150), pairs.T), shape=(200, 200)), directed=False)
    assert cut == 0
    assert len({*zip(found.tolist(), expected.tolist(), strict=True)}) == found.max() + 1 == expected.max() + 1


def test_two_attractors_of_a_cell_are_never_on_one_branch() -> None:
    rng = np.random.default_rng(4)
    cell, pairs = rng.integers(0, 60, 200), rng.integers(0, 200, (400, 2))
    found, cut = branches(200, pairs, rng.random(400), cell, NO_IMAGES)
    assert cut > 0
    assert len({*zip(found.tolist(), cell.tolist(), strict=True)}) == 200


def test_a_chain_between_two_attractors_of_a_cell_is_cut_where_the_orbit_changes_most() -> None:
    """A ring of cells 0 to 4 around a cusp: attractors 0 and 5 are the two sheets in cell 0."""
    pairs = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5]])
    change, cell = np.array([0.1, 0.2, 0.9, 0.3, 0.1]), np.array([0, 1, 2, 3, 4, 0])
    found, cut = branches(6, pairs, change, cell, NO_IMAGES[:6])
    assert (found.tolist(), cut) == ([0, 0, 0, 1, 1, 1], 1)


def random_links(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Of 60 pairs of twins and 30 symmetric orbits: their mirror images and cells; 90 links with their changes."""
    image = np.concatenate([np.arange(120).reshape(60, 2)[:, ::-1].ravel(), np.arange(120, 150)])
    cell = np.empty(150, dtype=np.int64)
    cell[:120], cell[120:] = np.repeat(rng.integers(0, 25, 60), 2), rng.integers(0, 25, 30)
    return image, cell, rng.integers(0, 150, (90, 2)), rng.random(90)


@pytest.mark.parametrize("seed", range(20))
def test_the_mirror_image_of_a_branch_is_a_branch(seed: int) -> None:
    """Random links with their mirror images, of equal change and in any order, between twins and symmetric orbits."""
    rng = np.random.default_rng(seed)
    image, cell, pairs, change = random_links(rng)
    order = rng.permutation(180)
    both = np.concatenate([pairs, image[pairs]])[order]
    found, cut = branches(150, both, np.tile(change, 2)[order], cell, image)
    assert cut > 0 and len({*zip(found.tolist(), cell.tolist(), strict=True)}) == 150
    assert len({*zip(found.tolist(), found[image].tolist(), strict=True)}) == found.max() + 1


@pytest.mark.parametrize("seed", range(20))
def test_whose_mirror_image_a_branch_is_is_mutual(seed: int) -> None:
    """As above, with orbits that have no label, and images that no cell has."""
    rng = np.random.default_rng(seed)
    image, cell, pairs, change = random_links(rng)
    found, _ = branches(150, np.concatenate([pairs, image[pairs]]), np.tile(change, 2), cell, image)
    order = np.concatenate([np.arange(0, 120, 2), np.arange(120, 150), np.arange(1, 120, 2)])  # the last are unseen
    branch, image = found[order], np.argsort(order)[image[order]]
    seen = np.where(rng.random(110) < 0.8, branch[:110], -1)
    number = np.where(seen >= 0, np.unique(seen, return_inverse=True)[1] - 1, -1)
    mirror = mirror_labels(number, branch, image)
    with_image = np.flatnonzero(mirror >= 0)
    assert len(mirror) == number.max() + 1 and len(with_image) > 10 and np.any(mirror == -1)
    assert mirror[mirror[with_image]].tolist() == with_image.tolist()


# Labels


def test_a_label_follows_its_branch_as_continuation_in_arclength_does(labelled: Path) -> None:
    """Truth: ``branch`` from the first cell; its orbit at the last cell of the label is that cell's."""
    ds = atlas.open(labelled).isel(b=0)
    system, twins = find_system("two-mass"), [int(k) for k in ds["label"][0].values if k >= 0]
    family = family_of(system, {"b": 0.1}, ("omega",))
    followed_far = 0
    for k in twins:
        cells, places = np.nonzero(ds["label"].values == k)
        if int(ds["regime"][cells[0], places[0]]) != PERIODIC:
            continue
        state = ds["state"].values[cells[0], places[0]]
        orbit = orbit_from_state(system, {"omega": OMEGA[cells[0]], "b": 0.1}, state, 1)
        run = branch(family, orbit, OMEGA[cells[0]], (OMEGA[0], OMEGA[cells[-1]]))
        end = next(point for point in run.points[::-1] if point.values[0] == pytest.approx(OMEGA[cells[-1]]))
        there = section_state(system, {"omega": float(end.values[0]), "b": 0.1}, end.orbit)
        assert there == pytest.approx(ds["state"].values[cells[-1], places[-1]], abs=1e-8)
        followed_far += len(cells) > 2
    assert followed_far == 2


def test_twins_have_labels_of_their_own_that_mirror_each_other_and_the_symmetric_orbit_another(labelled: Path) -> None:
    ds, table = atlas.open(labelled), xr.open_zarr(labelled, group="labels")
    below, above = ds.isel(omega=0, b=0), ds.isel(omega=-1, b=0)
    orbits = below["label"].values[(below["regime"] == PERIODIC).values & ~below["symmetric"].values]
    (symmetric,) = above["label"].values[(above["regime"] == PERIODIC).values & above["symmetric"].values]
    assert len(orbits) == 2 and symmetric not in orbits
    assert table["mirror"].values[orbits].tolist() == orbits[::-1].tolist()
    assert table["mirror"].values[symmetric] == symmetric
    assert table["symmetric"].values[[symmetric, *orbits]].tolist() == [True, False, False]


def test_a_label_is_once_in_a_cell_and_counts_its_cells(labelled: Path) -> None:
    ds, table = atlas.open(labelled), xr.open_zarr(labelled, group="labels")
    labels = ds["label"].values.reshape(-1, ds.sizes["attractor"])
    for row in labels:
        assert len({*row[row >= 0]}) == (row >= 0).sum()
    assert np.bincount(labels[labels >= 0]).tolist() == table["cells"].values.tolist()
    assert np.all(np.diff(table["total_share"].values) <= 0)


def test_motion_without_impact_is_one_branch(labelled: Path) -> None:
    ds = atlas.open(labelled)
    found = ds["label"].values[ds["regime"].values == NO_IMPACT]
    assert len({*found.tolist()}) <= 1 and np.all(found >= 0)


def test_labels_do_not_depend_on_which_way_an_axis_is_gone_through(unlabelled: Path) -> None:
    every, _ = attractors_of(open_store(unlabelled))
    links = find_links(every)
    turned, _ = branches(len(links.cell), links.pairs[::-1, ::-1], links.change[::-1], links.cell, links.image)
    there, _ = branches(len(links.cell), links.pairs, links.change, links.cell, links.image)
    assert np.array_equal(turned, there)


def equivariant(links: OrbitLinks) -> bool:
    """Whether all links between orbits with mirror images are links between these too."""
    pairs = {*map(tuple, np.sort(links.pairs, axis=1).tolist())}
    images = links.image[links.pairs]
    return {*map(tuple, np.sort(images[(images >= 0).all(axis=1)], axis=1).tolist())} <= pairs


def test_twins_are_linked_alike_where_newtons_method_finds_the_link_of_one_of_them_alone(
    unlabelled: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    every, _ = attractors_of(open_store(unlabelled))
    rng, reach = np.random.default_rng(5), AttractorOrbits.follow_pairs

    def unsure(self: AttractorOrbits, pairs: np.ndarray, away: int) -> tuple[np.ndarray, np.ndarray]:
        reached, change = reach(self, pairs, away)
        return reached & (rng.random(len(pairs)) < 0.7), change

    monkeypatch.setattr(AttractorOrbits, "follow_pairs", unsure)
    links = find_links(every)
    assert len(links.pairs) > 10 and equivariant(links)


def test_an_orbit_is_linked_through_cells_that_saw_its_twin_alone(unlabelled: Path) -> None:
    """Each second cell along omega has lost one twin: the lone twin's links and their mirror images join the others."""
    every, _ = attractors_of(open_store(unlabelled))
    twins = (every.twin >= 0) & (every.twin != np.arange(len(every)))
    lost = twins & (every.twin < np.arange(len(every))) & (every.cell % 2 == 1)
    assert lost.any()
    links, whole = find_links(kept(every, ~lost)), find_links(every)
    assert equivariant(links)
    full, _ = branches(len(whole.cell), whole.pairs, whole.change, whole.cell, whole.image)
    fewer, _ = branches(len(links.cell), links.pairs, links.change, links.cell, links.image)
    alike = {*zip(full[: len(every)][~lost].tolist(), fewer[: np.sum(~lost)].tolist(), strict=True)}
    assert len(alike) == len({a for a, _ in alike}) == len({b for _, b in alike})


def test_mirror_images_of_linked_orbits_are_linked(tmp_path: Path, client: Client) -> None:
    """Cells of the line of 300 in docs/attractors.md: in each pair Newton's method finds one link of two."""
    omega = np.linspace(2.0, 4.5, 300)[[87, 88, 126, 127, 230, 231]].tolist()
    solve = {"section_samples": 48, "tolerance": 0.05, "survival": 4000}
    given = {"axes": {"omega": {"values": omega}}, "parameters": {"b": 0.1}, "solve": solve}
    atlas.run(atlas.Spec("two-mass", **given, attractors={"starts": 24}), tmp_path / "out.zarr", client=client)
    every, _ = attractors_of(open_store(tmp_path / "out.zarr"))
    assert equivariant(find_links(every))
    mirror = labels_of(open_store(tmp_path / "out.zarr")).mirror
    known = mirror >= 0
    assert np.array_equal(mirror[mirror[known]], np.flatnonzero(known))


def kept(every: AttractorOrbitTable, rows: np.ndarray) -> AttractorOrbitTable:
    """Some of the orbits of an atlas, as if the others had not been found."""
    names = ("cell", "rank", "regime", "period", "impacts_upper", "impacts_lower", "symmetric", "state", "share")
    place = np.where(rows, np.cumsum(rows) - 1, -1)
    twin = np.where(every.twin[rows] >= 0, place[every.twin[rows]], -1)
    return replace(every, twin=twin, **{name: getattr(every, name)[rows] for name in names})


def test_orbits_that_some_cells_have_missed_break_no_branch(unlabelled: Path) -> None:
    every, _ = attractors_of(open_store(unlabelled))
    found = every.points[every.cell, 1] != OMEGA[1]
    fewer = kept(every, found)
    links = find_links(fewer)
    branch_of = branches(len(links.cell), links.pairs, links.change, links.cell, links.image)[0][: len(fewer)]
    omega = fewer.points[fewer.cell, 1]
    before, after = ({*branch_of[(omega == OMEGA[k]) & (fewer.period == 1)].tolist()} for k in (0, 2))
    assert len(before) >= 2 and before == after


def test_chaos_has_no_label(tmp_path: Path, client: Client) -> None:
    spec = spec_of(axes={"omega": {"values": [1.409, 1.4095]}, "b": {"values": [0.267]}}, store=None)
    atlas.run(spec, tmp_path / "out.zarr", client=client)
    found = labels_of(open_store(tmp_path / "out.zarr"))
    assert np.all(found.values == -1) and found.count.attractors > 0


def test_orbits_that_rest_on_a_stop_have_labels(tmp_path: Path, client: Client) -> None:
    spec = spec_of(axes={"omega": {"values": [3.0, 3.05]}}, parameters={"R": 0.0, "b": 0.1}, store=None)
    atlas.run(spec, tmp_path / "out.zarr", client=client)
    assert np.all(atlas.open(tmp_path / "out.zarr")["sticks"].isel(attractor=0))
    found = labels_of(open_store(tmp_path / "out.zarr"))
    assert found.count.followed == found.count.orbits and found.count.branches == 1


# What a store keeps


def test_plain_xarray_reads_labels_with_their_axes(labelled: Path) -> None:
    table = xr.open_zarr(labelled, group="labels")
    assert table["label"].dims == ("b", "omega", "attractor")
    assert table["omega"].values == pytest.approx(OMEGA)
    assert "label" not in xr.open_zarr(labelled)


def test_labels_are_found_once(labelled: Path) -> None:
    before = (labelled / "labels" / "zarr.json").read_bytes()
    again = label_attractors(labelled)
    assert again.seconds == 0.0 and again.count.branches > 2
    assert (labelled / "labels" / "zarr.json").read_bytes() == before


def test_labels_without_their_last_object_are_absent_and_made_again(labelled: Path, tmp_path: Path) -> None:
    path = Path(shutil.copytree(labelled, tmp_path / "out.zarr"))
    (path / "labels" / "zarr.json").unlink()
    assert "label" not in atlas.open(path)
    assert label_attractors(path).seconds > 0.0
    assert atlas.open(path)["label"].equals(atlas.open(labelled)["label"])


def test_a_labelled_store_is_sound_and_its_results_are_as_before(labelled: Path, unlabelled: Path) -> None:
    assert atlas.verify(labelled, sample=0).is_sound
    assert xr.open_zarr(labelled).identical(xr.open_zarr(unlabelled))


def test_labels_are_asked_exported_and_packed_with_the_cells(labelled: Path, tmp_path: Path) -> None:
    ds = atlas.open(labelled)
    cell = ds.atlas.at(omega=3.475, b=0.1)
    assert int(cell["label"][0]) == int(ds["label"][0, 0, 0])
    asked = CliRunner().invoke(main, ["export", str(labelled), "-o", str(tmp_path / "cells.csv")])
    assert asked.exit_code == 0, asked.output
    assert {"label_1", "label_2"} <= set((tmp_path / "cells.csv").read_text().splitlines()[0].split(","))
    atlas.pack(labelled, tmp_path / "out.zip")
    assert atlas.open(tmp_path / "out.zip")["label"].equals(ds["label"])


def test_the_command_labels_and_counts(unlabelled: Path, tmp_path: Path) -> None:
    path = Path(shutil.copytree(unlabelled, tmp_path / "out.zarr"))
    told = CliRunner().invoke(main, ["attractors", "label", str(path)])
    assert told.exit_code == 0 and "labels, " in told.stdout and "links between cells" in told.stdout
    count = json.loads(CliRunner().invoke(main, ["attractors", "label", str(path), "--json"]).stdout)
    assert count["cut"] == 0 and count["followed"] == count["orbits"]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"attractors": None}, "found one attractor per cell; labels need an atlas of all"),
        ({}, "4 tiles unfinished; complete the store with atlas run"),
    ],
)
def test_what_cannot_be_labelled_is_refused_in_one_line(tmp_path: Path, changes: dict[str, object], says: str) -> None:
    from atlas.store.create import create_store

    store = create_store(tmp_path / "out.zarr", spec_of(**changes), (1, 3)).path
    told = CliRunner().invoke(main, ["attractors", "label", str(store)])
    assert told.exit_code == 2 and says in told.output
    assert not (store / "labels").exists()


# Pictures


def test_maps_and_diagrams_name_the_branches_in_view(labelled: Path) -> None:
    ds = atlas.open(labelled)
    for figure in (render.figure(ds, "labels"), render.figure(ds.isel(b=0), "coexistence")):
        names = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
        assert any(name.endswith("1-1-1") for name in names)
        assert any(", mirrors " in name for name in names)


def test_a_branch_keeps_its_colour_in_every_window(labelled: Path) -> None:
    ds = atlas.open(labelled)

    def colors(window: dict[str, tuple[float, float]] | None) -> dict[str, object]:
        (legend,) = render.figure(ds, "labels", window=window).legends
        names = [text.get_text() for text in legend.get_texts()]
        return dict(zip(names, [patch.get_facecolor() for patch in legend.get_patches()], strict=True))

    whole, part = colors(None), colors({"omega": (3.7, 3.9)})
    assert part.items() <= whole.items() and len(part) < len(whole)


def test_an_atlas_without_labels_says_how_to_get_them(unlabelled: Path) -> None:
    with pytest.raises(InputError, match="label its attractors by atlas attractors label"):
        render.figure(atlas.open(unlabelled), "labels")

"""Other axes and layers of a machine that is explored: what is chosen in the page, as its address holds it."""

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import parse_qs

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.errors import InputError
from atlas.explore.explorer import MAX_OTHER_EXPLORERS, Explorer
from atlas.explore.subject import Subject, subject_of
from atlas.explore.view_state import carry_over, explorer_for_query, from_address
from atlas.explore.viewport import TileKey
from tests.explore.messages import to_address
from tests.explore.test_solving import exploring, waited
from workers.results import PENDING, REGIME


@pytest.fixture
def explorer(client: Client) -> Iterator[Explorer]:
    with exploring("omega-b", client) as made:
        yield made


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    store = tmp_path_factory.mktemp("stack") / "stack.zarr"
    axes = {"omega": [3.5, 3.7, 3.9], "b": [0.3, 0.4, 0.5], "zeta": [0.02, 0.05]}
    atlas.run(atlas.Spec("two-mass", axes, solve={"tolerance": 0.1}), store, client=client)
    return store


def arguments(query: str) -> dict[str, list[bytes]]:
    return {name: [text.encode() for text in texts] for name, texts in parse_qs(query).items()}


def test_an_address_restores_axes_parameters_window_cell_and_cut(explorer: Explorer) -> None:
    query = "axes=R,x2&R=0.5:0.75&x2=-0.25:0.25&kind=period&omega=2.5&b=0.25&cell=0.6,0.1&cut=0.5,0.0,0.75,0.1"
    turned = explorer_for_query(explorer, arguments(query))
    chosen = from_address(turned.subject, arguments(query))
    again = to_address(explorer.subject, turned.subject, chosen)
    assert turned.subject.axes == ("R", "x2")
    assert from_address(explorer_for_query(explorer, arguments(again)).subject, arguments(again)) == chosen
    assert chosen.cell == (chosen.plane, 0.6, 0.1) and chosen.cut == (0.5, 0.0, 0.75, 0.1)
    assert dict(chosen.plane.parameters)["omega"] == 2.5


def test_what_was_chosen_goes_along_to_other_axes(explorer: Explorer) -> None:
    home = explorer.subject
    chosen = from_address(home, arguments("omega=2.0:3.0&b=0.2:0.3&kind=scalar&variable=period&R=0.7"))
    turned = explorer.explorer_for_axes(("R", "zeta")).subject
    values = dict(zip(home.axes, chosen.middle(home), strict=True)) | dict(chosen.plane.parameters)
    there = carry_over(turned, chosen, values)
    assert (there.kind, there.variable) == ("scalar", "period")
    assert dict(there.plane.parameters)["omega"] == 2.5 and "R" not in dict(there.plane.parameters)


def test_cells_over_other_axes_are_those_of_the_point_command_to_the_bit(explorer: Explorer) -> None:
    turned = explorer.explorer_for_axes(("R", "b"))
    subject, plane = turned.subject, turned.subject.plane.with_value("omega", 3.9)
    sight = subject.viewport((0.7, 0.8), (0.45, 0.55), (20, 20))
    turned.request_tiles("test", plane, sight, range(3, -1, -1))
    assert waited(lambda: turned.patches.n_remaining("test") == 0)
    assert not np.any(turned.known.visible_cells(plane, sight, []).ds[REGIME.name].values == PENDING)
    cell = turned.known.cell(plane, sight, 0.75, 0.5)
    assert cell is not None and cell.parameters["omega"] == 3.9
    alone = atlas.point(cell.parameters, system=subject.system, settings=subject.settings)
    assert (alone["largest"], alone["state"]) == (cell.results["largest"], alone["state"])
    assert alone["peak_to_peak"] == cell.results["peak_to_peak"]


def test_the_link_to_other_axes_is_admitted_also_from_a_view_whose_middle_is_out_of_range(explorer: Explorer) -> None:
    home = explorer.subject
    chosen = from_address(home, arguments("omega=2.0:3.0&b=-0.4:0.2"))  # a gap has to be positive
    turned = explorer.explorer_for_axes(("omega", "R")).subject
    values = dict(zip(home.axes, chosen.middle(home), strict=True)) | dict(chosen.plane.parameters)
    there = carry_over(turned, chosen, values)
    assert from_address(turned, arguments(to_address(home, turned, there))) == there
    assert dict(there.plane.parameters)["b"] == dict(turned.plane.parameters)["b"] > 0


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("axes=R,R", "axes: found R twice, must be two parameters"),
        ("axes=R", "axes: found 'R', must be two parameters, ACROSS,UP"),
        ("axes=R,zeto", "unknown axis 'zeto'; did you mean 'zeta'"),
        ("layer=0.1", "layer: found 0.1; possible: none"),
    ],
)
def test_axes_and_layers_that_there_are_not_are_refused(explorer: Explorer, query: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        explorer_for_query(explorer, arguments(query))


def test_another_layer_of_a_stack_has_its_own_cells_of_the_store(stack: Path) -> None:
    first = subject_of(str(stack))
    second = first.with_axes(first.axes, 0.05)
    assert (first.layer_value, second.layer_value) == (0.02, 0.05)
    assert dict(second.plane.parameters)["zeta"] == 0.05
    assert second.ds is not None and float(second.ds["zeta"]) == 0.05
    assert second.with_axes(second.axes, 0.02).plane == first.plane


def test_a_layer_has_one_explorer_whether_it_is_named_or_not(stack: Path, client: Client) -> None:
    with exploring(stack, client) as explorer:
        assert (
            explorer.explorer_for_axes(("omega", "b"), 0.02) is explorer.explorer_for_axes(("omega", "b")) is explorer
        )
        assert explorer.explorer_for_axes(("R", "b"), 0.02) is explorer.explorer_for_axes(("R", "b"))
        assert explorer.explorer_for_axes(("R", "b"), 0.05) is not explorer.explorer_for_axes(("R", "b"))


def test_axes_that_no_page_shows_are_forgotten(explorer: Explorer) -> None:
    shown = explorer.explorer_for_axes(("R", "b"))
    shown.subscribe("page", lambda *_: None)
    names = [p.name for p in explorer.subject.system.parameters if p.name not in ("omega", "b", "R")]
    names = names[: MAX_OTHER_EXPLORERS + 1]
    others = [explorer.explorer_for_axes((name, "b")) for name in names]
    assert explorer.explorer_for_axes(("R", "b")) is shown
    assert len(explorer._others) == MAX_OTHER_EXPLORERS
    assert explorer.explorer_for_axes((names[-1], "b")) is others[-1]
    assert explorer.explorer_for_axes((names[0], "b")) is not others[0]


def test_all_axes_and_layers_of_a_server_share_one_memory_and_leave_it_when_they_are_forgotten(
    explorer: Explorer,
) -> None:
    turned, memory = explorer.explorer_for_axes(("b", "omega")), explorer.tiles.memory
    key, arrays = TileKey(0, 0, 0, 0), {"regime": np.zeros((4, 4), np.int8)}
    for page in (explorer, turned):
        memory.put(page.tiles, page.subject.plane, key, arrays)
    assert turned.tiles.memory is memory and memory.bytes == 32
    turned.tiles.drop()
    assert memory.bytes == 16 and explorer.tiles.tiles_of_plane(explorer.subject.plane) != []


def test_a_subject_over_its_own_axes_is_itself() -> None:
    subject: Subject = subject_of("omega-b")
    assert subject.with_axes(subject.axes) is subject

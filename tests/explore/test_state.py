"""The state of the live page, in the browser's module: what a change ends, and the address that holds it."""

from typing import Any

import pytest

from atlas.explore.live.page import described
from atlas.explore.subject import subject_of
from atlas.explore.view_state import from_address
from tests.explore.modules import run
from tests.explore.test_axes import arguments

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")

MODULES = """
const { addressOf, chosen, escaped, isInPlane, middleOf } = await import("/live/state.mjs")
const { lookOf } = await import("/front/look.mjs"), subject = given
const state = { ...subject.view, box: null, ...lookOf(new URLSearchParams(subject.look)) }
"""
QUERY = (
    "R=0.7&omega=2.5:2.75&b=0.2:0.21&kind=scalar&variable=peak_to_peak&log=1&overlay=grazing,boundaries&vmin=0.1"
    "&without=fold,graze&cell=2.6,0.205&cell.R=0.75&cut=2.5,0.2,2.75,0.21&follow.orbit=omega,2.0,3.0,-7,2.5123456789"
)


def state_of(browser: Any, script: str, query: str = QUERY) -> Any:
    """What a script of a page at an address returns, of its ``state`` and ``subject``."""
    subject = subject_of("omega-b")
    view = from_address(subject, arguments(query))
    return run(browser, MODULES + script, described(subject, subject, view))


def test_the_address_that_the_page_writes_is_that_of_its_state(browser: Any) -> None:
    subject = subject_of("omega-b")
    written = state_of(browser, "return addressOf(subject, state)")
    assert from_address(subject, arguments(written)) == from_address(subject, arguments(QUERY))


def test_another_cell_ends_following_and_escape_ends_it_before_a_cut(browser: Any) -> None:
    script = """
        const moved = chosen(state, { x: [2, 3] }), once = escaped(state), twice = escaped(once)
        const other = chosen(state, { cell: { at: [2.7, 0.2], parameters: state.parameters } })
        return [moved.follow === state.follow, once.follow, Boolean(once.cut), twice.cut, other.follow]
    """
    assert state_of(browser, script) == [True, None, True, None, None]


def test_a_box_is_forgotten_with_the_view_in_which_it_was_chosen(browser: Any) -> None:
    script = """
        const box = [[2.5, 2.75], [0.25, 0.375]], boxed = chosen(state, { box })
        return [{ map: "period" }, { x: [2, 3] }, { parameters: { ...state.parameters, R: 0.8 } }].map(
            (change) => chosen(boxed, change).box)
    """
    assert state_of(browser, script) == [[[2.5, 2.75], [0.25, 0.375]], None, None]


def test_a_cell_is_marked_in_its_own_plane_alone(browser: Any) -> None:
    script = """
        const back = chosen(state, { parameters: { ...state.parameters, R: 0.75 } })
        const axes = [{ to: (v) => v, from: (v) => v }, { to: (v) => v, from: (v) => v }]
        return [isInPlane(state), isInPlane(back), middleOf(state, axes), middleOf(back, axes)]
    """
    here, there, middle, cell = state_of(browser, script)
    assert (here, there, cell) == (False, True, [2.6, 0.205])
    assert middle == pytest.approx([2.625, 0.205])

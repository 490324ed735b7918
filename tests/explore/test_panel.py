"""A panel shows answers about what it is about now: what is asked, found or refused about anything else is dropped."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from atlas.explore.background import Show
from atlas.explore.jobs import Computation, ComputationJob
from atlas.explore.panel import Panel


class Letters(Panel[str]):
    """A panel on a letter, which notes what it shows."""

    def __init__(self) -> None:
        self.shown, self.wanted, self.works = (
            list[str](),
            list[ComputationJob](),
            list[tuple[Callable[[], Show], Any]](),
        )

        def want(who: object, jobs: list[ComputationJob], keep_earlier: bool = False) -> None:
            self.wanted = [*jobs, *(self.wanted if keep_earlier else ())]

        explorer: Any = SimpleNamespace(subject=None, patches=SimpleNamespace(request=want))
        background: Any = SimpleNamespace(deferred_call=lambda act: act, run=lambda *given: self.works.append(given))
        super().__init__(explorer, background, lambda what, **fields: None)

    def start(self, about: str) -> None:
        self.shown.append(f"begin {about}")
        self.submit([Computation(str.upper, about)], self.shown.append)

    def clear(self) -> None:
        self.shown.append("clear")

    def show_error(self, why: str) -> None:
        self.shown.append(why)

    def answer(self, errand: ComputationJob) -> None:
        """Have the workers answer."""
        (function, value), take = errand.build_task()
        take(function(value))


@pytest.fixture
def panel() -> Letters:
    made = Letters()
    made.set_topic("a")
    return made


def test_an_answer_is_shown_while_the_panel_is_about_the_same(panel: Letters) -> None:
    panel.set_topic("a")
    panel.answer(panel.wanted[0])
    assert panel.shown == ["begin a", "A"]


def test_answers_and_refusals_about_something_else_are_dropped(panel: Letters) -> None:
    (first,) = panel.wanted
    panel.set_topic("b")
    panel.answer(first)
    first.refuse("no a")
    panel.wanted[0].refuse("no b")
    assert panel.shown == ["begin a", "begin b", "no b"]


def test_an_answer_to_a_question_before_last_about_the_same_is_dropped_too(panel: Letters) -> None:
    (first,) = panel.wanted
    panel.set_topic(None)
    panel.set_topic("a")
    panel.answer(first)
    assert panel.shown == ["begin a", "clear", "begin a"]


def test_what_was_asked_about_something_else_is_wanted_no_more(panel: Letters) -> None:
    panel.set_topic("b")
    assert [errand.question.argument for errand in panel.wanted] == ["b"]
    panel.set_topic(None)
    assert panel.wanted == [] and panel.topic is None


def test_what_is_asked_later_comes_before_what_was_asked_already(panel: Letters) -> None:
    panel.submit([Computation(str.upper, "later")], panel.shown.append)
    assert [errand.question.argument for errand in panel.wanted] == ["later", "a"]


def test_work_on_something_else_is_neither_begun_nor_shown(panel: Letters) -> None:
    begun, soon = list[str](), panel.progress_callback()

    def work() -> Show:
        begun.append("work")
        return lambda: panel.shown.append("found")

    panel.run_in_background(work)
    panel.run_in_background(work)
    (first, refuse), (second, _) = panel.works
    first()()
    shown = first()
    soon(lambda: panel.shown.append("soon"))
    panel.set_topic("b")
    shown()
    soon(lambda: panel.shown.append("too late"))
    second()()
    refuse("no a")
    assert begun == ["work", "work"] and panel.shown == ["begin a", "found", "soon", "begin b"]

"""Work on the last of many things that were asked for, as of cells under a pointer that moves."""

from collections.abc import Callable

import pytest

from atlas.explore.background import Latest, Show


class Held:
    """A background that works when it is told to."""

    def __init__(self) -> None:
        self.waiting: list[Callable[[], Show]] = []

    def run(self, work: Callable[[], Show]) -> None:
        self.waiting.append(work)

    def work(self) -> None:
        self.waiting.pop(0)()()

    def show(self, act: Show) -> None:
        act()


def test_what_is_asked_for_meanwhile_is_passed_over_but_for_the_last() -> None:
    held, done = Held(), list[int]()

    def work(thing: int) -> Show:
        for each in (2, 3, 4) if thing == 1 else ():
            latest.ask(each)
        return lambda: done.append(thing)

    latest = Latest[int](held, work)  # type: ignore[arg-type]
    latest.ask(1)
    held.work()
    held.work()
    assert done == [1, 4] and not held.waiting


def test_work_that_fails_does_not_keep_the_next_from_being_done() -> None:
    held, done = Held(), list[int]()

    def work(thing: int) -> Show:
        if thing == 1:
            latest.ask(2)
            raise OSError("gone")
        return lambda: done.append(thing)

    latest = Latest[int](held, work)  # type: ignore[arg-type]
    latest.ask(1)
    with pytest.raises(OSError, match="gone"):
        held.work()
    held.work()
    assert done == [2] and not held.waiting

"""Pictures that several threads draw at once, as the explorer and its user in a notebook do."""

import threading
from collections.abc import Callable
from functools import partial
from io import BytesIO
from typing import Any

import matplotlib as mpl

from atlas import render
from tests.pictures import every_regime

ROUNDS = 6
SIZE = (160, 120)


def draw_at_once(*works: Callable[[], Any]) -> tuple[list[Exception], list[list[Any]]]:
    """What goes wrong while each work is done ROUNDS times in a thread of its own, and what each time makes."""
    errors, made, begin = list[Exception](), [list[Any]() for _ in works], threading.Barrier(len(works))

    def run(work: Callable[[], Any], found: list[Any]) -> None:
        begin.wait()
        for _ in range(ROUNDS):
            try:
                found.append(work())
            except Exception as error:
                errors.append(error)

    threads = [threading.Thread(target=run, args=pair) for pair in zip(works, made, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return errors, made


def test_threads_that_draw_at_once_make_the_pictures_of_one_alone_and_change_no_setting() -> None:
    ds = every_regime()

    def file(kind: str, width: str) -> bytes:
        data = BytesIO()
        render.figure(ds, kind, width=width, dpi=60).savefig(data, format="png", metadata={"Software": None})
        return data.getvalue()

    one, other = partial(file, "exponent", "60mm"), partial(file, "period", "85mm")
    expected, before = (one(), other()), dict(mpl.rcParams)
    errors, (ones, others, _) = draw_at_once(one, other, one)
    assert errors == []
    assert {name: value for name, value in mpl.rcParams.items() if value != before[name]} == {}
    assert all(one == expected[0] for one in ones)
    assert all(other == expected[1] for other in others)


def test_what_another_thread_sets_of_other_settings_while_something_is_drawn_stays() -> None:
    from atlas.render.style import drawing_context, rc_params

    assert "lines.markersize" not in rc_params(1.0)
    before = mpl.rcParams["lines.markersize"], mpl.rcParams["font.size"]
    try:
        with drawing_context(rc_params(2.0)):
            mpl.rcParams["lines.markersize"] = 11.0
        assert (mpl.rcParams["lines.markersize"], mpl.rcParams["font.size"]) == (11.0, before[1])
    finally:
        mpl.rcParams["lines.markersize"] = before[0]

"""Numbers in words, as messages and tables show them."""

import pytest

from atlas.formatting import byte_size, duration, motion_name, plural


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.42, "0.4 s"), (9.94, "9.9 s"), (10.0, "10 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (200.0, "3 min 20 s"),
        (3599.0, "59 min 59 s"), (3600.0, "1 h 0 min"), (18659.0, "5 h 10 min"),
    ],
)  # fmt: skip
def test_a_duration_is_said_in_the_two_largest_units(seconds: float, words: str) -> None:
    assert duration(seconds) == words


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (12, "12 B"),
        (999, "999 B"),
        (1000, "1 kB"),
        (3400, "3.4 kB"),
        (1.2e9, "1.2 GB"),
        (5e12, "5 TB"),
        (2e15, "2e+03 TB"),
    ],
)
def test_bytes_have_the_unit_that_leaves_at_most_three_digits_before_the_point(count: float, words: str) -> None:
    assert byte_size(int(count)) == words


def test_a_count_of_one_has_a_noun_in_the_singular() -> None:
    assert [plural(n, "tile") for n in (0, 1, 2)] == ["0 tiles", "1 tile", "2 tiles"]
    assert plural(2, "axis", "axes") == "2 axes"


def test_a_motion_is_named_by_its_periods_and_its_impacts_above_and_below() -> None:
    assert motion_name(3, 2, 10) == "3-2-10"

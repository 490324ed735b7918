"""Laws in segments, measured: the truth of the script is right, and so is its table. No time is asserted."""

import pytest

from scripts import check_laws


def test_errors_of_states_are_about_h_squared_and_the_smooth_laws_have_the_published_digits() -> None:
    """characteristics.md C1 and C2: DOP853 to 1e-10."""
    rows = check_laws.converge(light=True)
    smooth = {row[0]: (float(row[2]), float(row[3])) for row in rows if row[1] == "smooth"}
    spring, contact, _ = smooth.values()
    assert spring == pytest.approx((0.51111817718927, -0.61043629), abs=2e-8)
    assert contact == pytest.approx((0.87217559443, 0.1773429), abs=1e-7)
    assert all(0.05 < abs(float(row[4])) < 0.2 for row in rows if row[1] != "smooth")


@pytest.mark.slow
def test_the_light_mode_measures_one_segment_and_eight() -> None:
    (one, _, _, ratio, *_), (eight, events, *_) = check_laws.cost(light=True)
    assert (one, ratio, eight) == ("1", "1.00", "8")
    assert int(events) > 2

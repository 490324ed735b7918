"""Laws in segments, measured: the truth of the script is right, and so are its tables. No time is asserted."""

import pytest

from tests.script import script

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rows() -> list[list[str]]:
    """The cells of both tables, the heads among them."""
    return [line.strip("| ").split(" | ") for line in script("check_laws", "--light").splitlines() if "---" not in line]


def test_errors_of_states_are_about_h_squared_and_the_smooth_laws_have_the_published_digits(
    rows: list[list[str]],
) -> None:
    """The smooth machines by DOP853 to 1e-10."""
    smooth = [(float(row[2]), float(row[3].rstrip(" |"))) for row in rows if row[1] == "smooth"]
    assert smooth[0] == pytest.approx((0.51111817718927, -0.61043629), abs=2e-8)
    assert smooth[1] == pytest.approx((0.87217559443, 0.1773429), abs=1e-7)
    segments = [row for row in rows if len(row) > 4 and row[1].replace(".", "").isdigit() and row[0][:1].isalpha()]
    assert segments
    assert all(0.05 < abs(float(row[4])) < 0.2 for row in segments if "h^2" not in row[4])


def test_the_light_mode_measures_one_segment_and_eight(rows: list[list[str]]) -> None:
    one, eight = [row for row in rows if row[0] in ("1", "8")]
    assert one[3] == "1.00"
    assert int(eight[1]) > 2

"""Results kept for the next call with the same bits."""

import numpy as np

from workers.model.memoize import MAX_ARGUMENT_BYTES, memoize_arrays


def test_a_result_is_worked_out_once_for_the_same_bits_and_again_for_others() -> None:
    """Zero of either sign is equal, but has other bits."""
    asked = []

    @memoize_arrays
    def halved(values: np.ndarray, shares: np.ndarray) -> np.ndarray:
        asked.append(values.copy())
        return values * shares

    share = np.full(3, 0.5)
    for values in ([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], [-0.0, 1.0, 2.0]):
        found = halved(np.array(values), share)
        assert np.array_equal(np.signbit(found), np.signbit(np.array(values)))
        assert found.tolist() == [0.0, 0.5, 1.0]
    assert len(asked) == 2


def test_arrays_of_other_shapes_with_the_same_bits_are_others() -> None:
    @memoize_arrays
    def shape_of(values: np.ndarray) -> np.ndarray:
        return np.array(values.shape)

    assert [shape_of(np.zeros(shape)).tolist() for shape in ((2, 3), (3, 2), (0, 2))] == [[2, 3], [3, 2], [0, 2]]


def test_the_results_of_many_machines_are_not_kept() -> None:
    asked = []

    @memoize_arrays
    def counted(values: np.ndarray) -> np.ndarray:
        asked.append(len(values))
        return values

    many = np.zeros(MAX_ARGUMENT_BYTES // 8 + 1)
    for _ in range(2):
        counted(many)
        counted(many[:-1])
    assert asked == [len(many), len(many) - 1, len(many)]

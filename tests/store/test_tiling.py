import numpy as np
import pytest

from atlas.store.tiling import Tiling, chunk_index


@pytest.mark.parametrize("tile", [(1, 1), (2, 3), (5, 7)])
def test_tiles_cover_every_cell_once(tile: tuple[int, int]) -> None:
    tiling = Tiling((5, 7), tile)
    hits = np.zeros(tiling.shape, dtype=int)
    for piece in tiling.tiles():
        hits[piece.slices] += 1
    assert (hits == 1).all()
    assert len(list(tiling.tiles())) == tiling.count
    assert tiling.cells == 35


@pytest.mark.parametrize(("shape", "tile"), [((5, 7), (2, 3)), ((9,), (4,)), ((4, 4), (2, 2))])
def test_the_sizes_of_all_tiles_are_those_of_each(shape: tuple[int, ...], tile: tuple[int, ...]) -> None:
    tiling = Tiling(shape, tile)
    sizes = tiling.sizes()
    assert sizes.shape == tiling.grid
    assert {tile.index: tile.size for tile in tiling.tiles()} == {i: sizes[i] for i in np.ndindex(sizes.shape)}


@pytest.mark.parametrize("name", ["03/1", "3", "3/1/0", "4/0", "3/-1", "3/1.partial", "٣/1", ""])
def test_a_name_that_is_no_chunk_of_the_grid_has_no_index(name: str) -> None:
    assert chunk_index(name, (4, 2)) is None


def test_the_name_of_a_chunk_is_its_index() -> None:
    assert chunk_index("3/1", (4, 2)) == (3, 1)

import numpy as np
import pytest

from atlas.store.tiling import Tiling, chunk_mask


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


@pytest.mark.parametrize("name", ["03/1", "3", "3/1/0", "4/0", "3/-1", "3/1.partial", "٣/1", "", "/3/1"])
def test_a_key_that_is_no_chunk_of_the_grid_has_no_place(name: str) -> None:
    assert not chunk_mask([f"regime/c/{name}"], "regime/c", (4, 2)).any()


@pytest.mark.parametrize("index", [(3, 1), (0, 0), (5,), (1, 0, 2)])
def test_the_key_of_a_chunk_ends_with_its_index(index: tuple[int, ...]) -> None:
    grid = tuple(i + 2 for i in index)
    mask = chunk_mask([f"regime/c/{'/'.join(map(str, index))}"], "regime/c", grid)
    assert np.argwhere(mask).tolist() == [list(index)]

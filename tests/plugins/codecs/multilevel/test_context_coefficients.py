"""The model of blocks: whatever the indices, they come back, in slices that know nothing of each other."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.plugins.codecs.dct.tables import FLAT
from codecbench.plugins.codecs.multilevel.arithmetic import LOOK_AHEAD, UNWRITTEN
from codecbench.plugins.codecs.multilevel.context.binary import POSITION, finish, new_coder, start_decoding
from codecbench.plugins.codecs.multilevel.context.coefficients import (
    BAD_INDEX,
    MAX_BLOCK_BYTES,
    TRUNCATED,
    code_blocks,
)
from codecbench.plugins.codecs.multilevel.context.contexts import INNER, MAX_INDEX, new_statistics
from codecbench.plugins.codecs.multilevel.context.outer import predictors

COLUMNS = 5
EDGES, DC = predictors(FLAT, True)


def indices_of(spread: float, blocks: int, seed: int) -> np.ndarray:
    """Laplacian indices, smaller at high frequencies, and the row of zeros for what is outside."""
    rng = np.random.default_rng(seed)
    falling = 1 / (1 + np.add.outer(np.arange(8), np.arange(8)).reshape(64))
    indices = np.zeros((blocks + 1, 64), np.int32)
    indices[:-1] = np.clip(np.rint(rng.laplace(0, spread * falling, (blocks, 64))), -MAX_INDEX, MAX_INDEX)
    return indices


def coded(indices: np.ndarray, first: int, count: int, mixing: bool = True) -> bytes:
    data = np.empty(count * MAX_BLOCK_BYTES + 64, np.uint8)
    coder = new_coder(mixing, len(data) - MAX_BLOCK_BYTES)
    assert code_blocks(coder, data, *new_statistics(False), indices, first, count, COLUMNS, EDGES, DC) == 0
    return data[: finish(coder, data)].tobytes()


def decode(payload: bytes, into: np.ndarray, first: int, count: int, mixing: bool = True) -> tuple[int, int]:
    data = np.frombuffer(bytearray(payload), np.uint8)
    coder = new_coder(mixing, len(data) + LOOK_AHEAD)
    start_decoding(coder, data)
    result = code_blocks(coder, data, *new_statistics(False), into, first, count, COLUMNS, EDGES, DC)
    return result, int(coder[POSITION])


@pytest.mark.parametrize("mixing", [True, False])
@pytest.mark.parametrize("spread", [0, 0.1, 1, 8, 300, 1e5])
def test_indices_come_back(spread: float, mixing: bool) -> None:
    indices = indices_of(spread, 30, 4)
    payload = coded(indices, 0, 30, mixing)
    back = np.zeros_like(indices)
    assert decode(payload, back, 0, 30, mixing) == (0, len(payload) + UNWRITTEN)
    assert np.array_equal(back, indices)


def test_a_slice_depends_on_nothing_outside() -> None:
    indices = indices_of(6, 30, 1)
    payload = coded(indices, 10, 15)
    other = indices_of(9, 30, 2)
    other[10:25] = indices[10:25]
    assert coded(other, 10, 15) == payload
    back = np.zeros_like(indices)
    assert decode(payload, back, 10, 15)[0] == 0
    assert np.array_equal(back[10:25], indices[10:25])
    assert not back[:10].any()
    assert not back[25:].any()


def test_blocks_like_their_neighbours_cost_less() -> None:
    alike, unlike = indices_of(6, 40, 3), indices_of(6, 40, 3)
    alike[:-1] = alike[0]
    assert len(coded(alike, 0, 40)) < 0.75 * len(coded(unlike, 0, 40))


def test_damage_ends_in_a_reason_or_in_bounds() -> None:
    payload = coded(indices_of(30, 30, 5), 0, 30)
    rng = np.random.default_rng(0)
    results = set()
    for _ in range(300):
        damaged = bytearray(payload[: rng.integers(1, len(payload) + 1)])
        damaged[rng.integers(len(damaged))] ^= 1 << rng.integers(8)
        back = np.zeros((31, 64), np.int32)
        results.add(decode(bytes(damaged), back, 0, 30)[0])
        assert np.abs(back).max() <= MAX_INDEX
    assert results <= {0, TRUNCATED, BAD_INDEX}
    assert TRUNCATED in results


def test_an_index_that_no_encoder_has_is_refused() -> None:
    assert decode(bytes(5000), np.zeros((31, 64), np.int32), 0, 30)[0] == BAD_INDEX


def test_the_inner_places() -> None:
    assert sorted(INNER.tolist()) == [8 * v + u for v in range(1, 8) for u in range(1, 8)]
    assert INNER[:3].tolist() == [9, 17, 10] or INNER[:3].tolist() == [9, 10, 17]

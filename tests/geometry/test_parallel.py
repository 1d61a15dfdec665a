"""Blocks come back in their order, whatever thread worked on them."""

import time

import numpy as np
import pytest

from solver_backend.geometry.parallel import map_blocks


def test_results_keep_the_order_of_the_blocks():
    def late(block: int) -> int:
        time.sleep(0.002 * (5 - block))
        return block * block

    assert map_blocks(late, range(5), np.zeros(1)) == [0, 1, 4, 9, 16]


def test_an_error_in_a_block_is_the_callers():
    with pytest.raises(ZeroDivisionError):
        map_blocks(lambda block: 1 / block, [1, 0], np.zeros(1))

"""Threads that share a kernel: shares, and meetings."""

import numpy as np
import pytest
import taichi as ti

from tipfem.device import Buffers, init, members, settings, spread
from tipfem.teamwork import MEETING, meet, share


@pytest.fixture(scope="module", autouse=True)
def _runtime():
    init()


@ti.kernel
def sum_ahead(
    values: ti.types.ndarray(), meeting: ti.types.ndarray(), n: ti.i32, rounds: ti.i32, team: ti.i32,
    spread: ti.template(),
):  # fmt: skip
    """Every round, each value becomes the sum of two of the round before: wrong if a member runs ahead."""
    for t in range(team * spread):
        if t % spread == 0:
            first, last = share(t // spread, team, n)
            for k in range(rounds):
                old, new = k % 2 * n, (k + 1) % 2 * n
                for i in range(first, last):
                    values[new + i] = (values[old + i] + values[old + (i + n // 2) % n]) % 1000003
                meet(meeting, team)


@ti.kernel
def shares(bounds: ti.types.ndarray(), n: ti.i32, team: ti.i32):
    for t in range(team):
        first, last = share(t, team, n)
        bounds[2 * t] = first
        bounds[2 * t + 1] = last


def test_nobody_runs_ahead():
    buffers, n, rounds = Buffers(), 37, 20_001
    start = np.arange(1, n + 1)
    expected = start.copy()
    for _ in range(rounds):
        expected = (expected + np.roll(expected, -(n // 2))) % 1000003
    for team in {1, members()}:
        values = buffers.upload("values", np.concatenate([start, start]))
        meeting = buffers.upload("meeting", np.zeros(MEETING, dtype=np.int32))
        for k in (rounds - 1, 1):  # a team meets again where it has met before
            buffers.launch(sum_ahead, values, meeting, n, k, team, spread(team == 1))
        np.testing.assert_array_equal(np.asarray(values.to_numpy())[n : 2 * n], expected)


@pytest.mark.parametrize("n", [0, 1, 2, 5, 16, 1000])
@pytest.mark.parametrize("team", [1, 2, 3, 16])
def test_shares_cover_all_once(n, team):
    bounds = np.zeros(2 * team, dtype=np.int32)
    Buffers().launch(shares, bounds, n, team)
    done = np.concatenate([np.arange(first, last) for first, last in bounds.reshape(-1, 2)])
    np.testing.assert_array_equal(done, np.arange(n))


def test_a_team_is_no_larger_than_the_threads_there_are():
    assert members(True) == 1
    assert 1 <= members() <= (settings()["threads"] or 1_000_000)

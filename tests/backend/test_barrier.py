"""Threads that share a kernel: shares, and meetings."""

import os
import subprocess
import sys

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import barrier, runtime
from tipfem.backend.barrier import MEETING, Team, meet, share
from tipfem.backend.runtime import Buffers, init, spread, threads


@pytest.fixture(scope="module", autouse=True)
def _runtime():
    init()


@ti.kernel
def sum_ahead(
    values: ti.types.ndarray(),
    meeting: ti.types.ndarray(),
    n: ti.i32,
    rounds: ti.i32,
    team: ti.i32,
    spread: ti.template(),
):
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
    for many in {1, min(threads(), 16)}:
        values = buffers.upload("values", np.concatenate([start, start]))
        meeting = buffers.upload("meeting", np.zeros(MEETING, dtype=np.int32))
        for k in (rounds - 1, 1):  # a team meets again where it has met before
            buffers.launch(sum_ahead, values, meeting, n, k, many, spread(many == 1))
        np.testing.assert_array_equal(np.asarray(values.to_numpy())[n : 2 * n], expected)


@pytest.mark.parametrize("n", [0, 1, 2, 5, 16, 1000])
@pytest.mark.parametrize("team", [1, 2, 3, 16])
def test_shares_cover_all_once(n, team):
    bounds = np.zeros(2 * team, dtype=np.int32)
    Buffers().launch(shares, bounds, n, team)
    done = np.concatenate([np.arange(first, last) for first, last in bounds.reshape(-1, 2)])
    np.testing.assert_array_equal(done, np.arange(n))


def test_a_team_is_one_thread_while_others_want_the_processor(monkeypatch):
    """Kernels of 4 ms on a clock of our own, whose threads run for a part of the time."""
    now, ran, part, sizes = [100.0], [0.0], [1.0], []
    monkeypatch.setattr(barrier.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(barrier.time, "process_time", lambda: ran[0])
    monkeypatch.setattr(barrier, "threads", lambda: 2)
    crew = Team()

    def launch(_kernel, number, members, spread, alone, dim):
        assert (number, dim, spread) == (7, 2, runtime.spread(alone))
        now[0] += 0.004
        ran[0] += 0.004 * members * part[0]
        sizes.append(members)

    def launches(count, single=False):
        sizes.clear()
        for _ in range(count):
            crew.launch(launch, None, (7,), single, 2)
        return sizes

    assert launches(10) == [2] * 10
    assert launches(2, single=True) == [1, 1]
    part[0] = 0.9 * Team.RUNNING
    assert 1 in launches(10)
    part[0] = 1.0
    assert launches(int(0.8 * Team.REST / 0.004)) == [1] * int(0.8 * Team.REST / 0.004)
    now[0] += 0.3 * Team.REST
    assert launches(10) == [2] * 10


def test_a_team_has_no_more_members_than_taichi_has_threads(monkeypatch):
    """Whatever the environment says: a team of more would wait for ever."""
    code = (
        "import tipfem as tp; from tipfem.backend.runtime import threads; tp.init(threads={}); "
        "from taichi.lang import impl; print(threads(), impl.current_cfg().cpu_max_num_threads)"
    )
    monkeypatch.setenv("TI_CPU_MAX_NUM_THREADS", "1")
    cores = len(os.sched_getaffinity(0))
    for wanted in (None, cores):
        out = subprocess.run([sys.executable, "-c", code.format(wanted)], capture_output=True, text=True, check=True)
        assert len(set(out.stdout.split()[-2:])) == 1
    monkeypatch.delenv("TI_CPU_MAX_NUM_THREADS")
    out = subprocess.run([sys.executable, "-c", code.format(cores)], capture_output=True, text=True, check=True)
    assert out.stdout.split()[-2:] == [str(cores)] * 2

"""Threads that share a kernel: their shares, and the barrier at which they wait for each other."""

import itertools
import os
import subprocess
import sys

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import barrier as barriers
from tipfem.backend import launch as launches
from tipfem.backend.array_types import Ints1, Template
from tipfem.backend.barrier import Sharing, share, synchronise
from tipfem.backend.launch import kernel, launch
from tipfem.backend.runtime import init, threads


@pytest.fixture(scope="module", autouse=True)
def _runtime():
    init()


@kernel
def sum_ahead(
    values: Ints1,
    n: ti.i32,
    rounds: ti.i32,
    barrier: Ints1,
    threads: ti.i32,
    stride: Template,
    serial: Template,
):
    """Every round, each value becomes the sum of two of the round before: wrong if a thread runs ahead."""
    ti.loop_config(serialize=serial)
    for t in range(threads * stride):
        if t % stride == 0:
            first, last = share(t // stride, threads, n)
            for k in range(rounds):
                old, new = k % 2 * n, (k + 1) % 2 * n
                for i in range(first, last):
                    values[new + i] = (values[old + i] + values[old + (i + n // 2) % n]) % 1000003
                synchronise(barrier, threads)


@kernel
def shares(bounds: Ints1, n: ti.i32, number: ti.i32):
    """First and last + 1 of each thread's share."""
    for t in range(number):
        first, last = share(t, number, n)
        bounds[2 * t] = first
        bounds[2 * t + 1] = last


@kernel
def count_threads(result: Ints1, barrier: Ints1, threads: ti.i32, stride: Template, serial: Template):
    """How many threads share the kernel."""
    ti.loop_config(serialize=serial)
    for t in range(threads * stride):
        if t == 0:
            result[0] = threads


@pytest.mark.parametrize("serial", [False, True])
def test_no_thread_runs_ahead(serial, monkeypatch):
    monkeypatch.setattr(launches, "is_serial", lambda count, cost: serial)
    n, rounds = 37, 20_001
    start = np.arange(1, n + 1, dtype=np.int32)
    expected = start.copy()
    for _ in range(rounds):
        expected = (expected + np.roll(expected, -(n // 2))) % 1000003
    values = np.concatenate([start, start])
    for k in (rounds - 1, 1):  # the barrier is used again
        launch(sum_ahead, values, n, k, work=(n, 1.0))
    np.testing.assert_array_equal(values[n:], expected)


@pytest.mark.parametrize("n", [0, 1, 2, 5, 16, 1000])
@pytest.mark.parametrize("number", [1, 2, 3, 16])
def test_shares_cover_all_once(n, number):
    bounds = np.zeros(2 * number, dtype=np.int32)
    launch(shares, bounds, n, number)
    done = np.concatenate([np.arange(first, last) for first, last in bounds.reshape(-1, 2)])
    np.testing.assert_array_equal(done, np.arange(n))


def test_long_kernels_are_shared_by_all_threads_and_short_ones_by_none(monkeypatch):
    monkeypatch.setattr(barriers, "sharing", Sharing())  # nobody else wants the processor
    result = np.zeros(1, dtype=np.int32)
    launch(count_threads, result, work=(1, 1.0))
    assert result[0] == 1
    launch(count_threads, result, work=(1, 1e9))
    assert result[0] == min(threads(), launches.PARTS)


def test_kernels_are_one_thread_s_while_others_want_the_processor(monkeypatch):
    """Kernels of 4 ms on a clock of our own, whose threads run for a part of the time."""
    now, ran, part, sizes = [100.0], [0.0], [1.0], []
    monkeypatch.setattr(barriers.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(barriers.time, "process_time", lambda: ran[0])
    sharing = Sharing()

    def kernels(count, most=2):
        sizes.clear()
        for _ in range(count):
            with sharing(most) as number:
                now[0] += 0.004
                ran[0] += 0.004 * number * part[0]
                sizes.append(number)
        return sizes

    assert kernels(10) == [2] * 10
    assert kernels(2, most=1) == [1, 1]
    part[0] = 0.9 * Sharing.RUNNING

    def rests(count):
        return [len(list(group)) for number, group in itertools.groupby(kernels(count)) if number == 1]

    first = round(Sharing.FIRST_REST / 0.004)
    found = rests(1000)
    assert found[0] == first
    assert found[1] >= 1.8 * first
    assert max(found) == round(Sharing.REST / 0.004)
    part[0] = 1.0
    now[0] += Sharing.REST
    assert kernels(10) == [2] * 10
    part[0] = 0.9 * Sharing.RUNNING
    assert rests(20)[0] == first  # after a good check


@pytest.mark.slow
def test_no_more_threads_wait_than_taichi_has(monkeypatch):
    """Whatever the environment says: more would wait for ever."""
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

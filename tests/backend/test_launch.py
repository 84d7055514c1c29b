"""Kernels that `launch` starts: the same results as Taichi's own launch, what it fills in, and what it refuses."""

import gc

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import launch as launches
from tipfem.backend import runtime
from tipfem.backend.array_types import Array1, Array2, Ints1, Reals1, Reals2, Template
from tipfem.backend.arrays import Buffers, download, tallies
from tipfem.backend.launch import close_gaps, every_schedule, kernel, launch, part_of
from tipfem.backend.runtime import init, threads
from tipfem.linalg import vector_kernels


@kernel
def scaled(source: Reals1, target: Reals1, factor: float, n: ti.i32, twice: Template):
    """target = factor source, or twice that."""
    for i in range(n):
        target[i] = factor * source[i] * (2.0 if ti.static(twice) else 1.0)


@kernel
def total(values: Ints1, n: ti.i32) -> ti.i32:
    """Sum of the first n."""
    result = 0
    for i in range(n):
        result += values[i]
    return result


@kernel
def positive(values: Ints1, listed: Ints1, found: Ints1, parts: ti.i32, stride: Template, serial: Template) -> ti.i32:
    """List where values are positive; how many there are."""
    ti.loop_config(serialize=serial)
    for s in range(parts * stride):
        first, last = part_of(s, parts, stride, values.shape[0])
        end = first
        for i in range(first, last):
            if values[i] > 0:
                listed[end] = i
                end += 1
        if s % stride == 0:
            found[s // stride] = end - first
    count = 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        count = close_gaps(listed, found, parts, values.shape[0])
    return count


@kernel
def mean(values: Reals1, n: ti.i32) -> ti.f64:
    """Mean of the first n."""
    result = 0.0
    for i in range(n):
        result += values[i] / n
    return result


@kernel
def every(values: Array1, result: Array1, factor: ti.f64, first: ti.i32, step: Template) -> ti.i32:
    """result = factor * values from ``first`` on, every ``step``; how many."""
    count = 0
    ti.loop_config(serialize=True)
    for i in range(values.shape[0]):
        if i >= first and (i - first) % step == 0:
            result[i] = factor * values[i]
            count += 1
    return count


@kernel
def doubled(values: Array2, n: ti.i32):
    """values *= 2, in rows of two."""
    for i in range(n):
        for k in range(2):
            values[i, k] = 2 * values[i, k]


@kernel
def schedule(result: Ints1, parts: ti.i32, stride: Template, serial: Template, one_counts: Template):
    """What has been filled in."""
    result[0], result[1] = parts, stride
    result[2], result[3] = ti.static(int(serial)), ti.static(int(one_counts))


@pytest.fixture(scope="module", autouse=True)
def _runtime():
    init()


def test_numbers_and_templates_may_change_from_launch_to_launch():
    buffers, values = Buffers(), np.arange(20.0)
    source, target = buffers.upload("a", values), buffers.get("b", 20)
    for factor, n, twice in ((1.0, 20, False), (3, 20, False), (-2.0, np.int64(20), True), (np.float32(5.0), 7, False)):
        expected = download(target, 20)
        expected[:n] = factor * values[:n] * (2 if twice else 1)
        launch(scaled, source, target, factor, n, twice)
        np.testing.assert_array_equal(download(target, 20), expected)


def test_arrays_of_numpy_are_those_of_this_launch():
    target = Buffers().get("b", 5)
    for k in range(3):
        launch(scaled, np.full(5, float(k)), target, 2.0, 5, False)
        assert (download(target, 5) == 2 * k).all()
    out = np.zeros(5)
    launch(scaled, target, out, 0.5, 5, False)
    assert (out == 2).all()


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int32, np.int64])
def test_sizes_and_types_may_change_from_launch_to_launch(kind):
    for n, first, step in ((5, 0, 1), (50, 3, 1), (7, np.int64(2), 2), (50, 3, 2)):
        values, result = np.arange(n).astype(kind), np.zeros(n, dtype=kind)
        count = launch(every, values, result, 3, first, step)
        expected = np.zeros(n)
        expected[first::step] = 3.0 * values[first::step]
        np.testing.assert_array_equal(result, expected)
        assert count == len(range(first, n, step))


def test_device_arrays_and_arrays_of_numpy_may_be_mixed():
    array, other = ti.ndarray(ti.f64, 30), ti.ndarray(ti.f32, 30)
    for target, kind in ((array, np.float64), (other, np.float32), (array, np.float64)):
        values = np.random.default_rng(1).uniform(size=30).astype(kind)
        assert launch(every, values, target, 0.5, 0, 1) == 30
        np.testing.assert_array_equal(target.to_numpy(), 0.5 * values)
        result = np.zeros(30)
        assert launch(every, target, result, 2.0, 10, 1) == 20
        np.testing.assert_array_equal(result[10:], values[10:])


def test_what_a_kernel_returns_comes_back():
    values = Buffers().upload("a", np.arange(10))
    assert [launch(total, values, n) for n in (10, 3, 0)] == [45, 3, 0]
    assert launch(mean, np.array([1.0, 2.5]), 2) == 1.75


def test_what_was_prepared_for_an_array_is_dropped_with_it():
    gc.collect()
    before, buffers = len(scaled._prepared), Buffers()
    for n in (16, 40, 1000):  # arrays grow, and the old ones go
        source, target = buffers.upload("a", np.ones(n)), buffers.get("b", n)
        launch(scaled, source, target, 4.0, n, False)
        assert (download(target, n) == 4).all()
        assert len(scaled._prepared) == before + 1
    del source, target, buffers
    gc.collect()
    assert len(scaled._prepared) == before


@pytest.mark.parametrize("size", [1, 700, 40_000])
def test_one_thread_and_all_of_them_give_the_same_bits(size):
    buffers, rng = Buffers(), np.random.default_rng(size)
    start, found = rng.normal(size=5 * size), []
    for nanoseconds in (1e9, 1e-9):
        krylov, partial = buffers.upload("krylov", start), buffers.partials("partial", 3, flat=True)
        launch(
            vector_kernels.orthogonalise,
            krylov,
            partial,
            buffers.get("results", 10),
            1,
            size,
            0.0,
            work=(size, nanoseconds),
        )
        found.append(np.concatenate([download(krylov, 5 * size), download(partial, 5)]))
    np.testing.assert_array_equal(*found)


def test_what_is_filled_in_follows_from_the_work(monkeypatch):
    short, long = np.zeros(4, dtype=np.int32), np.zeros(4, dtype=np.int32)
    launch(schedule, short, work=(100, 10.0))
    launch(schedule, long, work=(1_000_000, 10.0))
    few = int(threads() <= launches.FEW_THREADS)
    assert short.tolist() == [launches.PARTS, 1, 1, few]
    assert long.tolist() == ([launches.PARTS, launches.ITERATIONS, 0, few] if threads() > 1 else short.tolist())
    monkeypatch.setattr(runtime, "on_gpu", lambda: True)
    assert schedule.schedule((1_000_000, 10.0), host=False) == (launches.PARTS_OF_GPU, 1, False, False)
    assert schedule.schedule((100, 10.0), host=True) == (*short[:2], True, few)  # beside it, as without


def test_wrong_arguments_are_refused():
    values, result = np.zeros(3), np.zeros(4, dtype=np.int32)
    with pytest.raises(TypeError, match=r"scaled takes 5 arguments \(source, target, factor, n, twice\); 4 given"):
        launch(scaled, values, values, 1.0, 3)
    with pytest.raises(TypeError, match="schedule has a parameter serial"):
        launch(schedule, result)
    with pytest.raises(TypeError, match=r"scaled: target is 1.0; it must be an array"):
        launch(scaled, values, 1.0, 1.0, 3, False)
    with pytest.raises(TypeError, match="scaled: target has 2 axes instead of 1"):
        launch(scaled, values, np.zeros((3, 1)), 1.0, 3, False)
    with pytest.raises(TypeError, match="scaled: target is of int32 instead of reals"):
        launch(scaled, values, np.zeros(3, dtype=np.int32), 1.0, 3, False)
    with pytest.raises((TypeError, ValueError), match="i32"):
        launch(total, values, 3)
    with pytest.raises(TypeError, match="scaled: "):
        launch(scaled, values, values, 1.0, "three", False)
    with pytest.raises(ValueError, match=r"doubled: an array of shape \(3, 2\) is not C-contiguous"):
        launch(doubled, np.zeros((2, 3)).T, 3)


def test_what_is_filled_in_stands_at_the_end_and_is_of_its_type():
    with pytest.raises(TypeError, match="wrong: parts must be the last parameters"):

        @kernel
        def wrong(parts: ti.i32, values: Reals1):
            pass

    with pytest.raises(TypeError, match="wrong_type: parts is filled in by launch"):

        @kernel
        def wrong_type(values: Reals1, parts: Reals2):
            pass


@pytest.mark.parametrize("size", [0, 1, 15, 16, 17, 5000])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_what_parts_list_is_one_ascending_list(size, share):
    rng = np.random.default_rng(0)
    values, listed = (rng.random(size) < share).astype(np.int32), np.empty(size, np.int32)
    for _ in every_schedule():
        listed.fill(-1)
        count = launch(positive, values, listed, tallies("test.found"), work=(size, 1.0))
        np.testing.assert_array_equal(listed[:count], np.flatnonzero(values))

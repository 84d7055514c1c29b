"""Kept kernels are started by machine code that reads Python's arguments, only where these are as before."""

import gc

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import kept_kernels
from tipfem.backend.array_types import Ints1, Reals1, Reals2, Template
from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import kernel, launch
from tipfem.backend.quick_launch import layout_is_known
from tipfem.backend.runtime import init


@kernel
def weighted(
    values: Reals2, weights: Reals1, counts: Ints1, result: Reals1, n: ti.i32, f: float, step: Template
) -> float:
    """result = f sum_k weights[k] values[:, k] + counts, times ``step``; the last of n rows is returned."""
    last = 0.0
    ti.loop_config(serialize=True)
    for i in range(n):
        total = 0.0
        for k in range(values.shape[1]):
            total += weights[k] * values[i, k]
        last = (f * total + counts[i]) * step
        result[i] = last
    return last


def by_numpy(values, weights, counts, result, n, f, step):
    """The same in NumPy."""
    result[:n] = (f * values[:n] @ weights + counts[:n]) * step
    return result[n - 1]


@pytest.fixture(autouse=True)
def _runtime():
    init()
    if not (kept_kernels._library and layout_is_known()):
        pytest.skip("kernels are not kept here, or objects lie in another way")


def given(rows, width, seed=0):
    """Arguments of `weighted`."""
    random = np.random.default_rng(seed)
    values, weights = random.random((rows, width)), random.random(width)
    return values, weights, np.arange(rows, dtype=np.int32), np.zeros(rows), rows, 0.5, 2


def test_other_arrays_shapes_and_numbers_are_read_at_each_start(monkeypatch):
    launch(weighted, *given(3, 2))
    monkeypatch.setattr(weighted, "_start", None)  # the longer way
    for rows, width in ((1, 1), (7, 3), (50, 2)):
        for f in (0.25, np.float64(-3.0)):
            first, second = given(rows, width, seed=1), given(rows, width, seed=1)
            last = launch(weighted, *first[:5], f, first[6])
            assert last == pytest.approx(by_numpy(*second[:5], f, second[6]))
            np.testing.assert_allclose(first[3], second[3])
    first = given(1, 2)
    assert launch(weighted, *first[:4], True, *first[5:]) == pytest.approx(by_numpy(*given(1, 2)))


def test_what_is_otherwise_goes_the_longer_way(monkeypatch):
    values, weights, counts, result, rows, f, step = given(5, 2)
    launch(weighted, values, weights, counts, result, rows, f, step)
    ways = []
    start = weighted._start
    monkeypatch.setattr(weighted, "_start", lambda arguments: ways.append(1) or start(arguments))
    others = [
        (values, weights, counts, result, np.int64(rows), f, step),
        (values, weights, counts, result, rows, 1, step),
        (values, weights, counts, result, rows, f, 3),
    ]
    for arguments in others:
        expected = result.copy()
        by_numpy(*arguments[:3], expected, *arguments[4:])
        launch(weighted, *arguments)
        np.testing.assert_allclose(result, expected)
    assert len(ways) == 3
    wrong = [
        ((values.T, weights, counts, result, 2, f, step), "not C-contiguous"),
        ((values[0], weights, counts, result, rows, f, step), "values"),
        ((values, weights, counts.astype(float), result, rows, f, step), "counts"),
        ((values, weights, counts, result, "5", f, step), "weighted"),
        ((None, weights, counts, result, rows, f, step), "values"),
    ]
    for arguments, text in wrong:
        with pytest.raises((TypeError, ValueError), match=text):
            launch(weighted, *arguments)


def test_a_few_kinds_of_arguments_take_turns(monkeypatch):
    kinds = [(*given(3, 2)[:6], step) for step in range(2, 6)]
    for arguments in kinds:
        launch(weighted, *arguments)
    monkeypatch.setattr(weighted, "_start", None)
    for arguments in kinds:
        launch(weighted, *arguments)
        expected = arguments[3].copy()
        by_numpy(*arguments[:3], expected, *arguments[4:])
        np.testing.assert_allclose(arguments[3], expected)


@pytest.mark.slow
def test_an_array_in_the_place_of_one_that_is_gone_is_another():
    values, weights, counts, result, rows, f, step = given(4, 2)
    for factor in range(1, 30):
        buffers = Buffers()
        device = buffers.upload("values", factor * values)
        out = buffers.get("result", rows)
        launch(weighted, device, weights, counts, out, rows, f, step)
        assert weighted._recent
        by_numpy(factor * values, weights, counts, result, rows, f, step)
        np.testing.assert_allclose(download(out, rows), result)
        del buffers, device, out
        gc.collect()
        assert not weighted._recent

"""tipfem/array_launch.py: the same results as Taichi's own launch, and what it refuses."""

import numpy as np
import pytest
import taichi as ti

import tipfem as tp
from tipfem.backend.launch import on_arrays


@on_arrays
@ti.kernel
def scaled(
    values: ti.types.ndarray(), result: ti.types.ndarray(), factor: ti.f64, first: ti.i32, step: ti.template()
) -> ti.i32:
    """result = factor * values from ``first`` on, every ``step``; how many."""
    count = 0
    ti.loop_config(serialize=True)
    for i in range(values.shape[0]):
        if i >= first and (i - first) % step == 0:
            result[i] = factor * values[i]
            count += 1
    return count


@on_arrays
@ti.kernel
def doubled(values: ti.types.ndarray(), n: ti.i32):
    """values *= 2, in rows of two."""
    for i in range(n):
        for k in range(2):
            values[i, k] = 2 * values[i, k]


@pytest.fixture(autouse=True)
def started():
    """Taichi runs."""
    tp.init()


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int32, np.int64])
def test_sizes_types_and_templates_may_change_from_call_to_call(kind):
    for n, first, step in ((5, 0, 1), (50, 3, 1), (7, np.int64(2), 2), (50, 3, 2)):
        values, result = np.arange(n).astype(kind), np.zeros(n, dtype=kind)
        count = scaled(values, result, 3, first, step)
        expected = np.zeros(n)
        expected[first::step] = 3.0 * values[first::step]
        np.testing.assert_array_equal(result, expected)
        assert count == len(range(first, n, step))


def test_device_arrays_do_as_well():
    array, other = ti.ndarray(ti.f64, 30), ti.ndarray(ti.f32, 30)
    for target, kind in ((array, np.float64), (other, np.float32), (array, np.float64)):
        values = np.random.default_rng(1).uniform(size=30).astype(kind)
        assert scaled(values, target, 0.5, 0, 1) == 30
        np.testing.assert_array_equal(target.to_numpy(), 0.5 * values)
        result = np.zeros(30)
        assert scaled(target, result, 2.0, 10, 1) == 20
        np.testing.assert_array_equal(result[10:], values[10:])


def test_what_is_not_contiguous_and_what_is_missing_is_refused():
    with pytest.raises(ValueError, match=r"doubled: an array of shape \(3, 2\) is not C-contiguous"):
        doubled(np.zeros((2, 3)).T, 3)
    with pytest.raises(Exception, match=r"[Mm]issing|argument"):
        doubled(np.zeros((3, 2)))

"""Device buffers."""

from __future__ import annotations

import numpy as np
import pytest
from device_memory import memory

from tipfem.backend import arrays, runtime
from tipfem.backend.arrays import Buffers, download, sums_by_label, taken


def test_buffers_grow_and_are_used_again():
    buffers = Buffers()
    first = buffers.get("a", 100)
    assert first.shape[0] >= 100
    assert buffers.get("a", 100) is first
    assert buffers.get("a", 3) is first
    assert buffers.get("a", 0) is first
    assert buffers.get("b", 100) is not first
    larger = buffers.get("a", 1000)
    assert larger is not first
    assert larger.shape[0] >= 1000
    assert buffers.get("a", 100) is larger
    assert buffers.get("table", 10, 3).shape[1] == 3
    assert buffers.get("nothing", 0).shape[0] >= 1


@pytest.mark.parametrize("shape", [(7,), (1,), (5, 3), (64, 2)])
@pytest.mark.parametrize("kind", [np.float64, np.int32, np.int64, bool])
def test_upload_and_download_are_a_round_trip(shape, kind):
    buffers = Buffers()
    values = (np.random.default_rng(0).uniform(-9, 9, shape)).astype(kind)
    back = download(buffers.upload("a", values), shape[0])
    assert back.dtype == (np.float64 if kind is np.float64 else np.int32)
    np.testing.assert_array_equal(back, values)
    smaller = values[: (shape[0] + 1) // 2]
    np.testing.assert_array_equal(download(buffers.upload("a", smaller), len(smaller)), smaller)


def test_upload_takes_slices_and_empty_arrays():
    buffers = Buffers()
    table = np.arange(24.0).reshape(6, 4)
    np.testing.assert_array_equal(download(buffers.upload("a", table[::2, 1:3]), 3), table[::2, 1:3])
    np.testing.assert_array_equal(download(buffers.upload("b", table.T), 4), table.T)
    assert len(download(buffers.upload("empty", np.zeros(0)), 0)) == 0


def test_memory_stays_flat_while_sizes_change():
    buffers = Buffers()
    rng = np.random.default_rng(2)

    def use(rows):
        buffers.upload("vector", np.zeros(rows))
        buffers.upload("cells", np.zeros((2 * rows, 3), dtype=np.int32))
        buffers.get("work", 3 * rows, 4)

    use(1000)
    held = memory(buffers)
    assert held >= 1000 * (8 + 2 * 3 * 4 + 3 * 4 * 8)
    assert held <= 1.2 * 1000 * (8 + 2 * 3 * 4 + 3 * 4 * 8)
    for _ in range(200):
        use(int(rng.integers(1, 1001)))
    assert memory(buffers) == held
    # creeping growth does not ask for a new array every time
    arrays = {id(buffers.get("vector", rows)) for rows in range(1000, 1100)}
    assert len(arrays) == 1


def test_filled_arrays_are_set_where_they_are_others():
    buffers = Buffers()
    for rows, value in ((5, 1.0), (3, 1.0), (500, 1.0), (500, 2.0)):
        assert (download(buffers.filled("a", rows, value), rows) == value).all()
    buffers.upload("a", np.arange(4.0))
    assert download(buffers.filled("a", 4, 2.0), 4).tolist() == [2.0] * 4


@pytest.mark.parametrize("size", [0, 5, 40000])
def test_sums_by_label_are_those_of_each_label_alone(size):
    rng = np.random.default_rng(2)
    label, values = rng.integers(0, 7, size).astype(np.int32), rng.normal(size=size)
    np.testing.assert_allclose(sums_by_label(label, values, 9), np.bincount(label, values, 9), rtol=1e-11, atol=1e-11)
    assert sums_by_label(label[:0], values[:0], 0).shape == (0,)


def test_a_draft_is_filled_and_given_on():
    """On a processor it is the device array's memory; values from elsewhere replace it."""
    buffers, values = Buffers(), np.arange(10.0).reshape(5, 2)
    for factor in (1.0, 2.0):
        draft = buffers.draft("drafted", 5, 2)
        draft[...] = factor * values
        np.testing.assert_array_equal(download(buffers.upload("drafted", draft), 5), factor * values)
    np.testing.assert_array_equal(download(buffers.upload("drafted", values), 5), values)
    assert buffers.draft("single", 3).shape == (3,)


def test_reals_are_taken_from_tables():
    tables, index = [np.array([1.0, 5.0, 7.0])[::2], [2.0, 3.0]], np.array([1, 0, 0, 1], dtype=np.int64)
    for name in ("", "taken"):
        assert taken(tables, index, name).tolist() == [[7.0, 1.0, 1.0, 7.0], [3.0, 2.0, 2.0, 3.0]]


def test_arrays_beside_those_of_the_device_keep_their_dimensions(monkeypatch):
    """By which kernels tell axisymmetric flows from planar ones."""
    runtime.require_init()
    monkeypatch.setattr(arrays, "on_cpu", lambda: False)
    buffers = Buffers()
    for values in (np.ones((1, 1, 1)), np.ones((1, 1, 1)), np.full((1, 1, 2), 3.0)):
        array = buffers.beside("period", values)
        assert array.shape == values.shape
        np.testing.assert_array_equal(array.to_numpy(), values)
    assert buffers.beside("other", np.ones((2, 2))).shape[1:] == (2,)
    with pytest.raises(AssertionError, match="period has the shape"):
        buffers.upload("period", np.ones((1, 1, 1)))

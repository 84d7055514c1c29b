"""Device arrays: kept by name from step to step, filled from NumPy and read back.

Taichi recompiles a kernel for every new field, but not for an ndarray of another length, and it never frees ndarrays of
vectors. So all device arrays here are scalar ndarrays that grow and are reused; kernels are passed how many of
their rows are in use.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti

from tipfem.backend import staging
from tipfem.backend.array_types import Ints1, Reals1, Reals2, Template
from tipfem.backend.launch import add_parts, copy, kernel, launch, part_of, parts
from tipfem.backend.runtime import on_cpu, real, require_own_runtime, taichi_real
from tipfem.backend.taichi_patches import ENABLED, host_view
from tipfem.scratch import copied, scratch

APART = 16  # columns more of partial sums that a kernel adds to in memory: threads must not share lines of the cache
LABELLED, TAKEN = 4.0, 2.0  # nanoseconds of one thread for a value in `sums_by_label`, and in `taken`
SPARE = 64  # rows that an array has more than are used, at least: for a new array, kernels are prepared anew


class Buffers:
    """Device arrays by name, grown when needed and reused."""

    def __init__(self) -> None:
        self._arrays: dict[str, Any] = {}
        self._filled: dict[str, tuple[Any, float]] = {}

    def get(self, name: str, rows: int, columns: int = 0, *, integer: bool = False, double: bool = False) -> Any:
        """A device array with at least ``rows`` rows, undefined; one name keeps one width and type.

        ``columns`` is 0 for a one-dimensional one; 64-bit reals if ``double``, whatever the kernels' are. See
        `require_own_runtime` for errors.
        """
        require_own_runtime()
        array = self._arrays.get(name)
        if array is None or array.shape[0] < rows or (columns and array.shape[1] != columns):
            capacity = rows + max(rows // 8, SPARE)
            if array is not None and array.shape[0] >= rows:
                capacity = array.shape[0]
            shape = (capacity, columns) if columns else (capacity,)
            array = ti.ndarray(ti.i32 if integer else ti.f64 if double else taichi_real(), shape)
            self._arrays[name] = array
        return array

    def partials(self, name: str, columns: int, *, flat: bool = False) -> Any:
        """A device array (parts, columns) for the partial sums of a kernel, or (parts * columns,) if ``flat``."""
        return self.get(name, parts() * columns) if flat else self.get(name, parts(), columns)

    def grow(self, name: str, rows: int) -> Any:
        """A one-dimensional array of reals with at least ``rows`` rows, which keeps its values when it grows."""
        old = self._arrays.get(name)
        array = self.get(name, rows)
        if old is not None and array is not old:
            launch(copy, old, array, old.shape[0])
        return array

    def draft(self, name: str, rows: int, columns: int = 0) -> np.ndarray:
        """A NumPy array of 64-bit reals to be filled and given to `upload`, which copies nothing on a processor."""
        if ENABLED and on_cpu() and real() is np.float64:
            return np.asarray(host_view(self.get(name, rows, columns))[:rows])
        return scratch(f"draft of {name}", (rows, columns) if columns else rows)

    def upload(self, name: str, values: np.ndarray, *, double: bool = False) -> Any:
        """Copy a NumPy array of one or two dimensions into the device array of that name; see `get` and `draft`."""
        assert values.ndim < 3, f"{name} has the shape {values.shape}"
        self._filled.pop(name, None)
        integer = values.dtype.kind in "iub"
        columns = values.shape[1] if values.ndim == 2 else 0
        array = self.get(name, len(values), columns, integer=integer, double=double)
        if ENABLED and on_cpu():
            view = host_view(array)
            if values.base is not view.base:  # it is not a `draft`
                view[: len(values)] = values
        elif len(values):
            staging.upload(values, array)
        return array

    def filled(self, name: str, rows: int, value: float) -> Any:
        """A device array of reals that are all ``value``, which only `filled` and `upload` set."""
        array = self.get(name, rows)
        if self._filled.get(name) != (array, value):
            self.upload(name, np.full(array.shape[0], value))
            self._filled[name] = array, value
        return array

    def beside(self, name: str, values: np.ndarray) -> Any:
        """NumPy's array of reals for a kernel that is given device arrays, too: on a GPU, a device array."""
        if on_cpu():
            return values
        if values.ndim < 3:
            return self.upload(name, values, double=True)
        array = self._arrays.get(name)  # a kernel is compiled for the number of dimensions, see `periodic`
        if array is None or array.shape != values.shape:
            array = self._arrays[name] = ti.ndarray(ti.f64, values.shape)
        array.from_numpy(values)
        return array


def partials(columns: int) -> np.ndarray:
    """A NumPy array (parts, columns) for the partial sums of a kernel; (parts,) if ``columns`` is 0."""
    return np.empty((parts(), columns) if columns else parts())


def tallies(name: str) -> np.ndarray:
    """A NumPy array (parts,) for what each part of a kernel's loop finds, in the memory of that name; see `scratch`."""
    return scratch(name, parts(), np.int32)


@kernel
def _add_by_label(  # type: ignore[no-untyped-def]
    label: Ints1, values: Reals1, partial: Reals2, sums: Reals1, parts: ti.i32, stride: Template, serial: Template
):
    """Add values (K,) to the sums of their labels."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        if t % stride == 0:
            for i in range(sums.shape[0]):
                partial[t // stride, i] = 0.0
        first, last = part_of(t, parts, stride, label.shape[0])
        if first < last:
            one = label[first]
            total = partial[t // stride, one]  # in a register, as long as labels stay the same
            for k in range(first, last):
                if label[k] != one:
                    partial[t // stride, one] = total
                    one = label[k]
                    total = partial[t // stride, one]
                total += values[k]
            partial[t // stride, one] = total
    ti.loop_config(serialize=True)
    for i in range(sums.shape[0]):
        add_parts(sums, partial, i, parts)


def sums_by_label(label: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sums (count,) of values (K,) by their labels (K,), int32."""
    sums = np.zeros(count)
    launch(_add_by_label, label, values, partials(count + APART), sums, work=(len(label), LABELLED))
    return sums


@kernel
def _take(values: Reals2, index: Ints1, result: Reals2, serial: Template):  # type: ignore[no-untyped-def]
    """result (R, K) = values[:, index (K,)]."""
    ti.loop_config(serialize=serial)
    for k in range(index.shape[0]):
        for r in range(values.shape[0]):
            result[r, k] = values[r, index[k]]


def taken(tables: Sequence[np.ndarray], index: np.ndarray, name: str = "") -> np.ndarray:
    """Reals (R, K) from R tables by indices (K,), int32; new or in memory of a ``name``, see `scratch`."""
    values, shape = np.array(tables, dtype=np.float64), (len(tables), len(index))
    result = scratch(name, shape)
    launch(_take, values, np.ascontiguousarray(index, dtype=np.int32), result, work=(len(index), TAKEN))
    return result


def download(array: Any, rows: int, *, copy: bool = True) -> np.ndarray:
    """The first ``rows`` rows of a device array, as a NumPy array; without a ``copy``, they may change with it."""
    require_own_runtime()
    if ENABLED and on_cpu():
        return copied(host_view(array)[:rows]) if copy else host_view(array)[:rows]
    return staging.download(array, rows)


def expect(array: Any, rows: int) -> None:
    """Announce that first rows of an array are downloaded after the next download, before a kernel uses it again.

    On a GPU, they are read together with that one, where they are few.
    """
    if not on_cpu():
        staging.expect(array, rows)

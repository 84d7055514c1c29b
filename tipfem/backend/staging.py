"""Small copies between NumPy and the arrays of a GPU, many at a time.

A copy of a few numbers takes as long as one of some hundred kilobytes, and the host waits for it. So small uploads wait
until a kernel uses one of their arrays; then all are made by one copy into an array on the device, and from there into
their own. What is read together is collected there, too.
"""

import math
from typing import Any

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Array1, Array2
from tipfem.backend.cuda_copies import Copies, copies
from tipfem.backend.launch import awaited, copy, copy_rows, fetched, flushes, kernel, launch
from tipfem.backend.runtime import on_cuda

SMALL = 1 << 18  # bytes of the largest array that is copied together with others
NUMPY_TYPES = {ti.i32: np.int32, ti.f32: np.float32, ti.f64: np.float64}


@kernel
def scatter(source: Array1, first: ti.i32, target: Array1, n: ti.i32):  # type: ignore[no-untyped-def]
    """Copy ``n`` entries of the source, from ``first`` on, to the beginning of the target."""
    for i in range(n):
        target[i] = source[first + i]


@kernel
def scatter_rows(source: Array1, first: ti.i32, target: Array2, n: ti.i32):  # type: ignore[no-untyped-def]
    """The same for a table, row by row."""
    for i in range(n):
        target[i // target.shape[1], i % target.shape[1]] = source[first + i]


@kernel
def gather(source: Array1, target: Array1, first: ti.i32, n: ti.i32):  # type: ignore[no-untyped-def]
    """Copy the first ``n`` entries of the source to the target, from ``first`` on."""
    for i in range(n):
        target[first + i] = source[i]


@kernel
def gather_rows(source: Array2, target: Array1, first: ti.i32, n: ti.i32):  # type: ignore[no-untyped-def]
    """The same for a table, row by row."""
    for i in range(n):
        target[first + i] = source[i // source.shape[1], i % source.shape[1]]


def _direct(array: Any) -> Copies | None:
    """The driver's copies, on CUDA."""
    return copies(array) if on_cuda() else None


def _bytes(array: Any, rows: int) -> int:
    return int(rows * math.prod(array.shape[1:]) * np.dtype(NUMPY_TYPES[array.dtype]).itemsize)


class _Words:
    """First rows of device arrays, one array after the other, in 64-bit words on the host and on the device.

    The driver copies them as they are; kernels, as 64-bit reals.
    """

    def __init__(self) -> None:
        self.used, self.parts = 0, list[tuple[Any, int, int]]()  # array, rows, first word
        self._host, self._device = np.empty(0), list[Any]()

    def add(self, array: Any, rows: int) -> None:
        """Make room for the first rows of an array."""
        entries, first = rows * math.prod(array.shape[1:]), self.used
        self.used += -(-_bytes(array, rows) // 8) if _direct(array) else entries
        if self.used > len(self._host):
            self._host = np.append(self._host[:first], np.empty(2 * self.used - first))
        self.parts.append((array, rows, first))

    def rows(self, number: int) -> np.ndarray:
        """A view of the rows of a part on the host."""
        array, rows, first = self.parts[number]
        shape = rows, *array.shape[1:]
        kind = NUMPY_TYPES[array.dtype] if _direct(array) else np.float64
        return self._host[first : self.used].view(kind)[: math.prod(shape)].reshape(shape)

    def _staging(self) -> Any:
        if not self._device or self._device[0].shape[0] < self.used:
            self._device[:] = [ti.ndarray(ti.f64, (2 * self.used,))]
        return self._device[0]

    def to_device(self) -> None:
        """Copy all rows from the host to their arrays, and forget them."""
        staging, words, parts = self._staging(), self._host[: self.used], self.parts
        self.used, self.parts = 0, []
        _copy_to(words, staging)
        direct = _direct(staging)
        for array, rows, first in parts:
            if direct:
                direct.move(staging, 8 * first, array, 0, _bytes(array, rows))
            else:
                entries = rows * math.prod(array.shape[1:])
                launch(scatter if len(array.shape) == 1 else scatter_rows, staging, first, array, entries)

    def to_host(self) -> list[np.ndarray]:
        """Copies of all rows on the device, and forget them."""
        staging = self._staging()
        direct = _direct(staging)
        for array, rows, first in self.parts:
            if direct:
                direct.move(array, 0, staging, 8 * first, _bytes(array, rows))
            else:
                entries = rows * math.prod(array.shape[1:])
                launch(gather if len(array.shape) == 1 else gather_rows, array, staging, first, entries)
        _copy_from(staging, self._host[: self.used])
        result = [self.rows(k).astype(NUMPY_TYPES[part[0].dtype]) for k, part in enumerate(self.parts)]
        self.used, self.parts = 0, []
        return result


_waiting, _wanted = _Words(), _Words()


def _copy_to(values: np.ndarray, array: Any) -> None:
    direct = _direct(array)
    if direct:
        direct.upload(values, array)
    else:
        launch(copy_rows if values.ndim == 2 else copy, values, array, len(values))


def _copy_from(array: Any, values: np.ndarray) -> None:
    direct = _direct(array)
    if direct:
        direct.download(array, values)
    else:
        launch(copy_rows if values.ndim == 2 else copy, array, values, len(values))


def upload(values: np.ndarray, array: Any) -> None:
    """Copy values (n, ...), n > 0, to the beginning of a device array; few of them when a kernel uses it."""
    fetched.pop(id(array), None)
    if _bytes(array, len(values)) <= SMALL:
        _waiting.add(array, len(values))
        _waiting.rows(-1)[...] = values
        awaited[id(array)] = array
        return
    if id(array) in awaited:
        flush()
    _copy_to(np.ascontiguousarray(values, dtype=NUMPY_TYPES[array.dtype]), array)


def flush() -> None:
    """Make the uploads that wait."""
    awaited.clear()
    _waiting.to_device()


flushes.append(flush)


def expect(array: Any, rows: int) -> None:
    """Note that first rows of a device array are to be read; see `tipfem.backend.arrays.expect`."""
    if rows and _bytes(array, rows) <= SMALL:
        _wanted.add(array, rows)


def download(array: Any, rows: int) -> np.ndarray:
    """A copy of the first rows of a device array; with it are read those that are expected."""
    if id(array) not in fetched and _wanted.parts:
        expect(array, rows)
        if awaited:
            flush()
        arrays = [part[0] for part in _wanted.parts]
        fetched.clear()
        fetched.update((id(of), (of, values)) for of, values in zip(arrays, _wanted.to_host(), strict=True))
    known = fetched.get(id(array))
    if known and len(known[1]) >= rows:
        return np.array(known[1][:rows])
    if id(array) in awaited:
        flush()
    values = np.empty((rows, *array.shape[1:]), NUMPY_TYPES[array.dtype])
    if values.size:
        _copy_from(array, values)
    return values

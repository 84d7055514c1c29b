"""Copies between NumPy and device arrays on CUDA, by calls of the driver.

To give an array of NumPy to a kernel, Taichi allocates memory on the GPU, copies the array there and back, and frees
the memory, whatever the kernel does with it.
"""

import ctypes
from typing import Any

import numpy as np

from tipfem.backend.taichi_patches import ENABLED, program

_CONTEXT_OF_POINTER = 1  # CU_POINTER_ATTRIBUTE_CONTEXT
_copies: list["Copies | None"] = []


class Copies:
    """The driver's copies, in the context of Taichi's arrays; `OSError` if there is none, or a call failed."""

    def __init__(self, array: Any) -> None:
        self._driver = ctypes.CDLL("libcuda.so.1")
        pointer = ctypes.c_uint64(_address(array))
        context = ctypes.c_void_p()
        self._call("cuCtxGetCurrent", ctypes.byref(context))
        if not context:
            self._driver.cuPointerGetAttribute(ctypes.byref(context), _CONTEXT_OF_POINTER, pointer)
        if not context:
            self._call("cuDevicePrimaryCtxRetain", ctypes.byref(context), 0)
        self._context = context

    def upload(self, values: np.ndarray, array: Any) -> None:
        """Copy C-contiguous values, of the array's type, to the beginning of a device array."""
        target, source = ctypes.c_uint64(_address(array)), ctypes.c_void_p(values.ctypes.data)
        self._copy("cuMemcpyHtoD_v2", target, source, values.nbytes)

    def download(self, array: Any, values: np.ndarray) -> None:
        """Fill C-contiguous values, of the array's type, from the beginning of a device array."""
        target, source = ctypes.c_void_p(values.ctypes.data), ctypes.c_uint64(_address(array))
        self._copy("cuMemcpyDtoH_v2", target, source, values.nbytes)

    def move(self, source: Any, first: int, target: Any, to: int, count: int) -> None:
        """Copy ``count`` bytes between device arrays, from the byte ``first`` on to the byte ``to``; no host waits."""
        places = ctypes.c_uint64(_address(target) + to), ctypes.c_uint64(_address(source) + first)
        self._copy("cuMemcpyDtoD_v2", *places, count)

    def _copy(self, name: str, target: Any, source: Any, count: int) -> None:
        current = ctypes.c_void_p()  # of this thread
        self._call("cuCtxGetCurrent", ctypes.byref(current))
        if current.value != self._context.value:
            self._call("cuCtxSetCurrent", self._context)
        self._call(name, target, source, ctypes.c_size_t(count))

    def _call(self, name: str, *arguments: Any) -> None:
        status = getattr(self._driver, name)(*arguments)
        if status:
            raise OSError(f"{name} of the CUDA driver failed with status {status}")


def _address(array: Any) -> int:
    return int(program().get_ndarray_data_ptr_as_int(array.arr))


def copies(array: Any) -> Copies | None:
    """The driver's copies for arrays like this, on CUDA; None where the driver does not copy into Taichi's arrays."""
    if not _copies:
        try:
            _copies.append(Copies(array) if ENABLED else None)
        except OSError:
            _copies.append(None)
    return _copies[0]

"""Start kernels at little cost.

Taichi looks at every argument of every call, which takes longer than many a kernel.
"""

import ctypes
import functools
import math
from typing import Any

import numpy as np
import taichi as ti
from taichi.lang import impl
from taichi.lang._ndarray import Ndarray
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext
from taichi.types import primitive_types


def _position(context: Any, node: Any) -> str:
    """Where a statement of a kernel stands, in one line."""
    return f'File "{context.file}", line {node.lineno + context.lineno_offset}, in {context.func.func.__name__}:\n'


# For what a message may want to show, Taichi 1.7.4 wraps the source of every expression of every kernel it reads: half
# of the time that takes.
ASTTransformerContext.get_pos_info = _position


def on_host() -> bool:
    """Whether the processor can read and write device arrays itself."""
    return bool(impl.current_cfg().arch == ti.cpu)


def seen(array: Any) -> np.ndarray:
    """A device array on the host as NumPy sees it; it must not outlive the array."""
    kinds: dict[Any, Any] = {ti.i32: ctypes.c_int32, ti.f32: ctypes.c_float, ti.f64: ctypes.c_double}
    place = impl.get_runtime().prog.get_ndarray_data_ptr_as_int(array.arr)
    flat: np.ndarray = np.ctypeslib.as_array((kinds[array.dtype] * math.prod(array.shape)).from_address(place))
    return flat.reshape(array.shape)


class Launcher:
    """Starts kernels on arrays that they have been started on before.

    Taichi looks at every argument of every call, which takes longer than many a kernel; here that is done once for each
    kernel and its device arrays, which are kept alive until they are forgotten. Numbers and NumPy arrays, contiguous
    ones, may be others every time.
    """

    def __init__(self) -> None:
        self._ready: dict[tuple[Any, ...], _Launch] = {}

    def __call__(self, kernel: Any, *arguments: Any) -> Any:
        """Start ``kernel``; what it returns, which may be an integer."""
        arrays, templates = _kinds(kernel)
        key = (
            kernel,
            *[(a.dtype.char, a.ndim) if type(a) is np.ndarray else id(a) for a in map(arguments.__getitem__, arrays)],
            *map(arguments.__getitem__, templates),
        )
        launch = self._ready.get(key)
        if launch is None:
            launch = self._ready[key] = _Launch(kernel, arguments)
        return launch(arguments)

    def forget(self) -> None:
        """Let go of all arrays."""
        self._ready.clear()


@functools.cache
def _kinds(kernel: Any) -> tuple[list[int], list[int]]:
    """Which arguments of a kernel are arrays, and which are templates."""
    kinds = [a.annotation for a in kernel._primal.arguments]
    return [i for i, k in enumerate(kinds) if isinstance(k, ti.types.ndarray)], [
        i for i, k in enumerate(kinds) if isinstance(k, ti.template)
    ]


class _Launch:
    """A kernel with its device arrays: what Taichi 1.7.4 does in every call, done once as far as it can be."""

    def __init__(self, kernel: Any, arguments: tuple[Any, ...]) -> None:
        primal = kernel._primal
        self._compiled = primal.compiled_kernels[primal.ensure_compiled(*arguments)]
        self._program = program = impl.get_runtime().prog
        self._data = program.compile_kernel(program.config(), program.get_device_caps(), self._compiled)
        self._returns = primal.return_type is not None
        self._arrays: list[tuple[tuple[int], Any]] = []
        self._reals: list[tuple[tuple[int], int]] = []
        self._integers: list[tuple[tuple[int], int]] = []
        self._given: list[tuple[tuple[int], int]] = []
        slot = 0
        for i, (kind, value) in enumerate(zip((a.annotation for a in primal.arguments), arguments, strict=True)):
            if isinstance(kind, ti.template):  # part of the compiled kernel
                continue
            if isinstance(value, Ndarray):
                self._arrays.append(((slot,), value))
            else:
                real = id(kind) in primitive_types.real_type_ids
                kept = self._given if isinstance(value, np.ndarray) else self._reals if real else self._integers
                kept.append(((slot,), i))
            slot += 1
        # Where memory is the host's, one context with plain addresses serves every launch.
        self._context = self._new_context() if on_host() else None

    def _new_context(self) -> Any:
        context = self._compiled.make_launch_context()
        for slot, array in self._arrays:
            if on_host():
                values = seen(array)
                context.set_arg_external_array_with_shape(slot, values.ctypes.data, values.nbytes, values.shape, 0)
            else:
                context.set_arg_ndarray(slot, array.arr)
        return context

    def __call__(self, arguments: tuple[Any, ...]) -> Any:
        context = self._context or self._new_context()
        for slot, i in self._reals:
            context.set_arg_float(slot, arguments[i])
        for slot, i in self._integers:
            context.set_arg_int(slot, arguments[i])
        for slot, i in self._given:
            values = arguments[i]
            context.set_arg_external_array_with_shape(slot, values.ctypes.data, values.nbytes, values.shape, 0)
        self._program.launch_kernel(self._data, context)
        if not self._returns:
            return None
        ti.sync()
        return context.get_struct_ret_int((0,))

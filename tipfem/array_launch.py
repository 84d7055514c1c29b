"""Kernels that are started without Taichi's long look at every argument."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti
from taichi.lang import impl
from taichi.lang._ndarray import Ndarray

from tipfem.launcher import compiled, on_host


def on_arrays(kernel: Any) -> Callable[..., Any]:
    """A kernel that starts three times as fast, on NumPy arrays that are C-contiguous, device arrays and numbers.

    A decorator to stand above `ti.kernel`. Taichi 1.7.4 takes 9 microseconds an argument to find out which of a
    kernel's compiled forms to start; here that is remembered for the types and dimensions of the arrays. Device arrays
    must be of scalars.

    Raises:
        ValueError: an array is not C-contiguous.
    """
    primal = kernel._primal
    templates = [isinstance(argument.annotation, ti.template) for argument in primal.arguments]
    reals = [argument.annotation in (float, ti.f32, ti.f64) for argument in primal.arguments]
    ready: dict[Any, tuple[Any, Any, Any, Any]] = {}

    @functools.wraps(kernel)
    def start(*arguments: Any) -> Any:
        if len(arguments) != len(templates):
            return kernel(*arguments)  # which says what is missing
        key: list[Any] = []
        for value, template in zip(arguments, templates, strict=True):
            if type(value) is np.ndarray:
                if not value.flags.c_contiguous:
                    raise ValueError(f"{kernel.__name__}: an array of shape {value.shape} is not C-contiguous")
                key.append((value.dtype.num, value.ndim))
            elif isinstance(value, Ndarray):
                key.append((value.dtype, len(value.shape)))
            elif template:
                key.append(value)
            elif not isinstance(value, (int, float, np.integer, np.floating)):
                return kernel(*arguments)  # which says what is wrong with it
        program = impl.get_runtime().prog
        found = ready.get(tuple(key))
        if found is None or found[0] is not program:
            form, data = compiled(kernel, arguments)
            # Where memory is the host's, one context serves every launch.
            found = ready[tuple(key)] = (program, form, data, form.make_launch_context() if on_host() else None)
        context, place = found[3] or found[1].make_launch_context(), 0
        for value, template, real in zip(arguments, templates, reals, strict=True):
            if template:  # is part of the compiled kernel
                continue
            if type(value) is np.ndarray:
                context.set_arg_external_array_with_shape((place,), _address(value), value.nbytes, value.shape, 0)
            elif isinstance(value, Ndarray):
                context.set_arg_ndarray((place,), value.arr)
            elif real:
                context.set_arg_float((place,), float(value))
            else:
                context.set_arg_int((place,), int(value))
            place += 1
        program.launch_kernel(found[2], context)
        if primal.return_type is None:
            return None
        if found[3] is None:
            ti.sync()
        return primal.construct_kernel_ret(context, primal.return_type[0], (0,))

    return start


def _address(array: Any) -> int:
    """Where an array's values are: what its ``ctypes.data`` says, in a quarter of the time where that can be had."""
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))
    except (TypeError, ValueError, BufferError):  # read-only, or empty
        return int(array.ctypes.data)

"""Start kernels at little cost.

Taichi looks at every argument of every call, which takes longer than many a kernel.
"""

import ast
import ctypes
import functools
import linecache
import math
import sys
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import taichi as ti
from taichi.lang import impl, kernel_impl
from taichi.lang._ndarray import Ndarray
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext
from taichi.types import primitive_types


def _position(context: Any, node: Any) -> str:
    """Where a statement of a kernel stands, in one line."""
    return f'File "{context.file}", line {node.lineno + context.lineno_offset}, in {context.func.func.__name__}:\n'


# For what a message may want to show, Taichi 1.7.4 wraps the source of every expression of every kernel it reads: half
# of the time that takes.
ASTTransformerContext.get_pos_info = _position


@functools.cache
def _source(function: Any) -> tuple[str, list[str], int, str]:
    """File, lines, number of the first line, and text without indentation of a kernel or a function of one."""
    code = function.__code__
    first = code.co_firstlineno
    lines = linecache.getlines(code.co_filename)[first - 1 :]
    if not lines:  # typed in
        lines, first = kernel_impl.getsourcelines(function)
    head = lines[0][: len(lines[0]) - len(lines[0].lstrip())]
    end = max(line for *_, line in code.co_lines() if line) - first + 1
    while end < len(lines) and (not lines[end].strip() or lines[end].startswith((head + " ", head + ")", head + "]"))):
        end += 1  # the rest of the last statement
    lines = [line.expandtabs(4).rstrip() for line in lines[:end]]
    return kernel_impl.getsourcefile(function), lines, first, textwrap.dedent("\n".join(lines))


def _tree_and_context(
    self: Any,
    excluded_parameters: Any = (),
    is_kernel: bool = True,
    arg_features: Any = None,
    args: Any = None,
    ast_builder: Any = None,
    is_real_function: bool = False,
) -> tuple[ast.Module, ASTTransformerContext]:
    """What Taichi 1.7.4 does at every call of a function in a kernel, with the source looked for once."""
    file, lines, first, text = _source(self.func)
    tree = ast.parse(text)
    tree.body[0].decorator_list = []  # type: ignore[attr-defined]
    known = kernel_impl._get_global_vars(self.func)
    if is_kernel or is_real_function:
        known.update({self.arguments[i].name: args[i] for i in self.template_slot_locations})
    return tree, ASTTransformerContext(
        excluded_parameters=excluded_parameters,
        is_kernel=is_kernel,
        func=self,
        arg_features=arg_features,
        global_vars=known,
        argument_data=args,
        src=lines,
        start_lineno=first,
        file=file,
        ast_builder=ast_builder,
        is_real_function=is_real_function,
    )


kernel_impl._get_tree_and_ctx = _tree_and_context


def _in_class(level_of_class_stackframe: int) -> bool:
    """Whether a kernel is defined in a class; Taichi 1.7.4 reads the source around it to find that out."""
    return "__qualname__" in sys._getframe(level_of_class_stackframe - 1).f_locals


kernel_impl._inside_class = _in_class


def on_host() -> bool:
    """Whether the processor can read and write device arrays itself."""
    return bool(impl.current_cfg().arch == ti.cpu)


def seen(array: Any) -> np.ndarray:
    """A device array on the host as NumPy sees it; it must not outlive the array."""
    kinds: dict[Any, Any] = {ti.i32: ctypes.c_int32, ti.f32: ctypes.c_float, ti.f64: ctypes.c_double}
    place = impl.get_runtime().prog.get_ndarray_data_ptr_as_int(array.arr)
    flat: np.ndarray = np.ctypeslib.as_array((kinds[array.dtype] * math.prod(array.shape)).from_address(place))
    return flat.reshape(array.shape)


def compiled(kernel: Any, arguments: Sequence[Any]) -> tuple[Any, Any]:
    """A kernel's form for such arguments, as Taichi reads it, and as it compiles it or finds it in its cache."""
    program = impl.get_runtime().prog
    form = kernel._primal.compiled_kernels[kernel._primal.ensure_compiled(*arguments)]
    return form, program.compile_kernel(program.config(), program.get_device_caps(), form)


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
        self._program = impl.get_runtime().prog
        self._compiled, self._data = compiled(kernel, arguments)
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

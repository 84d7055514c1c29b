"""All that changes Taichi or reaches into its private modules, in one place.

It is written for Taichi 1.7.4. With another version, or where the environment variable ``TIPFEM_TAICHI_PATCHES`` is 0,
only bundles are added: kernels are started by Taichi's own call, arrays are copied by kernels. Results are bitwise the
same; the start takes longer, and so does every launch.

What is changed, and why:

- ``inspect.getframeinfo`` while Taichi is imported: Taichi calls it for the source around every kernel of its own,
  which takes a third of the import.
- How Taichi looks up the source of a kernel, records the position of every expression for messages, and tests whether
  a kernel is defined in a class: half of the time that parsing kernels takes at the start of a program.
- Parameters that are named tuples, `tipfem.backend.bundles`: they are put together where the kernel's text begins.
- Loops on one thread, only where `tipfem.backend.vulkan` found a driver that does not end them: `group_serial_loops`.
- Launches: Taichi examines every argument of every call, which takes longer than many kernels. `PreparedLaunch` does
  so once for a kernel and its arrays.
"""

from __future__ import annotations

import ast
import ctypes
import functools
import importlib.util
import inspect
import linecache
import math
import os
import sys
import tempfile
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

VERSION = (1, 7, 4)
SWITCH = "TIPFEM_TAICHI_PATCHES"


def _installed() -> bool:
    """Whether that version of Taichi is installed, without importing it."""
    spec = importlib.util.find_spec("taichi")
    if spec is None or spec.origin is None:
        return False
    return (Path(spec.origin).parents[1] / f"taichi-{'.'.join(map(str, VERSION))}.dist-info").is_dir()


ENABLED = os.environ.get(SWITCH, "1") != "0" and _installed()


def _frame_without_source(frame: Any, context: int = 1) -> Any:
    """Result of `inspect.getframeinfo` for a frame, without the source.

    Taichi searches the source to see whether its own kernels are defined in a class. None is, and without source it
    finds that, too.
    """
    return inspect.Traceback(frame.f_code.co_filename, frame.f_lineno, frame.f_code.co_name, None, None)


_getframeinfo = inspect.getframeinfo
if ENABLED:
    inspect.getframeinfo = _frame_without_source
try:
    import taichi as ti
finally:
    inspect.getframeinfo = _getframeinfo

ENABLED = ENABLED and tuple(ti.__version__) == VERSION

from taichi.lang import impl, kernel_impl  # noqa: E402
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext  # noqa: E402


def _position(context: Any, node: Any) -> str:
    """File and line of a statement of a kernel, for messages.

    Taichi itself formats the source of every expression of every kernel here, in case a message needs it.
    """
    return f'File "{context.file}", line {node.lineno + context.lineno_offset}, in {context.func.func.__name__}:\n'


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


def source_text(function: Any) -> str:
    """Text of a kernel or a function of one, as Taichi is given it."""
    return _source(function)[3]


# Whether a kernel's loops on one thread are given a group of two threads, of which the second is idle. Set before
# kernels are compiled.
group_serial_loops = [False]


def _group_serial_loops(function: Any, known: dict[str, Any]) -> None:
    """Change the loops of a kernel after ``ti.loop_config(serialize=True)``, see `group_serial_loops`."""
    body = function.body
    for k in range(len(body) - 1):
        call = body[k].value if isinstance(body[k], ast.Expr) else None
        if isinstance(call, ast.Call) and isinstance(body[k + 1], ast.For):
            option = {word.arg: word.value for word in call.keywords}.get("serialize")
            if option is not None and eval(ast.unparse(option), {}, known):
                grouped = ast.parse("ti.loop_config(block_dim=2)\nfor _lane in range(1): pass").body
                grouped[1].body = [body[k + 1]]  # type: ignore[attr-defined]
                body[k : k + 2] = grouped
    ast.fix_missing_locations(function)


def _tree_and_context(
    self: Any,
    excluded_parameters: Any = (),
    is_kernel: bool = True,
    arg_features: Any = None,
    args: Any = None,
    ast_builder: Any = None,
    is_real_function: bool = False,
) -> tuple[ast.Module, Any]:
    """Repeat Taichi's work at each call of a function in a kernel, with the source looked up once."""
    file, lines, first, text = _source(self.func)
    tree = ast.parse(text)
    tree.body[0].decorator_list = []  # type: ignore[attr-defined]
    known = kernel_impl._get_global_vars(self.func)
    if is_kernel or is_real_function:
        known.update({self.arguments[i].name: args[i] for i in self.template_slot_locations})
    if is_kernel and group_serial_loops[0]:
        _group_serial_loops(tree.body[0], known)
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


def _in_class(level_of_class_stackframe: int) -> bool:
    """Whether a kernel is defined in a class; Taichi reads the source around it to find that out."""
    return "__qualname__" in sys._getframe(level_of_class_stackframe - 1).f_locals


def _with_bundles(tree_and_context: Callable[..., tuple[ast.Module, Any]]) -> Callable[..., tuple[ast.Module, Any]]:
    """Read a kernel with parameters for the fields of its bundles, and the bundles of these as its first variables."""

    def read(self: Any, *given: Any, **options: Any) -> tuple[ast.Module, Any]:
        tree, context = tree_and_context(self, *given, **options)
        bundles = getattr(self.func, "__bundles__", None)
        if bundles:
            function: Any = tree.body[0]
            function.args.args = [ast.arg(each.name) for each in self.arguments]
            context.global_vars.update({f"{name}__": bundle for name, bundle in bundles.items()}, __static=ti.static)
            made = [
                f"{name} = __static({name}__({', '.join(f'{name}__{f}' for f in bundles[name]._fields)}))"
                for name in bundles
            ]
            function.body[:0] = ast.parse("\n".join(made)).body
            ast.fix_missing_locations(function)
        return tree, context

    return read


kernel_impl._get_tree_and_ctx = _with_bundles(_tree_and_context if ENABLED else kernel_impl._get_tree_and_ctx)
if ENABLED:
    ASTTransformerContext.get_pos_info = _position
    kernel_impl._inside_class = _in_class


def running_threads() -> int:
    """Number of CPU threads of Taichi, which the environment may change."""
    return int(impl.current_cfg().cpu_max_num_threads)


def default_real() -> Any:
    """Taichi's type of reals whose precision a kernel does not name."""
    return impl.current_cfg().default_fp


def program() -> Any:
    """Taichi's runtime, None where it has not been started."""
    return impl.pytaichi.prog


def cache_folder() -> Path:
    """Folder of Taichi's compiled kernels, which the environment may change."""
    return Path(os.environ.get("TI_OFFLINE_CACHE_FILE_PATH") or impl.default_cfg().offline_cache_file_path)


def compiled_for() -> str:
    """All of Taichi's settings that machine code may depend on, but the number of threads, and its version."""
    config = impl.current_cfg()
    others = ("offline_cache", "print_", "verbose", "num_compile_threads", "cpu_max_num_threads")
    names = [name for name in dir(config) if not name.startswith(("_", *others))]
    values = [getattr(config, name) for name in names]
    settings = [f"{name} {getattr(v, 'to_string', v.__str__)()}" for name, v in zip(names, values, strict=True)]
    return "\n".join([*map(str, ti.__version__), str(ti._lib.core.get_commit_hash()), *settings])


def intermediate_code(kernel: Any, arguments: Sequence[Any], shares: int) -> tuple[str, str]:
    """A kernel in LLVM's language, as Taichi gives it to LLVM, and Taichi's description of its arguments and tasks.

    Its parallel loops are divided into ``shares``, with at least 512 iterations each; for Taichi itself this is the
    number of threads.
    """
    primal, config = kernel._primal, impl.current_cfg()
    config.cpu_max_num_threads, threads = shares, config.cpu_max_num_threads
    try:
        compiled = primal.compiled_kernels[primal.ensure_compiled(*arguments)]
        builder = program().make_aot_module_builder(ti.cpu, [])
        builder.add("kernel", compiled)
    finally:
        config.cpu_max_num_threads = threads
    with tempfile.TemporaryDirectory(prefix="tipfem-kernel-") as folder:
        builder.dump(folder, "")
        return (Path(folder) / "kernel.ll").read_text(), (Path(folder) / "metadata.json").read_text()


def on_host() -> bool:
    """Whether device arrays are in host memory, where `host_view` can read and write them."""
    return ENABLED and bool(impl.current_cfg().arch == ti.cpu)


C_TYPES: dict[Any, Any] = {
    ti.i8: ctypes.c_int8,
    ti.i32: ctypes.c_int32,
    ti.f32: ctypes.c_float,
    ti.f64: ctypes.c_double,
}


def host_view(array: Any) -> np.ndarray:
    """A NumPy view of a device array in host memory, made once; it must not outlive the array."""
    view: np.ndarray | None = array.__dict__.get("_host_view")
    if view is None:
        address = program().get_ndarray_data_ptr_as_int(array.arr)
        flat: np.ndarray = np.ctypeslib.as_array((C_TYPES[array.dtype] * math.prod(array.shape)).from_address(address))
        view = array.__dict__["_host_view"] = np.asarray(flat.reshape(array.shape))
    return view


def address(array: Any) -> int:
    """Address of an array's values, as from its ``ctypes.data``, in a quarter of the time where possible."""
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))
    except (TypeError, ValueError, BufferError):  # not contiguous, read-only, or empty
        if not array.flags.c_contiguous:
            raise ValueError(f"an array of shape {array.shape} is not C-contiguous") from None
        return int(array.ctypes.data)


class PreparedLaunch:
    """A kernel compiled for some arguments, with the work that all its launches share done once.

    On the host, one launch context serves every launch and holds the device arrays. Numbers and C-contiguous NumPy
    arrays of the same types may differ between launches; templates are part of the compiled kernel. ``program`` is the
    runtime it was compiled for.
    """

    def __init__(self, kernel: Any, arguments: Sequence[Any]) -> None:
        primal = kernel._primal
        self.program = program()
        self._compiled = primal.compiled_kernels[primal.ensure_compiled(*arguments)]
        caps = self.program.get_device_caps()
        self._data = self.program.compile_kernel(self.program.config(), caps, self._compiled)
        self._returns = primal.return_type[0] if primal.return_type is not None else None
        self._construct = primal.construct_kernel_ret
        self._device: list[tuple[tuple[int], int]] = []
        self._host: list[tuple[tuple[int], int]] = []
        self._reals: list[tuple[tuple[int], int]] = []
        self._integers: list[tuple[tuple[int], int]] = []
        slot = 0
        for i, (parameter, value) in enumerate(zip(primal.arguments, arguments, strict=True)):
            kind = parameter.annotation
            if isinstance(kind, ti.template):
                continue
            if isinstance(value, ti.Ndarray):
                self._device.append(((slot,), i))
            elif isinstance(value, np.ndarray):
                self._host.append(((slot,), i))
            else:
                (self._reals if kind in (float, ti.f32, ti.f64) else self._integers).append(((slot,), i))
            slot += 1
        self._context: Any = None
        if on_host():
            self._context = self._compiled.make_launch_context()
            for place, i in self._device:
                values = host_view(arguments[i])
                self._context.set_arg_external_array_with_shape(
                    place, values.ctypes.data, values.nbytes, values.shape, 0
                )

    def __call__(self, arguments: Sequence[Any]) -> Any:
        """Start the kernel; what it returns."""
        context = self._context
        if context is None:
            context = self._compiled.make_launch_context()
            for slot, i in self._device:
                context.set_arg_ndarray(slot, arguments[i].arr)
        for slot, i in self._reals:
            context.set_arg_float(slot, arguments[i])
        for slot, i in self._integers:
            context.set_arg_int(slot, arguments[i])
        for slot, i in self._host:
            values = arguments[i]
            context.set_arg_external_array_with_shape(slot, address(values), values.nbytes, values.shape, 0)
        self.program.launch_kernel(self._data, context)
        if self._returns is None:
            return None
        if self._context is None:
            ti.sync()
        return self._construct(context, self._returns, (0,))

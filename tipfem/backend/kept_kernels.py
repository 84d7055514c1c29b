"""The library of kernels: their machine code is kept on disk, so that a start need not make it again.

At a start without it, Taichi reads every kernel's source, traces it in Python, and has LLVM make machine code: seconds,
every time. Here the machine code is kept in the folder ``tipfem`` beside Taichi's own cache, a file for each kernel and
each kind of arguments. A file is found by all that its code follows from: the texts that `fingerprint` collects, the
kinds of the arguments and the values of templates; and in a folder for the kind of processor, Taichi's version and
settings, precision among them. Loops are divided into as many shares for any number of threads, up to `SHARES`, so that
all use the same file. A kernel that is not there is compiled by Taichi to LLVM's language, by llvmlite to machine code,
and added. What cannot be kept, or where llvmlite is missing, is launched by Taichi.

Wheels have such files, too, in the folder `SHIPPED`, made by ``tipfem compile``: then the first start compiles nothing.

The code is the same for all processors with the instructions of x86-64-v3. Results are the same bit by bit on all, and
those of Taichi's code; the environment variable ``TIPFEM_KERNELS=taichi`` switches the library off.
"""

import ctypes
import hashlib
import logging
import os
import platform
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import taichi as ti

from tipfem.backend import kernel_files, taichi_patches
from tipfem.backend.fingerprint import NotKeptError, describe, fingerprint
from tipfem.backend.host_kernels import Compiler
from tipfem.backend.kernel_files import UntrustedError
from tipfem.backend.machine_code import Machine, UnsuitableError, one_function, threads_text
from tipfem.backend.quick_launch import ARRAY, KINDS, Plan
from tipfem.backend.taichi_patches import address, host_view, program
from tipfem.logs import log

SWITCH = "TIPFEM_KERNELS"
CHOICES = ("library", "taichi")
SHIPPED = Path(__file__).with_name("kernels")
# Into how many a loop is divided; into as many as there are threads, if these are more.
SHARES = 32
_NUMBERS = {"i32": ctypes.c_int32, "f32": ctypes.c_float, "f64": ctypes.c_double}


def chosen() -> bool:
    """Whether kernels are to be kept; `ValueError` if the variable is neither "library" nor "taichi"."""
    choice = os.environ.get(SWITCH) or "library"
    if choice not in CHOICES:
        raise ValueError(f"{SWITCH} is {choice!r}; it must be one of {list(CHOICES)}")
    return choice == "library" and taichi_patches.ENABLED


class KeptLaunch:
    """A kernel of the library, prepared for some arguments; it is used as `taichi_patches.PreparedLaunch`.

    ``start`` calls the machine code that ``machine`` has loaded, with the arguments at ``places``, no templates; by
    ``plan`` `Machine.quick_launch` does so, if that is possible, in the runtime ``program``.
    """

    def __init__(
        self,
        start: Callable[[int], None],
        machine: Machine,
        description: dict[str, Any],
        places: Sequence[int],
        arguments: Sequence[Any],
    ) -> None:
        self.program = program()
        self._start = start
        self._values = _layout(description["parameters"])()
        self._context, self._result = machine.context(self._values)
        self._at = ctypes.addressof(self._context)
        returns = description["returns"]
        self._returned: Any = _NUMBERS[returns].from_buffer(self._result) if returns else None
        self._host: list[tuple[int, Any, Any]] = []
        self._numbers: list[tuple[int, Any]] = []
        at: list[tuple[int, int, int] | None] = [None] * len(arguments)
        for k, (i, kind) in enumerate(zip(places, description["parameters"], strict=True)):
            if kind in _NUMBERS:
                offset = getattr(type(self._values), f"arg_{k}").offset
                self._numbers.append((i, _NUMBERS[kind].from_buffer(self._values, offset)))
                at[i] = KINDS[kind], ctypes.addressof(self._values) + offset, 0
                continue
            entry, value = getattr(self._values, f"arg_{k}"), arguments[i]
            if isinstance(value, np.ndarray):
                self._host.append((i, entry, entry.shape))
                at[i] = ARRAY, ctypes.addressof(entry) + type(entry).data.offset, ctypes.addressof(entry.shape)
            else:
                entry.shape[:] = value.shape
                entry.data = host_view(value).ctypes.data
        self.quick, self.plan = machine.quick_launch, 0
        if self.quick is not None:
            # Templates are kept, so that no other object takes their place in memory; arrays are told when they go.
            self._templates = [value for i, value in enumerate(arguments) if i not in places]
            code = ctypes.cast(start, ctypes.c_void_p).value or 0  # type: ignore[arg-type]
            self._plan = Plan(arguments, at, code, self._at)
            self.plan = self._plan.at

    def __call__(self, arguments: Sequence[Any]) -> Any:
        """Start the kernel; what it returns."""
        for i, number in self._numbers:
            number.value = arguments[i]
        for i, entry, shape in self._host:
            values = arguments[i]
            entry.data = address(values)
            shape[:] = values.shape
        self._start(self._at)
        return self.returned()

    def returned(self) -> Any:
        """Value that the kernel returned at its last start."""
        return None if self._returned is None else self._returned.value


def _layout(parameters: Sequence[str]) -> type[ctypes.Structure]:
    """The structure in which Taichi's kernels find their arguments."""
    fields: list[tuple[str, Any]] = []
    for k, kind in enumerate(parameters):
        if kind in _NUMBERS:
            fields.append((f"arg_{k}", _NUMBERS[kind]))
        else:
            inner = [("shape", ctypes.c_int32 * int(kind.removeprefix("array "))), ("data", ctypes.c_void_p)]
            fields.append((f"arg_{k}", type("Array", (ctypes.Structure,), {"_fields_": inner})))
    return type("Arguments", (ctypes.Structure,), {"_fields_": fields})


class Library:
    """The kernels that are kept for this kind of processor and Taichi's present settings.

    They are in ``folder``, in one for each environment; ``threads`` share loops, and ``compiler`` makes machine code
    where Taichi does not run on the processor here. `UnsuitableError` if llvmlite or the compiler will not do,
    `UntrustedError` if others can write to the folder, `OSError` if it cannot be made.
    """

    def __init__(self, folder: Path, threads: int, compiler: Compiler | None = None) -> None:
        self._machine, self._shares, self._compiler = Machine(), max(SHARES, threads), compiler
        text = threads_text()
        system = f"{platform.system()} {platform.machine()}, {self._shares} shares"
        settings = compiler.settings() if compiler else taichi_patches.compiled_for()
        everything = "\n".join([system, self._machine.name, settings, text])
        self._environment = hashlib.sha256(everything.encode()).hexdigest()
        kernel_files.own_folder(folder)
        self._folder = folder / self._environment[:16]
        kernel_files.own_folder(self._folder)
        shipped = SHIPPED / self._folder.name
        self._folders = {shipped: True, self._folder: False} if shipped.is_dir() else {self._folder: False}
        self._loaded: dict[str, tuple[Callable[[int], None], dict[str, Any]]] = {}
        # As in Taichi, a process takes the constants that a kernel reads when it is first prepared for such arguments.
        self._texts: dict[Any, str] = {}
        self._added = self._ignored = self._unwritten = False
        _, code = self._kept("threads", lambda: ({}, self._machine.compile(text)))
        self._machine.start_threads(code, threads)

    def prepare(self, kernel: Any, kinds: Sequence[Any], arguments: Sequence[Any]) -> KeptLaunch | None:
        """A kernel, as `ti.kernel` returns it, from the library, which it is added to; None if it cannot be kept."""
        function = kernel._primal.func
        if self._compiler and not on_host(kinds, arguments):
            return None
        try:
            parameters, texts = [], []
            for kind, value in zip(kinds, arguments, strict=True):
                text, parameter = _kind(kind, value)
                texts.append(text)
                parameters.append(parameter)
            given = function, *texts
            if given not in self._texts:
                self._texts[given] = fingerprint(function)
            texts.insert(0, self._texts[given])
            number = hashlib.sha256("\n".join(texts).encode()).hexdigest()[:40]
            places = [i for i, parameter in enumerate(parameters) if parameter]
            known = self._loaded.get(number)
            if known is None:
                name = f"{function.__name__}-{number}"
                entry = f"kernel_{number}"
                used = [parameter for parameter in parameters if parameter]
                if self._compiler and not any((folder / name).exists() for folder in self._folders):
                    self._compiler.add(kernel, arguments)
                description, code = self._kept(name, lambda: self._make(kernel, arguments, used, entry))
                (at,) = self._machine.load(code, entry)
                known = self._loaded[number] = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(at), description
            return KeptLaunch(known[0], self._machine, known[1], places, arguments)
        except (NotKeptError, UnsuitableError) as error:
            message = f"kernel {function.__name__} is not kept and starts slowly: {error}"
            log(logging.DEBUG, "kernels", message)
            return None

    def _kept(self, name: str, make: Callable[[], tuple[dict[str, Any], bytes]]) -> tuple[dict[str, Any], bytes]:
        """The description and the machine code in a file, which is made if it is not there or not trusted."""
        for folder, shipped in self._folders.items():
            try:
                found = kernel_files.read(folder / name, self._environment, shipped=shipped)
                if found is not None:
                    return found
            except UntrustedError as error:
                # One line for all: a damaged folder has a hundred of them.
                more = "" if self._ignored else "; so are others like it"
                level = logging.DEBUG if self._ignored else logging.WARNING
                log(level, "warning", f"{folder / name} is ignored, and made anew: {error}{more}")
                self._ignored = True
        made, path = make(), self._folder / name
        try:
            kernel_files.write(path, self._environment, *made)
            if not self._added:
                self._added = True
                kernel_files.remove_oldest(self._folder.parent)
        except OSError as error:
            level = logging.DEBUG if self._unwritten else logging.WARNING
            more = "" if self._unwritten else "; nor others there"
            log(level, "warning", f"{path} cannot be written: {error.strerror}{more}")
            self._unwritten = True
        return made

    def _make(
        self, kernel: Any, arguments: Sequence[Any], parameters: list[str], entry: str
    ) -> tuple[dict[str, Any], bytes]:
        """Description and machine code of a kernel; `UnsuitableError` if it needs more than there is here."""
        if self._compiler:
            raise UnsuitableError("it is not what the process that compiles kernels has made")
        text, about = taichi_patches.intermediate_code(kernel, arguments, self._shares)
        about = re.sub(r"\s", "", about)
        tasks = re.findall(r'"name":"(\w+_kernel_\d+_\w+)"', about)
        offsets = {int(k): int(offset) for k, offset in re.findall(r'"name":"arg_(\d+)","offset":(\d+)', about)}
        layout = _layout(parameters)
        if offsets != {k: getattr(layout, f"arg_{k}").offset for k in range(len(parameters))}:
            raise UnsuitableError("its arguments are placed otherwise than expected")
        if '"needs_grad":true' in about:
            raise UnsuitableError("it has gradients")
        returns = [_number(kind) for kind in kernel._primal.return_type or ()]
        if len(returns) > 1 or any(kind not in _NUMBERS for kind in returns):
            raise UnsuitableError(f"it returns {', '.join(returns)}")
        code = self._machine.compile(one_function(text, tasks, entry))
        returned = returns[0] if returns else None
        return {"parameters": parameters, "returns": returned}, code


def _kind(annotation: Any, value: Any) -> tuple[str, str]:
    """All of an argument that machine code depends on, and how it is passed, empty for templates; or `NotKeptError`."""
    if isinstance(annotation, ti.template):
        return describe(value), ""
    if isinstance(annotation, ti.types.ndarray):
        if isinstance(value, np.ndarray) and value.dtype.isnative and value.dtype.kind in "if":
            return f"{value.dtype.kind}{8 * value.dtype.itemsize} {value.ndim}", f"array {value.ndim}"
        if type(value) is ti.ScalarNdarray and value.grad is None:
            return f"{value.dtype.to_string()} {len(value.shape)}", f"array {len(value.shape)}"
        raise NotKeptError(f"an argument is {type(value).__name__}")
    kind = _number(annotation)
    if kind not in _NUMBERS:
        raise NotKeptError(f"a parameter is {kind}")
    return kind, kind


def _number(annotation: Any) -> str:
    """The name of a number's type, from the annotation of a parameter or of what is returned."""
    if annotation is float:
        annotation = taichi_patches.default_real()
    return "i32" if annotation is int else str(getattr(annotation, "to_string", annotation.__repr__)())


_library: list[Library] = []


def start(threads: int, compiler: Compiler | None = None) -> None:
    """Open the library; where that is not possible, one line in the log says why, and Taichi launches all kernels.

    Where Taichi runs on a GPU, it needs a ``compiler``, and as many ``threads`` share loops as `SHARES` do.
    """
    try:
        _library.append(Library(taichi_patches.cache_folder() / "tipfem", threads, compiler))
    except (UnsuitableError, UntrustedError, OSError) as error:
        slower = "the GPU runs all of them" if compiler else "every start takes longer"
        log(logging.INFO, "kernels", f"kernels are not kept, and {slower}: {error}")


def open_library() -> bool:
    """Whether kernels are kept in this process."""
    return bool(_library)


def on_host(kinds: Sequence[Any], arguments: Sequence[Any]) -> bool:
    """Whether a kernel has arrays, and all are in the host's memory: the processor runs it also beside a GPU."""
    arrays = [value for kind, value in zip(kinds, arguments, strict=True) if isinstance(kind, ti.types.ndarray)]
    return bool(arrays) and all(type(value) is np.ndarray for value in arrays)


def kept() -> int:
    """Number of kernels that this process has loaded from the library, or added to it."""
    return len(_library[0]._loaded) if _library else 0


def prepare(kernel: Any, kinds: Sequence[Any], arguments: Sequence[Any]) -> KeptLaunch | None:
    """A kernel from the library; None where it is switched off, or the kernel cannot be kept."""
    return _library[0].prepare(kernel, kinds, arguments) if _library else None

"""The text that a kernel's machine code follows from: its source, all it calls, and the constants it reads.

Kernels that are kept on disk are found by a hash of that text. It is put together anew for every kernel that is
prepared, from the values that its names have then, as Taichi reads them; only texts of functions are remembered.
"""

import enum
import functools
import types
from typing import Any

import numpy as np
import taichi as ti

from tipfem.backend.taichi_patches import source_text

# Functions and classes of these packages are told by their names; their versions are part of the folder's name.
_KNOWN_PACKAGES = ("builtins", "taichi", "numpy", "math", "itertools", "functools", "typing", "collections")
_DATA_TYPE = type(ti.f64)


class NotKeptError(Exception):
    """A kernel reads a value of which no text says all, so its machine code is not kept."""


def fingerprint(function: Any) -> str:
    """A text that differs wherever the machine code of a kernel, as it is written, may.

    `NotKeptError` if it reads a value that is no number, text, type, function or module.
    """
    described: dict[Any, str] = {}
    _describe_function(function, described)
    return "\n".join(described.values())


@functools.cache
def _names(code: types.CodeType) -> tuple[str, ...]:
    """Names of globals and attributes in a function and the functions inside it."""
    inner = [name for each in code.co_consts if isinstance(each, types.CodeType) for name in _names(each)]
    return tuple(sorted({*code.co_names, *inner}))


def _describe_function(function: types.FunctionType, described: dict[Any, str]) -> None:
    if function in described:
        return
    described[function] = ""  # for functions that call each other
    code, lines = function.__code__, [source_text(function)]
    names = _names(code)
    values = dict(zip(code.co_freevars, (cell.cell_contents for cell in function.__closure__ or ()), strict=True))
    values.update((name, function.__globals__[name]) for name in names if name in function.__globals__)
    values.update(_attributes(values.values(), names))
    for name, value in (*values.items(), *function.__annotations__.items(), ("", function.__defaults__)):
        lines.append(f"{name} = {describe(value, described)}")
    described[function] = "\n".join(lines)


def _attributes(values: Any, names: tuple[str, ...]) -> dict[str, Any]:
    """Attributes that a function may read, from modules and classes among the values that it reads."""
    found = {}
    for value in values:
        if isinstance(value, (types.ModuleType, type)) and not _known(value):
            read = [name for name in names if name in vars(value) and name not in getattr(value, "_fields", ())]
            own = {f"{value.__name__}.{name}": vars(value)[name] for name in read}
            found.update(own)
            found.update(_attributes(own.values(), names))
    return found


def _known(value: Any) -> bool:
    """Whether a module, class or function is of a package that does not change."""
    owner = value.__name__ if isinstance(value, types.ModuleType) else getattr(value, "__module__", None) or "builtins"
    return owner.partition(".")[0] in _KNOWN_PACKAGES


def describe(value: Any, described: dict[Any, str] | None = None) -> str:
    """A text that differs wherever the value does.

    Args:
        value: what a kernel reads.
        described: texts of functions, to which those that the value calls are added.

    Raises:
        NotKeptError: no text says all of it.
    """
    functions = {} if described is None else described
    if value is None or isinstance(value, (bool, int, float, str, np.generic)):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, (tuple, list)):
        return f"({', '.join(describe(each, functions) for each in value)})"
    if isinstance(value, _DATA_TYPE):
        return f"taichi {value.to_string()}"
    if isinstance(value, ti.types.ndarray):
        return f"array {describe((value.dtype, value.ndim), functions)}"
    if isinstance(value, ti.template):
        return "template"
    if isinstance(value, types.GenericAlias):
        return repr(value)
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, types.ModuleType):
        return f"module {value.__name__}"
    if isinstance(value, types.FunctionType) and not _known(value):
        inner = getattr(value, "__wrapped__", value)
        _describe_function(inner, functions)
        return f"function {inner.__module__}.{inner.__qualname__}"
    if isinstance(value, type) and issubclass(value, enum.Enum):
        return f"{value.__name__} {describe([(each.name, each.value) for each in value], functions)}"
    if isinstance(value, type) and hasattr(value, "_field_defaults"):  # a named tuple, which groups a kernel's arrays
        own = [each for each in vars(value).values() if getattr(each, "__module__", None) == value.__module__]
        fields: Any = value
        return f"{value.__name__} {describe([fields._fields, *fields._field_defaults.items(), *own], functions)}"
    if isinstance(value, (type, types.FunctionType, types.BuiltinFunctionType, np.ufunc)) and _known(value):
        return f"{type(value).__name__} {getattr(value, '__qualname__', repr(value))}"
    raise NotKeptError(f"{type(value).__name__} {value!r}")

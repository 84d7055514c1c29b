"""Types of the arrays that kernels take: element type and number of axes.

The reals' precision is chosen when Taichi is started, after the kernels have been defined, and a kernel may be given
device arrays in single precision beside NumPy arrays in double precision. So the types of reals name no precision: a
kernel is compiled for the arrays it is given. Taichi checks the number of axes of device arrays only; `launch` checks
all arrays, the first time that a kernel is given arrays of that kind.
"""

from typing import TYPE_CHECKING, Any

import taichi as ti

if TYPE_CHECKING:  # Taichi's types are values, which type checkers do not accept as types
    from typing import TypeAlias

    Array1: TypeAlias = Any
    Array2: TypeAlias = Any
    Reals1: TypeAlias = Any
    Reals2: TypeAlias = Any
    Ints1: TypeAlias = Any
    Ints2: TypeAlias = Any
    Longs1: TypeAlias = Any
    Flags1: TypeAlias = Any
    Flags2: TypeAlias = Any
    Periods: TypeAlias = Any
    Template: TypeAlias = Any
else:
    Array1 = ti.types.ndarray(ndim=1)  # of any kind
    Array2 = ti.types.ndarray(ndim=2)
    Reals1 = ti.types.ndarray(ndim=1)
    Reals2 = ti.types.ndarray(ndim=2)
    Ints1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
    Ints2 = ti.types.ndarray(dtype=ti.i32, ndim=2)
    Longs1 = ti.types.ndarray(dtype=ti.i64, ndim=1)
    Flags1 = ti.types.ndarray(dtype=ti.i8, ndim=1)
    Flags2 = ti.types.ndarray(dtype=ti.i8, ndim=2)
    Periods = ti.types.ndarray()  # see `tipfem.backend.periodic`
    Template = ti.template()


def mismatch(annotation: Any, array: Any) -> str:
    """Why a device array or one of NumPy does not fit a parameter of such a type; an empty string if it does."""
    kind = str(array.dtype)  # of either: Taichi's f64, i32, ...; NumPy's float64, int32, ...
    number = len(array.shape)
    if annotation.ndim is not None and annotation.ndim != number:
        return f"has {number} axes instead of {annotation.ndim}"
    if annotation in (Reals1, Reals2) and not kind.startswith("f"):
        return f"is of {kind} instead of reals"
    return ""

"""Types of the arrays that kernels take: what they hold, and how many axes they have.

The reals' precision is chosen when Taichi is started, after the kernels have been defined, and a kernel may be given
device arrays in single precision beside NumPy arrays in double precision. So the types of reals name no precision: a
kernel is compiled for what it is given. Taichi looks at the axes of device arrays only; `launch` looks at all arrays,
when it sees a kernel with such arrays for the first time.
"""

from typing import TYPE_CHECKING, Any

import taichi as ti

if TYPE_CHECKING:  # Taichi's types are values, which type checkers do not take for types
    from typing import TypeAlias

    Array1: TypeAlias = Any
    Array2: TypeAlias = Any
    Reals1: TypeAlias = Any
    Reals2: TypeAlias = Any
    Ints1: TypeAlias = Any
    Ints2: TypeAlias = Any
    Flags1: TypeAlias = Any
    Template: TypeAlias = Any
else:
    Array1 = ti.types.ndarray(ndim=1)  # of any kind
    Array2 = ti.types.ndarray(ndim=2)
    Reals1 = ti.types.ndarray(ndim=1)
    Reals2 = ti.types.ndarray(ndim=2)
    Ints1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
    Ints2 = ti.types.ndarray(dtype=ti.i32, ndim=2)
    Flags1 = ti.types.ndarray(dtype=ti.i8, ndim=1)
    Template = ti.template()


def mismatch(annotation: Any, array: Any) -> str:
    """What is wrong with an array for a parameter of such a type; nothing if it is right.

    Args:
        annotation: one of the types above, or of Taichi's.
        array: a device array or a NumPy array.
    """
    kind = str(array.dtype)  # of either: Taichi's f64, i32, ...; NumPy's float64, int32, ...
    number = len(array.shape)
    if annotation.ndim is not None and annotation.ndim != number:
        return f"has {number} axes instead of {annotation.ndim}"
    if annotation in (Reals1, Reals2) and not kind.startswith("f"):
        return f"is of {kind} instead of reals"
    return ""

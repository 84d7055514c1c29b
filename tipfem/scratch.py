"""Memory of arrays that are needed for a moment in each step."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_memory: dict[str, NDArray[Any]] = {}  # bytes by the name of the array
_last: dict[str, tuple[Any, Any, NDArray[Any]]] = {}  # shape, type and array that were given last


def scratch(name: str, shape: int | tuple[int, ...], kind: Any = np.float64) -> NDArray[Any]:
    """An array whose values are undefined, and lost when `scratch` is called with its name again.

    Args:
        name: the array's name, that of its only user; its memory is kept for the next call.
        shape: of the array.
        kind: type of its values.
    """
    last = _last.get(name)
    if last is not None and last[0] == shape and last[1] is kind:
        return last[2]
    size = math.prod(shape) if isinstance(shape, tuple) else shape
    needed = size * np.dtype(kind).itemsize
    memory = _memory.get(name)
    if memory is None or len(memory) < needed:
        memory = _memory[name] = np.empty(needed + needed // 8, dtype=np.uint8)
    array = np.asarray(memory[:needed].view(kind).reshape(shape))
    _last[name] = shape, kind, array
    return array


def copied(values: NDArray[Any], name: str, kind: Any = None) -> NDArray[Any]:
    """A copy of an array, of a type of its own if one is given, in the memory of that name; see `scratch`."""
    result = scratch(name, values.shape, values.dtype.type if kind is None else kind)
    result[...] = values
    return result


def filled(value: float, name: str, shape: int | tuple[int, ...], kind: Any = np.float64) -> NDArray[Any]:
    """An array whose values are all the same, in the memory of that name; see `scratch`."""
    result = scratch(name, shape, kind)
    result.fill(value)
    return result

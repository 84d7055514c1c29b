"""Memory of arrays that are needed for a moment in each step."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_memory: dict[str, NDArray[Any]] = {}  # bytes by the name of the array


def scratch(name: str, shape: int | tuple[int, ...], kind: Any = np.float64) -> NDArray[Any]:
    """An array whose values are undefined, and lost when `scratch` is called with its name again.

    Args:
        name: the array's name, that of its only user; its memory is kept for the next call.
        shape: of the array.
        kind: type of its values.
    """
    size = math.prod(shape) if isinstance(shape, tuple) else shape
    needed = size * np.dtype(kind).itemsize
    memory = _memory.get(name)
    if memory is None or len(memory) < needed:
        memory = _memory[name] = np.empty(needed + needed // 8, dtype=np.uint8)
    return np.asarray(memory[:needed].view(kind).reshape(shape))

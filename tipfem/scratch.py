"""Memory of arrays of each step: those of a moment by name, others until nothing holds them any more."""

import math
from sys import getrefcount
from typing import Any

import numpy as np
from numpy.typing import NDArray

_memory: dict[str, NDArray[Any]] = {}  # bytes by the name of the array
_last: dict[str, tuple[Any, Any, NDArray[Any]]] = {}  # shape, type and array that were given last

SMALL = 1 << 13  # bytes below which memory is NumPy's own: it keeps small pieces itself
KEPT = 32  # pieces of memory of one size; steps hold up to 18

_pieces: dict[int, list[NDArray[Any]]] = {}  # by their size, in the order of their age


def _holders(pieces: list[NDArray[Any]]) -> list[int]:
    """Numbers of those that hold each of these pieces; `ALONE` where only the list does."""
    return [getrefcount(piece) for piece in pieces]


ALONE = _holders([np.empty(0)])[0]


def owned(shape: int | tuple[int, ...], kind: Any = np.float64) -> NDArray[Any]:
    """An array whose values are undefined, like `numpy.empty`, in memory that an array had which is gone.

    So states that follow each other take turns, and one that somebody holds keeps its memory: each view of it counts as
    one who holds the whole piece.
    """
    needed = (math.prod(shape) if isinstance(shape, tuple) else shape) * np.dtype(kind).itemsize
    if needed < SMALL:
        return np.empty(shape, dtype=kind)
    room = 1 << (needed.bit_length() - 4)  # an eighth: some cells more change nothing
    room *= -(-needed // room)
    pieces = _pieces.setdefault(room, [])
    holders = _holders(pieces)
    if ALONE in holders:
        memory = pieces[holders.index(ALONE)]
    else:
        memory = np.empty(room, dtype=np.uint8)
        pieces[:] = [*pieces[1 - KEPT :], memory]  # whoever holds the oldest one keeps it
    return np.asarray(np.ndarray(shape, dtype=kind, buffer=memory))


def scratch(name: str, shape: int | tuple[int, ...], kind: Any = np.float64) -> NDArray[Any]:
    """An array whose values are undefined, and lost when `scratch` is called with its name again.

    Args:
        name: the array's name, that of its only user; its memory is kept for the next call. Without one, the array
            is `owned`.
        shape: of the array.
        kind: type of its values.
    """
    if not name:
        return owned(shape, kind)
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


def copied(values: NDArray[Any], name: str = "", kind: Any = None) -> NDArray[Any]:
    """A copy of an array, of a type of its own if one is given, in the memory of that name; see `scratch`."""
    result = scratch(name, values.shape, values.dtype.type if kind is None else kind)
    result[...] = values
    return result


def picked(values: NDArray[Any], index: NDArray[Any], name: str = "") -> NDArray[Any]:
    """The rows of an array with numbers (K,) that it has, in the memory of that name; see `scratch`."""
    result = scratch(name, (len(index), *values.shape[1:]), values.dtype.type)
    return values.take(index, axis=0, out=result, mode="clip")


def filled(value: float, name: str, shape: int | tuple[int, ...], kind: Any = np.float64) -> NDArray[Any]:
    """An array whose values are all the same, in the memory of that name; see `scratch`."""
    result = scratch(name, shape, kind)
    result.fill(value)
    return result

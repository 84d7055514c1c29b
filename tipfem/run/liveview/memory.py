"""The latest state of a run, in memory that two processes share: two slots, one of which is whole at any time.

A file without a name, whose descriptor the second process inherits, is mapped into both. It begins with a header of
64-bit numbers; the slots follow, each with three such numbers, a head in JSON, and arrays. The writer marks a slot as
being written, fills it, and counts it as published; the reader copies the slot published last, and takes the copy if
the marks say that it was not written meanwhile.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import tempfile
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tipfem.case.rheology import WIDTH
from tipfem.results.fields.catalogue import STORED
from tipfem.typing import Array

_MAGIC = 0x7469_7066_656D_0006  # "tipfem", and the version of the layout
_HEADER = 4096  # bytes
# Numbers of the header.
_VERSION, _PUBLISHED, _WANTED, _ENDED, _PAUSED, _SIZE = range(6)
_MARKS = 24  # bytes of the numbers of a slot: whether it is written, the sizes of the head and of all that follows
_TRIES = 10  # to copy a slot that is written meanwhile


@dataclass(frozen=True)
class Snapshot:
    """A state of a run, as it is drawn."""

    step: int  # number of steps taken
    time: float  # [s]
    gravity: tuple[float, ...]  # (d,) [m/s^2]
    speed: float  # steps per second by the clock
    pace: float  # simulated seconds per second
    position: Array  # (N, d) of the particles [m], float64
    velocity: Array  # (N, d) [m/s], float32
    pressure: Array  # (N,) [Pa], float32
    fluid: Array  # (N,) int32
    wall: Array  # (N,) int8
    cells: Array  # (M, d + 1) int32
    cell_fluid: Array | None  # (M,) int32; None where interfaces run through cells
    # (B, 3) of what is rigid and, last, of the tank: position x, y of the reference point [m] and angle [rad],
    # float64; in 3-D the tank has two rows
    poses: Array
    # (F, `tipfem.case.rheology.WIDTH`) of the viscosities, see `tipfem.case.fluid.law_table`, float64; no rows where no
    # fluid follows a law
    laws: Array = field(default_factory=lambda: np.empty((0, WIDTH)))
    shut: tuple[int, ...] = ()  # numbers of the valves that are closed, below 63


# Types of the arrays of a state that are sent.
TYPES = {"position": "f8", "poses": "f8", "laws": "f8", "cells": "i4", "cell_fluid": "i4"}
TYPES |= {name: kind.stream for name, kind in STORED.items() if kind.stream}


def _packed(state: Snapshot) -> list[bytes]:
    """A state as a head in JSON and arrays one after the other, see `_unpacked`."""
    rest = dict(vars(state))
    arrays = {name: np.asarray(rest.pop(name), TYPES[name]) for name in TYPES if rest[name] is not None}
    head = json.dumps([rest, [(name, array.shape) for name, array in arrays.items()]], default=lambda one: one.item())
    return [head.encode(), *(array.tobytes() for array in arrays.values())]


def _unpacked(text: bytes, place: int) -> Snapshot:
    """The state of `_packed`, whose head has ``place`` bytes."""
    rest: dict[str, Any]
    rest, shapes = json.loads(text[:place])
    for name, shape in shapes:
        array = np.frombuffer(text, TYPES[name], math.prod(shape), place).reshape(shape)
        rest[name], place = array.copy(), place + array.nbytes
    lists = {name: tuple(value) for name, value in rest.items() if isinstance(value, list)}
    return Snapshot(**{**rest, **lists})


class _Flag:
    """A truth value in the header."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __get__(self, memory: StateMemory, kind: type) -> bool:
        return bool(memory._header[self._number])

    def __set__(self, memory: StateMemory, value: bool) -> None:
        memory._header[self._number] = int(value)


class StateMemory:
    """The memory, in the process that runs or in the one that draws; with a ``descriptor``, or new.

    ``wanted``: whether somebody looks, by the process that draws; ``ended``, ``paused``: whether the run has ended, or
    waits.
    """

    wanted, ended, paused = _Flag(_WANTED), _Flag(_ENDED), _Flag(_PAUSED)

    def __init__(self, descriptor: int | None = None) -> None:
        self.descriptor = _anonymous_file() if descriptor is None else descriptor
        if descriptor is None:
            os.ftruncate(self.descriptor, _HEADER)
        self._count = 0
        self._map()
        if descriptor is None:
            self._header[_VERSION] = _MAGIC
        elif self._header[_VERSION] != _MAGIC:
            raise ValueError("the descriptor is none of a run's state")

    def _map(self) -> None:
        self._memory = mmap.mmap(self.descriptor, 0)
        self._header = np.frombuffer(self._memory, dtype=np.int64, count=_HEADER // 8)

    @property
    def published(self) -> int:
        """Number of states published so far."""
        return int(self._header[_PUBLISHED])

    def publish(self, state: Snapshot) -> None:
        """Write a state; the file grows where it has no room for it."""
        head, *arrays = _packed(state)
        size = len(head) + sum(map(len, arrays))
        if _MARKS + size > self._header[_SIZE]:
            self._grow(2 * (_MARKS + size))
        self._count += 1
        marks, place = self._slot(self._count)
        marks[:] = 2 * self._count + 1, len(head), size  # odd: being written
        for part in (head, *arrays):
            self._memory[place : place + len(part)] = part
            place += len(part)
        marks[0] = 2 * self._count
        self._header[_PUBLISHED] = self._count

    def latest(self) -> Snapshot | None:
        """A copy of the state published last; None while there is none."""
        for _ in range(_TRIES):
            number = self.published
            if not number:
                return None
            if _HEADER + 2 * int(self._header[_SIZE]) > len(self._memory):
                self._map()
            marks, place = self._slot(number)
            before, head, size = map(int, marks)
            text = self._memory[place : place + size]
            if before == 2 * number == int(marks[0]):
                return _unpacked(text, head)
        return None

    def close(self) -> None:
        """Close the descriptor; the memory goes with the last process that has it."""
        os.close(self.descriptor)

    def _grow(self, room: int) -> None:
        """Make room, in whole pages; slots move, so nothing counts as published until the next state."""
        room = -(-room // mmap.PAGESIZE) * mmap.PAGESIZE
        self._header[_PUBLISHED] = 0
        os.ftruncate(self.descriptor, _HEADER + 2 * room)
        self._header[_SIZE] = room
        self._map()

    def _slot(self, number: int) -> tuple[Array, int]:
        """Marks of the slot of a state, and the place behind them."""
        start = _HEADER + number % 2 * int(self._header[_SIZE])
        return np.frombuffer(self._memory, dtype=np.int64, count=3, offset=start), start + _MARKS


def _anonymous_file() -> int:
    """A descriptor of a file without a name, in memory where the system has such."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("tipfem-state")
    descriptor, path = tempfile.mkstemp(prefix="tipfem-state-")
    os.unlink(path)
    return descriptor

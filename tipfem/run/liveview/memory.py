"""The latest state of a run, in memory that two processes share: two slots, one of which is whole at any time.

A file without a name, whose descriptor the second process inherits, is mapped into both. It begins with a header of
64-bit numbers; the slots follow. The writer marks a slot as being written, fills it, and counts it as published; the
reader copies the slot published last, and takes the copy if the marks say that it was not written meanwhile.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from dataclasses import dataclass, field

import numpy as np

from tipfem.case.rheology import WIDTH
from tipfem.results.fields.catalogue import STORED
from tipfem.typing import Array

_MAGIC = 0x7469_7066_656D_0005  # "tipfem", and the version of the layout
_HEADER = 4096  # bytes
# Numbers of the header.
_VERSION, _PUBLISHED, _WANTED, _ENDED, _PAUSED, _SIZE = range(6)
_SLOT = 256  # bytes before the arrays of a slot: whole numbers, and reals from the 16th number on
_TRIES = 10  # to copy a slot that is written meanwhile


@dataclass(frozen=True)
class Snapshot:
    """A state of a run, as it is drawn."""

    step: int  # number of steps taken
    time: float  # [s]
    gravity: tuple[float, ...]  # (d,) [m/s^2]
    speed: float  # steps per second by the clock
    pace: float  # simulated seconds per second
    poked: bool  # whether a poke acts
    position: Array  # (N, d) of the particles [m], float64
    velocity: Array  # (N, d) [m/s], float32
    pressure: Array  # (N,) [Pa], float32
    fluid: Array  # (N,) int32
    wall: Array  # (N,) int8
    cells: Array  # (M, d + 1) int32
    cell_fluid: Array | None  # (M,) int32; None where interfaces run through cells
    # (B, 3) of the rigid bodies and, last, of the tank: position x, y of the reference point [m] and angle [rad],
    # float64; none in 3-D
    bodies: Array
    # (F, `tipfem.case.rheology.WIDTH`) of the viscosities, see `tipfem.case.fluid.law_table`, float64; no rows where no
    # fluid follows a law
    laws: Array = field(default_factory=lambda: np.empty((0, WIDTH)))
    shut: tuple[int, ...] = ()  # numbers of the valves that are closed, below 63

    @staticmethod
    def layout(
        particles: int, cells: int, owned: int, bodies: int, laws: int, dimension: int
    ) -> list[tuple[str, str, tuple[int, ...]]]:
        """Names, types and shapes of the arrays of a slot: N particles, M cells, B bodies with the tank, rows of laws.

        ``owned``: whether cells have fluids.
        """
        arrays: list[tuple[str, str, tuple[int, ...]]] = [
            ("position", "f8", (particles, dimension)),
            ("bodies", "f8", (bodies, 3)),
            ("laws", "f8", (laws, WIDTH)),
            *(
                (name, kind.stream, (particles, dimension)[: 1 + kind.vector])
                for name, kind in STORED.items()
                if kind.stream
            ),
            ("cells", "i4", (cells, dimension + 1)),
            *([("cell_fluid", "i4", (cells,))] if owned else []),
        ]
        arrays.sort(key=lambda one: -int(one[1][1:]))  # each begins at a multiple of the size of its numbers
        return arrays


def slot_size(particles: int, cells: int, bodies: int, laws: int = 0, dimension: int = 2) -> int:
    """Bytes that a slot for a number of particles, cells, bodies and laws takes, in whole pages."""
    arrays = Snapshot.layout(particles, cells, True, bodies, laws, dimension)
    size = _SLOT + sum(math.prod(shape) * int(kind[1:]) for _, kind, shape in arrays)
    return -(-size // mmap.PAGESIZE) * mmap.PAGESIZE


class _Flag:
    """A truth value in the header."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __get__(self, memory: StateMemory, kind: type) -> bool:
        return bool(memory._header[self._number])

    def __set__(self, memory: StateMemory, value: bool) -> None:
        memory._header[self._number] = int(value)


class StateMemory:
    """The memory, in the process that runs or in the one that draws.

    It has a ``descriptor``, or is new, with ``room`` bytes per slot. ``wanted``: whether somebody looks, by the process
    that draws; ``ended``, ``paused``: whether the run has ended, or waits.
    """

    wanted, ended, paused = _Flag(_WANTED), _Flag(_ENDED), _Flag(_PAUSED)

    def __init__(self, descriptor: int | None = None, room: int = 0) -> None:
        self.descriptor = _anonymous_file() if descriptor is None else descriptor
        if descriptor is None:
            os.ftruncate(self.descriptor, _HEADER + 2 * room)
        self._count = 0
        self._map()
        if descriptor is None:
            self._header[_SIZE], self._header[_VERSION] = room, _MAGIC
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
        owned, (particles, dimension) = state.cell_fluid is not None, state.position.shape
        cells, bodies, laws = len(state.cells), len(state.bodies), len(state.laws)
        needed = slot_size(particles, cells, bodies, laws, dimension)
        if needed > self._header[_SIZE]:
            self._grow(needed + needed // 2)
        self._count += 1
        number = self._count
        whole, real, start = self._slot(number % 2)
        whole[0] = 2 * number + 1  # odd: being written
        whole[1:5] = particles, cells, state.step, owned
        whole[5:10] = state.poked, bodies, sum(1 << k for k in state.shut if k < 63), laws, dimension
        real[: 3 + dimension] = state.time, state.speed, state.pace, *state.gravity
        for name, array in self._arrays(start, particles, cells, owned, bodies, laws, dimension).items():
            array[...] = getattr(state, name)
        whole[0] = 2 * number
        self._header[_PUBLISHED] = number

    def latest(self) -> Snapshot | None:
        """A copy of the state published last; None while there is none."""
        for _ in range(_TRIES):
            number = self.published
            if not number:
                return None
            if _HEADER + 2 * int(self._header[_SIZE]) > len(self._memory):
                self._map()
            whole, real, start = self._slot(number % 2)
            before = 2 * number
            if int(whole[0]) != before:
                continue
            particles, cells, step, owned, poked, bodies, bits, laws, dimension = map(int, whole[1:10])
            if slot_size(particles, cells, bodies, laws, dimension) > self._header[_SIZE]:
                continue
            time, speed, pace, *gravity = map(float, real[: 3 + dimension])
            counts = particles, cells, owned, bodies, laws, dimension
            arrays = {n: a.copy() for n, a in self._arrays(start, *counts).items()}
            if int(whole[0]) == before:
                owner = arrays.pop("cell_fluid", None)
                shut, forces = tuple(k for k in range(63) if bits >> k & 1), (tuple(gravity), speed, pace, bool(poked))
                return Snapshot(step, time, *forces, cell_fluid=owner, shut=shut, **arrays)
        return None

    def close(self) -> None:
        """Close the descriptor; the memory goes with the last process that has it."""
        os.close(self.descriptor)

    def _grow(self, room: int) -> None:
        """Make room; slots move, so nothing counts as published until the next state."""
        self._header[_PUBLISHED] = 0
        os.ftruncate(self.descriptor, _HEADER + 2 * room)
        self._header[_SIZE] = room
        self._map()

    def _slot(self, number: int) -> tuple[Array, Array, int]:
        start = _HEADER + number * int(self._header[_SIZE])
        whole = np.frombuffer(self._memory, dtype=np.int64, count=16, offset=start)
        return whole, np.frombuffer(self._memory, dtype=np.float64, count=16, offset=start + 128), start + _SLOT

    def _arrays(self, start: int, *counts: int) -> dict[str, Array]:
        found = {}
        for name, kind, shape in Snapshot.layout(*counts):
            count = math.prod(shape)
            found[name] = np.frombuffer(self._memory, dtype=kind, count=count, offset=start).reshape(shape)
            start += count * int(kind[1:])
        return found


def _anonymous_file() -> int:
    """A descriptor of a file without a name, in memory where the system has such."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("tipfem-state")
    descriptor, path = tempfile.mkstemp(prefix="tipfem-state-")
    os.unlink(path)
    return descriptor

"""One time of a flow in three dimensions, which is drawn as a slice or as a surface."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from tipfem.results.fields.catalogue import Lazy

from .arrays import Array
from .blocks import Blocks
from .camera import Room

LITTLE = 0.15  # part of all fluids' volume that a bubble has at most


@dataclass(frozen=True, kw_only=True)
class Volume:
    """One time of a three-dimensional flow, in SI units.

    Attributes:
        position: (N, 3) particle positions [m].
        cells: (M, 4) tetrahedra as particle indices.
        fluid: (N,) fluid of each particle, an index into ``fluid_names``.
        wall: (N,) mask of the wall particles.
        fluid_names: one name per fluid.
        fluid_densities: one density per fluid [kg/m^3].
        lower: (3,) lower corner of the domain [m].
        upper: (3,) upper corner of it.
        spacing: of the particles [m].
        up: axis that points up, against gravity.
        blocks: in the tank, at t = 0; None for a tank without any.
        pose: (6,) place [m] and turn [rad] of the tank's reference point, with blocks.
        cell_fluid: (M,) fluid of each cell; None where a cell whose particles differ is shared by their fluids.
        fields: values (N,) at the particles, or vectors (N, 3), by name.
        cell_fields: values (M,) of the cells, by name.
        time: [s].
        title: a line above the picture.
        digits: of the time behind the point.
        span: of the times of the run [s], or 0.
    """

    position: Array
    cells: Array
    fluid: Array
    wall: Array
    fluid_names: tuple[str, ...]
    fluid_densities: tuple[float, ...]
    lower: Array
    upper: Array
    spacing: float
    up: int = 2
    blocks: Blocks | None = None
    pose: Array = field(default_factory=lambda: np.zeros(6))
    cell_fluid: Array | None = None
    fields: Lazy = field(default_factory=lambda: Lazy({}))
    cell_fields: Lazy = field(default_factory=lambda: Lazy({}))
    time: float = 0.0
    title: str = ""
    digits: int = 3
    span: float = 0.0

    @cached_property
    def room(self) -> Room:
        """The space between the walls, or the domain's box where none enclose it."""
        if self.blocks is not None:
            return Room(self.blocks.walls(self.pose))
        try:
            return _known(self.position[self.wall].tobytes())
        except ValueError:
            low, high = self.lower, self.upper
            return Room(np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)]))

    @cached_property
    def blocks_now(self) -> Array:
        """Corners (B, 8, 3) of the blocks, see `Blocks.placed` [m]."""
        return np.zeros((0, 8, 3)) if self.blocks is None else self.blocks.placed(self.pose)

    @cached_property
    def loose(self) -> Array:
        """Mask (N,) of the particles off the walls that are in no cell."""
        unused = np.ones(len(self.position), bool)
        unused[self.cells] = False
        return np.asarray(unused & ~self.wall)

    @cached_property
    def drawn(self) -> int:
        """The fluid that pictures show: the densest of a flow, or a lighter one of little volume in it, as a bubble."""
        dense = int(np.argmax(self.fluid_densities))
        if len(self.fluid_names) != 2 or self.cell_fluid is None:
            return dense
        a, b, c, d = np.moveaxis(self.position[self.cells], 1, 0)
        size = np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a))
        return 1 - dense if 0 < size[self.cell_fluid != dense].sum() < LITTLE * size.sum() else dense


@lru_cache(maxsize=4)
def _known(points: bytes) -> Room:
    return Room(np.frombuffer(points).reshape(-1, 3))


def upwards(gravity: ArrayLike) -> int:
    """Axis of the largest component of gravity (3,), the last one without any."""
    pull = np.abs(np.asarray(gravity, float))
    return int(pull.argmax()) if pull.any() else 2

"""Tanks filled with fluids, sampled by particles."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tipfem.fluid import Fluid
from tipfem.particles import Array, Particles


@dataclass
class _Region:
    """A part of the tank: which fluid is in it, and which points belong to it."""

    fluid: Fluid
    contains: Callable[[Array], Array]
    box: Array | None = None


@dataclass
class Tank:
    """A closed box with one row of fixed ghost particles as walls, to be filled with fluids.

    Particles stand on a rectilinear lattice. Its lines are shifted a little, so that every
    face of a filled box that lies inside the tank runs midway between two of them: that is
    where the interface of two fluids is, and so the volumes are those asked for.

    Attributes:
        size: (d,) edge lengths [m]; one corner is the origin.
        spacing: target distance between particles [m].
        jitter: random displacement of the particles off the walls, in spacings (0 to 0.4).
        seed: of the random displacement.

    Raises:
        ValueError: a size or the spacing is not positive, or the spacing exceeds half an edge.
    """

    size: Sequence[float]
    spacing: float
    jitter: float = 0.0
    seed: int = 0
    _regions: list[_Region] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        size = np.asarray(self.size, dtype=float)
        if size.ndim != 1 or len(size) not in (2, 3) or not (np.isfinite(size).all() and (size > 0).all()):
            raise ValueError(f"tank: size is {self.size!r}; it must be 2 or 3 lengths > 0 in metres")
        if not (np.isfinite(self.spacing) and self.spacing > 0):
            raise ValueError(f"tank: spacing is {self.spacing!r} m; it must be > 0")
        if self.spacing > size.min() / 2:
            raise ValueError(
                f"tank: spacing is {self.spacing:g} m, too large for a tank of {size.tolist()} m; "
                f"it must be at most half the smallest edge, {size.min() / 2:g} m"
            )
        if not 0 <= self.jitter <= 0.4:
            raise ValueError(f"tank: jitter is {self.jitter!r}; it must lie between 0 and 0.4 spacings")

    def fill(
        self,
        fluid: Fluid,
        *,
        box: Sequence[Sequence[float]] | None = None,
        disc: tuple[Sequence[float], float] | None = None,
        where: Callable[[Array], Array] | None = None,
    ) -> Tank:
        """Fill the tank, or a part of it, with a fluid; later fills replace earlier ones.

        Args:
            fluid: the fluid.
            box: (lower corner, upper corner) [m].
            disc: (centre, radius) [m]; a ball in 3-D.
            where: function from positions (K, d) [m] to a mask (K,).

        Returns:
            The tank itself, so that calls can be chained.

        Raises:
            ValueError: the part has the wrong shape or lies outside the tank.
        """
        if sum(part is not None for part in (box, disc, where)) > 1:
            raise ValueError("fill: give one of box, disc and where, not several")
        size = np.asarray(self.size, dtype=float)
        if box is not None:
            corners = np.asarray(box, dtype=float)
            if corners.shape != (2, len(size)) or not (corners[0] < corners[1]).all():
                raise ValueError(
                    f"fill {fluid.name!r}: box is {box!r}; it must be (lower, upper), two corners of "
                    f"{len(size)} coordinates with lower < upper"
                )
            if (corners[1] <= 0).any() or (corners[0] >= size).any():
                raise ValueError(f"fill {fluid.name!r}: box {box!r} lies outside the tank of {size.tolist()} m")
            corners = np.clip(corners, 0.0, size)
            self._regions.append(_Region(fluid, lambda x: _in_box(x, corners, size), corners))
        elif disc is not None:
            centre, radius = np.asarray(disc[0], dtype=float), float(disc[1])
            if centre.shape != size.shape or not radius > 0:
                raise ValueError(
                    f"fill {fluid.name!r}: disc is {disc!r}; it must be (centre, radius) with a centre of "
                    f"{len(size)} coordinates and a radius > 0"
                )
            self._regions.append(_Region(fluid, lambda x: ((x - centre) ** 2).sum(axis=1) < radius**2))
        else:
            self._regions.append(_Region(fluid, where if where is not None else _everywhere))
        return self

    def sample(self, fluids: Sequence[Fluid]) -> Particles:
        """Particles of the filled tank, walls included.

        Args:
            fluids: the case's fluids; ``Particles.fluid`` indexes this list.

        Returns:
            Particles with N of about prod(size / spacing + 1).

        Raises:
            ValueError: a part of the tank is empty, or holds a fluid that is not in the list.
        """
        lines = [self._lines(axis) for axis in range(len(self.size))]
        position = np.stack([x.ravel() for x in np.meshgrid(*lines, indexing="ij")], axis=1)
        size = np.asarray(self.size, dtype=float)
        wall = ((position == 0.0) | (position == size)).any(axis=1)
        fluid = np.full(len(position), -1, dtype=np.int32)
        for region in self._regions:
            if region.fluid not in fluids:
                raise ValueError(
                    f"tank is filled with {region.fluid.name!r}, which is not among the case's fluids "
                    f"{[f.name for f in fluids]}"
                )
            fluid[np.asarray(region.contains(position), dtype=bool)] = list(fluids).index(region.fluid)
        if (fluid < 0).any():
            i = int(np.argmax(fluid < 0))
            raise ValueError(
                f"tank: no fluid at {position[i].tolist()}; fill the whole tank first, then parts of it"
            )
        if self.jitter:
            shift = np.random.default_rng(self.seed).uniform(-1, 1, position.shape) * self.jitter * self.spacing
            position[~wall] += shift[~wall]
        return Particles(position, fluid, wall, spacing=self.spacing)

    def _lines(self, axis: int) -> Array:
        """Coordinates (n,) of the lattice lines along one axis [m]."""
        length, h = float(self.size[axis]), self.spacing
        faces = {0.0, length}
        for region in self._regions:
            if region.box is not None:
                faces.update(float(x) for x in region.box[:, axis])
        edges = [0.0]
        for face in sorted(faces)[1:]:
            if face - edges[-1] < 1e-9 * length:
                continue
            if face - edges[-1] < 0.75 * h:
                raise ValueError(
                    f"tank: along axis {axis}, the part between {edges[-1]:g} m and {face:g} m is thinner than "
                    f"the spacing of {h:g} m; choose a smaller spacing"
                )
            edges.append(face)
        pieces = []
        for lower, upper in itertools.pairwise(edges):
            # A wall particle stands on the wall itself; at a face the nearest line is half a step away.
            margins = (0.0 if lower == 0.0 else 0.5) + (0.0 if upper == length else 0.5)
            steps = max(1, round((upper - lower) / h - margins))
            step = (upper - lower) / (steps + margins)
            first = lower if lower == 0.0 else lower + 0.5 * step
            pieces.append(first + step * np.arange(steps + 1))
        lines = np.concatenate(pieces)
        lines[-1] = length
        return lines


def tank(size: Sequence[float], spacing: float, *, jitter: float = 0.0, seed: int = 0) -> Tank:
    """A closed tank to be filled: ``tank((1, 1), 0.05).fill(air).fill(water, box=((0, 0), (1, 0.5)))``.

    See `Tank` for the arguments and the errors.
    """
    return Tank(size, spacing, jitter, seed)


def _everywhere(x: Array) -> Array:
    return np.ones(len(x), dtype=bool)


def _in_box(x: Array, corners: Array, size: Any) -> Array:
    """Mask (K,) of the points in a box; faces on the tank's walls belong to it."""
    slack = 1e-9 * size
    return ((x > corners[0] - slack) & (x < corners[1] + slack)).all(axis=1)

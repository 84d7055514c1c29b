"""Tanks filled with fluids, sampled by particles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tipfem.arguments import is_number, numbers
from tipfem.case import lattice
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading, thinned
from tipfem.case.lattice import faces_of_part, heaviest_beside, snap_to_faces
from tipfem.case.particles import Particles
from tipfem.case.walls import Wall
from tipfem.typing import Array

# The walls of a tank by their names: axis, and whether it is the one at the upper end.
SIDES = {name: (k // 2, k % 2 == 1) for k, name in enumerate(["left", "right", "bottom", "top", "back", "front"])}


@dataclass
class Region:
    """A part of the tank: which fluid is in it, what the user called it, and which points belong to it.

    Attributes:
        given: the argument of `Tank.fill` that says what the part is, "box", "disc" or "where", with its value; empty
            for the whole tank.
    """

    fluid: Fluid
    part: str
    contains: Callable[[Array], Array]
    box: Array | None = None
    given: dict[str, Any] = field(default_factory=dict)


@dataclass
class Tank:
    """A closed box with one row of fixed ghost particles as walls, to be filled with fluids.

    Particles stand on a rectilinear lattice. Every face of a filled box that lies inside the tank
    runs midway between two of its lines: that is where the interface of two fluids is, and so the
    volumes of layers are those asked for. Between faces the lines are evenly spaced, on each side
    of a face by a little more or less than ``spacing``. A layer between two faces can be one line.

    Attributes:
        size: (d,) edge lengths [m]; one corner is the origin.
        spacing: target distance between particles [m].
        jitter: random displacement of the particles off the walls, in spacings (0 to 0.4). A tank
            in 3-D needs some, 0.1 for instance: the cubes of a regular lattice have no unique
            Delaunay mesh, and would be cut into simplices without volume. With a `wall` described,
            the wall particles in 3-D are displaced too, along their walls.
        seed: of the random displacement.

    Raises:
        ValueError: a size or the spacing is no positive number, the spacing exceeds half an edge, or
            the jitter is out of range.
    """

    size: Sequence[float]
    spacing: float
    jitter: float = 0.0
    seed: int = 0
    _regions: list[Region] = field(default_factory=list, repr=False)
    _walls: dict[str, dict[str, Any]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        size = numbers(self.size)
        if size.ndim != 1 or len(size) not in (2, 3) or not (np.isfinite(size).all() and (size > 0).all()):
            raise ValueError(f"tank: size is {self.size!r}; it must be 2 or 3 lengths > 0 in metres")
        if not (is_number(self.spacing) and self.spacing > 0):
            raise ValueError(f"tank: spacing is {self.spacing!r} m; it must be > 0")
        if self.spacing > size.min() / 2:
            raise ValueError(
                f"tank: spacing is {self.spacing:g} m, too large for a tank of {size.tolist()} m; "
                f"it must be at most half the smallest edge, {size.min() / 2:g} m"
            )
        if not (is_number(self.jitter) and 0 <= self.jitter <= 0.4):
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
            ValueError: ``fluid`` is no Fluid, or the part has the wrong shape or lies outside the tank.
        """
        if not isinstance(fluid, Fluid):
            raise ValueError(f"fill: fluid is {fluid!r}; it must be a Fluid")
        if sum(part is not None for part in (box, disc, where)) > 1:
            raise ValueError("fill: give one of box, disc and where, not several")
        size = np.asarray(self.size, dtype=float)
        if box is not None:
            corners = numbers(box)
            if corners.shape != (2, len(size)) or not (corners[0] < corners[1]).all():
                raise ValueError(
                    f"fill {fluid.name!r}: box is {box!r}; it must be (lower, upper), two corners of "
                    f"{len(size)} coordinates with lower < upper"
                )
            if (corners[1] <= 0).any() or (corners[0] >= size).any():
                raise ValueError(f"fill {fluid.name!r}: box {box!r} lies outside the tank of {size.tolist()} m")
            corners = np.clip(corners, 0.0, size)
            self._regions.append(
                Region(fluid, f"box {box!r}", lambda x: _in_box(x, corners, size), corners, {"box": box})
            )
        elif disc is not None:
            given, radius = disc if isinstance(disc, Sequence) and len(disc) == 2 else (None, None)
            centre = numbers(given)
            if centre.shape != size.shape or not np.isfinite(centre).all() or not is_number(radius) or not radius > 0:
                raise ValueError(
                    f"fill {fluid.name!r}: disc is {disc!r}; it must be (centre, radius) with a centre of "
                    f"{len(size)} coordinates and a radius > 0"
                )
            self._regions.append(
                Region(
                    fluid,
                    f"disc {disc!r}",
                    lambda x: ((x - centre) ** 2).sum(axis=1) < radius**2,
                    given={"disc": (centre, radius)},
                )
            )
        elif where is not None:
            if not callable(where):
                raise ValueError(f"fill {fluid.name!r}: where is {where!r}; it must be a function of positions")
            self._regions.append(Region(fluid, "where", where, given={"where": where}))
        else:
            self._regions.append(Region(fluid, "tank", lambda x: np.ones(len(x), dtype=bool)))
        return self

    def wall(self, side: str, **what: Any) -> Tank:
        """Let a wall slip, slide or move: ``wall("top", velocity=(1, 0))``, ``wall("left", slip=True)``.

        Args:
            side: left, right, bottom or top; back or front (low and high z) too in 3-D.
            what: slip, slip_length, velocity or motion, see `Wall`.

        Returns:
            The tank itself, so that calls can be chained.

        Raises:
            ValueError: there is no such wall, it has been said already, or see `Wall`.
        """
        sides = [name for name, (axis, _) in SIDES.items() if axis < len(self.size)]
        if side not in sides:
            raise ValueError(f"wall: {side!r} is no wall of this tank; it has {', '.join(sides)}")
        if side in self._walls:
            raise ValueError(f"wall {side!r} is described twice; say all about it in one call")
        options = {"slip", "slip_length", "velocity", "motion"}
        if not what or set(what) - options:
            raise ValueError(f"wall {side!r}: {sorted(what)} given; it takes one or more of {sorted(options)}")
        Wall(side, particles=[], **what)  # refuses bad values here
        self._walls[side] = what
        return self

    @property
    def regions(self) -> tuple[Region, ...]:
        """What `fill` was told, in its order."""
        return tuple(self._regions)

    @property
    def wall_options(self) -> dict[str, dict[str, Any]]:
        """What `wall` was told, by the wall's name."""
        return {name: dict(what) for name, what in self._walls.items()}

    def walls(self, particles: Particles) -> list[Wall]:
        """The walls described by `wall`, on the tank's own particles as `sample` gives them."""
        result = []
        for name, what in self._walls.items():
            axis, upper = SIDES[name]
            place = float(self.size[axis]) if upper else 0.0
            result.append(Wall(name, particles=particles.wall & (particles.position[:, axis] == place), **what))
        return result

    def sample(
        self, fluids: Sequence[Fluid], *, fitted: bool = False, empty: bool = False, grading: Grading | None = None
    ) -> Particles:
        """Particles of the filled tank, walls included.

        Args:
            fluids: the case's fluids; ``Particles.fluid`` indexes this list.
            empty: let parts of the tank be empty: there are no particles but those of walls, of fluid -1. In 2-D
                particles stand on the faces of empty parts; that is where free surfaces begin.
            fitted: put particles on the faces between two fluids, instead of on both sides of them, and let
                them have the heavier one; in 2-D only. That is what the sharp interface starts from.
            grading: what thins the lattice away from interfaces; in 2-D only, and where no part is empty.

        Returns:
            Particles with N of about prod(size / spacing + 1).

        Raises:
            ValueError: a part of the tank is empty, too thin, or holds a fluid that is not in the list; a
                filled part holds no particle off the walls; a ``where`` gave no mask; a tank in 3-D
                has no jitter, or is to be fitted.
        """
        if fitted and len(self.size) == 3:
            raise ValueError(
                "tank: the sharp interface (the default) is for 2-D only; for a 3-D tank say interface='interpolated'"
            )
        if len(self.size) == 3 and not self.jitter:
            raise ValueError(
                "tank: jitter is 0; a regular lattice in 3-D cannot be meshed, its cubes are cut into simplices "
                "without volume; set jitter, to 0.1 for instance"
            )
        size, numbers_of, nothing = np.asarray(self.size, dtype=float), self._numbers(fluids), len(fluids)

        def fluid_at(x: Array) -> Array:
            label = np.full(len(x), nothing if empty else 0, dtype=np.int32)
            for region, number in zip(self._regions, numbers_of, strict=True):
                label[np.asarray(region.contains(x.copy()))] = number
            return label

        def is_empty(x: Array) -> Array:
            return fluid_at(x) == nothing

        lines = []
        for axis, length in enumerate(size.tolist()):
            faces = self._faces(axis)
            ends = faces_of_part(faces, axis, size, self.spacing, is_empty) if empty else set()
            if fitted:
                lines.append(lattice.fitted_lines(axis, length, self.spacing, faces))
            else:
                lines.append(lattice.lines(axis, length, self.spacing, faces, ends))
        position = np.stack([x.ravel() for x in np.meshgrid(*lines, indexing="ij")], axis=1)
        wall = ((position == 0.0) | (position == size)).any(axis=1)
        fluid = np.full(len(position), -1, dtype=np.int32)
        for region, number in zip(self._regions, numbers_of, strict=True):
            fluid[self._mask(region, position, wall)] = number
        if (fluid < 0).any() and not empty:
            i = int(np.argmax(fluid < 0))
            raise ValueError(
                f"tank: no fluid at {position[i].tolist()}; fill the whole tank first, then parts of it, or let the "
                "case have a free surface"
            )
        if (fluid < 0).all():
            raise ValueError("tank: it is empty; fill at least a part of it with a fluid")
        free = ~wall
        if len(size) == 2 and (fitted or empty):
            part = fluid_at if fitted else is_empty
            position, on_face = snap_to_faces(position, (len(lines[0]), len(lines[1])), size, part)
            density = np.array([*(f.density for f in fluids), 0.0])
            fluid[on_face] = heaviest_beside(position[on_face], size, self.spacing, fluid_at, density)
            free &= ~on_face
        if self.jitter:
            shift = np.random.default_rng(self.seed).uniform(-1, 1, position.shape) * self.jitter * self.spacing
            # In 3-D four wall particles of a lattice can be in one plane across an edge of the tank. What is cut
            # away between them does no harm as long as they are fixed; particles of walls that slip feel it.
            held = (position == 0.0) | (position == size) if len(size) == 3 and self._walls else ~free[:, None]
            position += np.where(held, 0.0, shift)
        there = wall | (fluid >= 0)
        if grading:
            there = thinned(grading, position, (len(lines[0]), len(lines[1])), fluid, fluids, self.spacing)
        return Particles(position[there], fluid[there], wall[there], spacing=self.spacing)

    def _numbers(self, fluids: Sequence[Fluid]) -> list[int]:
        """Number of each region's fluid among ``fluids``; see `sample` for errors."""
        for region in self._regions:
            if region.fluid not in fluids:
                raise ValueError(
                    f"tank is filled with {region.fluid.name!r}, which is not among the case's fluids "
                    f"{[f.name for f in fluids]}"
                )
        return [list(fluids).index(region.fluid) for region in self._regions]

    def _mask(self, region: Region, position: Array, wall: Array) -> Array:
        """Mask (N,) of the lattice points in a region; see `sample` for errors."""
        inside = np.asarray(region.contains(position.copy()))  # a copy: a user's function may work in place
        if inside.shape != wall.shape or inside.dtype != bool:
            raise ValueError(
                f"fill {region.fluid.name!r}: {region.part} gave {inside.dtype} of shape {inside.shape}; it must be a "
                f"mask, bool of shape {wall.shape}"
            )
        # Wall particles take the fluid of their neighbours, so those alone would be lost without a word.
        if not (inside & ~wall).any():
            raise ValueError(
                f"fill {region.fluid.name!r}: {region.part} holds no particle off the walls; it lies outside the "
                f"tank, or is too small for a spacing of {self.spacing:g} m"
            )
        return inside

    def holds(self, x: Array) -> Array:
        """Mask (K,) of the positions (K, d) [m] that are in a part that has been filled."""
        inside = np.zeros(len(x), dtype=bool)
        for region in self._regions:
            inside |= np.asarray(region.contains(x.copy()))
        return inside

    def _faces(self, axis: int) -> set[float]:
        """Coordinates of the faces of filled boxes along one axis [m]."""
        boxes = [region.box for region in self._regions if region.box is not None]
        return {float(x) for box in boxes for x in box[:, axis]}


def tank(size: Sequence[float], spacing: float, *, jitter: float = 0.0, seed: int = 0) -> Tank:
    """A closed tank to be filled: ``tank((1, 1), 0.05).fill(air).fill(water, box=((0, 0), (1, 0.5)))``.

    See `Tank` for the arguments and the errors.
    """
    return Tank(size, spacing, jitter, seed)


def _in_box(x: Array, corners: Array, size: Any) -> Array:
    """Mask (K,) of the points in a box; faces on the tank's walls belong to it."""
    slack = 1e-9 * size
    return ((x > corners[0] - slack) & (x < corners[1] + slack)).all(axis=1)

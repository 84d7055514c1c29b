"""Tanks filled with fluids, sampled by particles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tipfem.arguments import is_number, numbers
from tipfem.case import lattice
from tipfem.case.body import Body
from tipfem.case.default_laws import Rule, Setting, default_law
from tipfem.case.domain import Domain
from tipfem.case.fluid import Fluid, ranks
from tipfem.case.grading import Grading, thinned
from tipfem.case.lattice import faces_of_part, heaviest_beside, snap_to_faces
from tipfem.case.memory import too_many
from tipfem.case.particles import Particles
from tipfem.case.period import Period, no_period
from tipfem.case.region import Region, initial_velocities, name_of
from tipfem.case.shapes import Shape, rectangle
from tipfem.case.walls import Wall
from tipfem.typing import Array

# The walls of a tank by their names: axis, and whether it is the one at the upper end.
SIDES = {name: (k // 2, k % 2 == 1) for k, name in enumerate(["left", "right", "bottom", "top", "back", "front"])}
LEAST_WIDTH = 8  # of a periodic tank [spacings]: no cell may reach around a quarter of it


class Tank:
    """A closed box with one row of wall particles, to be filled with fluids; `tipfem.tank` makes one.

    Particles are placed on a rectilinear lattice. Every face of a filled box inside the tank
    runs midway between two lattice lines: the interface of two fluids is there, and so the
    volumes of layers are exact. Between faces the lines are evenly spaced, on each side
    of a face by a little more or less than ``spacing``. A layer between two faces can be one line.

    Args:
        size: (d,) edge lengths [m]; one corner is the origin.
        spacing: target distance between particles [m].
        jitter: random displacement of the particles off the walls, in spacings (0 to 0.4). A tank
            in 3-D needs some, 0.1 for instance: the cubes of a regular lattice have no unique
            Delaunay mesh, and would be cut into simplices without volume. With a `wall` described,
            the wall particles in 3-D are displaced too, along their walls.
        seed: of the random displacement.
        periodic: "x": what leaves on the left enters on the right, and there are no walls on these sides; in 2-D. "xy":
            nor are there walls below and above. None for walls all around.

    Attributes:
        size: (d,) array [m].
        lower, upper: (d,) corners of its bounding box [m].
        sides: names of its walls.
        default_laws: the laws of the walls that `wall` does not describe, and why; none before a case has chosen them.
        domain: the polygon that bounds it; None for a box.
        period: of its positions.

    The other arguments are attributes too.

    Raises:
        ValueError: a size or the spacing is not a positive number, the spacing exceeds half an edge, the jitter is out
            of range, ``periodic`` is neither "x" nor "xy" nor None, or a periodic tank is in 3-D or too narrow.
    """

    SLACK = 1e-9  # of boxes, in sizes of the tank

    def __init__(
        self, size: Sequence[float], spacing: float, jitter: float = 0.0, seed: int = 0, periodic: str | None = None
    ) -> None:
        self.size = numbers(size)
        self.lower, self.upper = np.zeros_like(self.size), self.size
        self.sides: tuple[str, ...] = tuple(name for name, (axis, _) in SIDES.items() if axis < self.size.size)
        self.spacing, self.jitter, self.seed = spacing, jitter, seed
        self._regions: list[Region] = []
        self.bodies: list[Body] = []
        self._walls: dict[str, dict[str, Any]] = {}
        self.default_laws: dict[str, Rule] = {}
        self._sealed = False
        self.domain: Domain | None = None
        if self.size.ndim != 1 or len(self.size) not in (2, 3) or not ((self.size > 0) & (self.size < np.inf)).all():
            raise ValueError(f"tank: size is {size!r}; it must be 2 or 3 lengths > 0 in metres")
        if not (is_number(spacing) and spacing > 0):
            raise ValueError(f"tank: spacing is {spacing!r} m; it must be > 0")
        if spacing > self.size.min() / 2:
            raise ValueError(
                f"tank: spacing is {spacing:g} m, too large for a tank of {self.size.tolist()} m; "
                f"it must be at most half the smallest edge, {self.size.min() / 2:g} m"
            )
        if not (is_number(jitter) and 0 <= jitter <= 0.4):
            raise ValueError(f"tank: jitter is {jitter!r}; it must lie between 0 and 0.4 spacings")
        try:
            np.random.default_rng(seed)
        except (TypeError, ValueError):
            raise ValueError(f"tank: seed is {seed!r}; it must be a whole number >= 0") from None
        self.periodic, self.period = periodic, no_period(len(self.size))
        if periodic is not None:
            self._make_periodic(periodic)

    def _make_periodic(self, periodic: str) -> None:
        """Leave out the walls across the periodic axes; see the class for errors."""
        if periodic not in ("x", "xy"):
            raise ValueError(
                f"tank: periodic is {periodic!r}; it must be 'x' or 'xy', or left out for walls all around"
            )
        if len(self.size) != 2:
            raise ValueError(
                f"tank: periodic is {periodic!r} and size {self.size.tolist()} m; only tanks in 2-D are periodic"
            )
        width = np.where(["x" in periodic, "y" in periodic], self.size, 0.0)
        for length, name in zip(width.tolist(), ("wide", "high"), strict=True):
            if 0 < length < LEAST_WIDTH * self.spacing * (1 - 1e-9):
                raise ValueError(
                    f"tank: periodic is {periodic!r} and the tank {length:g} m {name}; with a spacing of "
                    f"{self.spacing:g} m it must be {LEAST_WIDTH * self.spacing:g} m or more, {LEAST_WIDTH} spacings"
                )
        self.period = Period(width)
        self.sides = tuple(name for name in self.sides if SIDES[name][0] not in self.period.axes)

    def choose_laws(self, setting: Setting) -> None:
        """Choose the laws of the walls that `wall` does not describe, for a case; see `tipfem.case.default_laws`."""
        names = [name for name in self.sides if name not in self._walls]
        self.default_laws = {name: default_law(setting, curved=self._is_curved(name)) for name in names}

    def _is_curved(self, side: str) -> bool:
        """Whether a side is a curve, or has one; those of a box are straight."""
        del side
        return False

    def _options(self, side: str) -> dict[str, Any]:
        """What is said of a side, or its law where nothing is; empty for a fixed no-slip wall."""
        rule = self.default_laws.get(side)
        options = self._walls.get(side) or {"law": rule.law if rule else None}
        given = {name: value for name, value in options.items() if value is not None and value is not False}
        return {} if not given or given == {"law": "no-slip"} else given

    def seal(self) -> None:
        """Refuse further changes: a case has taken its particles and walls from the tank."""
        self._sealed = True

    def _require_open(self, what: str) -> None:
        if self._sealed:
            raise ValueError(
                f"{what}: a Case has been made of this tank already and would not see the change; describe the tank "
                "before, or make a new one"
            )

    def fill(
        self,
        fluid: Fluid,
        *,
        box: Sequence[Sequence[float]] | None = None,
        disc: tuple[Sequence[float], float] | None = None,
        where: Callable[[Array], Array] | None = None,
        shape: Any = None,
        velocity: Callable[[Array], Array] | Sequence[float] | None = None,
    ) -> Tank:
        """Fill the tank, or a part of it, with a fluid; later fills replace earlier ones.

        Args:
            fluid: the fluid.
            box: (lower corner, upper corner) [m].
            disc: (centre, radius) [m]; a ball in 3-D.
            where: function from positions (K, d) [m] to a mask (K,).
            shape: a shape of `tipfem.shapes`, a list of corners [m], or a polygon of shapely; in 2-D only.
            velocity: of the fluid at the start: d components [m/s], or a function from positions (K, d) [m] to
                velocities (K, d) [m/s]; by default it is at rest. Particles on walls have what their walls allow.

        Returns:
            The tank itself, so that calls can be chained.

        Raises:
            ValueError: ``fluid`` is not a Fluid, the part has the wrong shape or lies outside the tank, or a `Case`
                has been made of the tank already.
        """
        self._require_open("fill")
        if not isinstance(fluid, Fluid):
            why = "; a tank knows no names of fluids" if isinstance(fluid, str) else ""
            raise ValueError(f"fill: fluid is {fluid!r}{why}; it must be a Fluid, as tp.Fluid('water', 998.2, 1e-3)")
        if sum(part is not None for part in (box, disc, where, shape)) > 1:
            raise ValueError("fill: give one of box, disc, where and shape, not several")
        initial: Callable[[Array], Array] | Array | None = None
        if callable(velocity):
            initial = velocity
        elif velocity is not None:
            initial = numbers(velocity)
            if initial.shape != self.size.shape or not np.isfinite(initial).all():
                raise ValueError(
                    f"fill {fluid.name!r}: velocity is {velocity!r}; it must be {len(self.size)} finite components in "
                    "m/s, or a function of positions"
                )
        size = self.size
        if box is not None:
            corners = numbers(box)
            if corners.shape != (2, len(size)) or not (corners[0] < corners[1]).all():
                raise ValueError(
                    f"fill {fluid.name!r}: box is {box!r}; it must be (lower, upper), two corners of "
                    f"{len(size)} coordinates with lower < upper"
                )
            if (corners[1] <= self.lower).any() or (corners[0] >= self.upper).any():
                raise ValueError(f"fill {fluid.name!r}: box {box!r} lies outside the tank of {size.tolist()} m")
            corners = np.clip(corners, self.lower, self.upper)
            slack = self.SLACK * size
            self._regions.append(
                Region(fluid, f"box {box!r}", lambda x: _in_box(x, corners, slack), corners, {"box": box})
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
            self._regions.append(Region(fluid, f"where={name_of(where)}", where, given={"where": where}))
        elif shape is not None:
            self._regions.append(self._shaped(fluid, shape))
        else:
            self._regions.append(Region(fluid, "tank", lambda x: np.ones(len(x), dtype=bool)))
        self._regions[-1].velocity = initial
        return self

    def _shaped(self, fluid: Fluid, given: Any) -> Region:
        """The region of a shape; see `fill` for errors."""
        here = f"fill {fluid.name!r}"
        if len(self.size) != 2:
            raise ValueError(f"{here}: shape is given in 3-D; shapes are for 2-D only")
        try:
            shape = Shape.of(given)
        except ValueError as error:
            raise ValueError(f"{here}: {error}") from error
        lower, upper = shape.box
        if (upper <= self.lower).any() or (lower >= self.upper).any():
            raise ValueError(
                f"{here}: shape, from {lower.tolist()} to {upper.tolist()} m, lies outside the tank, which extends "
                f"from {self.lower.tolist()} to {self.upper.tolist()} m"
            )
        return Region(fluid, "shape", shape.contains, given={"shape": shape})

    def add(self, body: Body) -> Tank:
        """Put a rigid body into the tank; in 2-D only. What fills the tank surrounds it.

        Args:
            body: inside the tank, three spacings or more off its walls and off other bodies.

        Returns:
            The tank itself.

        Raises:
            ValueError: it is no `Body`, another one has its name, it is not inside the tank, or a `Case` has been made
                of the tank already.
        """
        self._require_open("add")
        if not isinstance(body, Body):
            raise ValueError(f"add: {body!r} is not a Body")
        if len(self.size) != 2:
            raise ValueError(f"add: body {body.name!r}: bodies are for 2-D only")
        if body.name in [other.name for other in self.bodies]:
            raise ValueError(f"add: there is a body {body.name!r} already; every body needs a name of its own")
        self.bodies.append(body)
        return self

    def wall(self, side: str, **what: Any) -> Tank:
        """Let a wall slip, slide or move: ``wall("top", velocity=(1, 0))``, ``wall("left", slip=True)``.

        Straight walls that are not described have the law "layer" in 2-D; for others see `tipfem.case.default_laws`.
        Walls of which only a velocity or a motion is said are no-slip walls.

        Args:
            side: left, right, bottom or top; back or front (low and high z) too in 3-D. The name of a side, where the
                tank has another shape.
            what: law, slip, slip_length, velocity or motion, see `Wall`.

        Returns:
            The tank itself, so that calls can be chained.

        Raises:
            ValueError: there is no such wall, it has been described before, a `Case` has been made of the tank
                already, or see `Wall`.
        """
        self._require_open(f"wall {side!r}")
        if side not in self.sides:
            has = ", ".join(self.sides) or "none, as both of its directions are periodic"
            raise ValueError(f"wall: {side!r} is no wall of this tank; it has {has}")
        if side in self._walls:
            raise ValueError(f"wall {side!r} is described twice; give all of its properties in one call")
        options = {"law", "slip", "slip_length", "velocity", "motion"}
        if not what or set(what) - options:
            raise ValueError(f"wall {side!r}: {sorted(what)} given; it takes one or more of {sorted(options)}")
        Wall(side, particles=[], **what)  # refuses bad values here
        self._walls[side] = what
        return self

    @property
    def regions(self) -> tuple[Region, ...]:
        """The regions filled by `fill`, in order."""
        return tuple(self._regions)

    @property
    def wall_options(self) -> dict[str, dict[str, Any]]:
        """The arguments of `wall`, by the wall's name; with the law of the others, once a case has chosen one."""
        others = [name for name in self.default_laws if self._options(name)]
        return {name: dict(what) for name, what in self._walls.items()} | {name: self._options(name) for name in others}

    def walls(self, particles: Particles) -> list[Wall]:
        """The walls that are not fixed and no-slip, on the tank's own particles as `sample` gives them."""
        result = []
        for name in [*self._walls, *(side for side in self.sides if side not in self._walls)]:
            what, (axis, upper) = self._options(name), SIDES[name]
            if not what:
                continue
            coordinate = float(self.size[axis]) if upper else 0.0
            on_wall = particles.wall & (particles.position[:, axis] == coordinate)
            result.append(Wall(name, particles=on_wall, **what))
        return result

    def _require_memory(self, content: float, grading: Grading | None) -> None:
        """Raise ValueError if the particles of a tank of an area or volume [m^2, m^3] do not fit into the memory."""
        if wrong := too_many(content, self.spacing, len(self.size), graded=grading is not None):
            raise ValueError(f"tank: spacing {wrong}")

    def sample(
        self, fluids: Sequence[Fluid], *, fitted: bool = False, empty: bool = False, grading: Grading | None = None
    ) -> Particles:
        """Particles of the filled tank, walls included.

        Args:
            fluids: the case's fluids; ``Particles.fluid`` indexes this list.
            fitted: put particles on the faces between two fluids, instead of on both sides of them, and give
                them the heavier one; in 2-D only. The sharp interface needs this.
            empty: let parts of the tank be empty. They have no particles except wall particles, whose fluid is -1.
                In 2-D there are particles on the faces of empty parts, which are the initial free surfaces.
            grading: target spacings that thin out the lattice away from interfaces; in 2-D only, and without empty
                parts.

        Returns:
            Particles with N of about prod(size / spacing + 1).

        Raises:
            ValueError: a part of the tank is empty, too thin, or holds a fluid that is not in the list; a
                filled part holds no particle off the walls; a ``where`` raised or did not return a mask; a tank in 3-D
                has no jitter, or is to be fitted.
        """
        self._require_memory(float(np.prod(self.size)), grading)
        if fitted and len(self.size) == 3:
            raise ValueError(
                "tank: the sharp interface (the default) is for 2-D only; for a 3-D tank say interface='interpolated'"
            )
        if len(self.size) == 3 and not self.jitter:
            raise ValueError(
                "tank: jitter is 0; a regular lattice in 3-D cannot be meshed, its cubes are cut into simplices "
                "without volume; set jitter, to 0.1 for instance"
            )
        if self.bodies:
            return self._sample_around_bodies(fluids, fitted=fitted, empty=empty, grading=grading)
        size, numbers_of, nothing = self.size, self._numbers(fluids), len(fluids)

        def fluid_at(x: Array) -> Array:
            label = np.full(len(x), nothing if empty else 0, dtype=np.int32)
            for region, number in zip(self._regions, numbers_of, strict=True):
                label[region.mask(x)] = number
            return label

        def is_empty(x: Array) -> Array:
            return np.asarray(fluid_at(x) == nothing)

        lines = []
        for axis, length in enumerate(size.tolist()):
            faces = self._faces(axis)
            ends = faces_of_part(faces, axis, size, self.spacing, is_empty) if empty else set()
            if fitted:
                lines.append(lattice.fitted_lines(axis, length, self.spacing, faces))
            else:
                lines.append(lattice.lines(axis, length, self.spacing, faces, ends))
        position = np.stack([x.ravel() for x in np.meshgrid(*lines, indexing="ij")], axis=1)
        at_end = (position == 0.0) | (position == size)
        at_end[:, self.period.axes] = False
        wall = at_end.any(axis=1)
        fluid = np.full(len(position), -1, dtype=np.int32)
        for region, number in zip(self._regions, numbers_of, strict=True):
            fluid[self._mask(region, position, wall)] = number
        self._require_filled(position, fluid, empty=empty)
        free = ~wall
        if len(size) == 2 and (fitted or empty):
            part = fluid_at if fitted else is_empty
            position, on_face = snap_to_faces(position, (len(lines[0]), len(lines[1])), size, part)
            rank = np.append(ranks(fluids), -1)
            for k in self.period.axes:  # faces between the two ends, too
                on_face |= position[:, k] == 0.0
            fluid[on_face] = heaviest_beside(position[on_face], size, self.spacing, fluid_at, rank, self.period)
            free &= ~on_face
        if self.jitter:
            shift = np.random.default_rng(self.seed).uniform(-1, 1, position.shape) * self.jitter * self.spacing
            # In 3-D four wall particles of a lattice can be in one plane across an edge of the tank. The simplices
            # missing between them do not matter while they are fixed, but they do for particles of walls that slip.
            held = (position == 0.0) | (position == size) if len(size) == 3 and self._walls else ~free[:, None]
            position += np.where(held, 0.0, shift)
        kept = wall | (fluid >= 0)
        if self.period:  # the last lines are the images of the first
            line = np.stack(np.unravel_index(np.arange(len(position)), [len(x) for x in lines]), axis=1)
            kept &= (line[:, self.period.axes] < [len(lines[k]) - 1 for k in self.period.axes]).all(axis=1)
            position = self.period.wrapped(position)
        if grading:
            kept = thinned(grading, position, (len(lines[0]), len(lines[1])), fluid, fluids, self.spacing)
        velocity = self._initial_velocity(position[kept], fluid[kept], numbers_of)
        return Particles(position[kept], fluid[kept], wall[kept], velocity, spacing=self.spacing)

    def _require_filled(self, position: Array, fluid: Array, *, empty: bool) -> None:
        """Raise ValueError if the tank is empty; or a part of it, unless parts may be ``empty``."""
        if (fluid < 0).any() and not empty:
            i = int(np.argmax(fluid < 0))
            raise ValueError(
                f"tank: no fluid at {position[i].tolist()}; fill the whole tank first, then parts of it, or give the "
                "case a free surface"
            )
        if (fluid < 0).all():
            raise ValueError("tank: it is empty; fill at least one part of it with a fluid")

    def _sample_around_bodies(
        self, fluids: Sequence[Fluid], *, fitted: bool, empty: bool, grading: Grading | None
    ) -> Particles:
        """See `sample`: the tank is then one of any shape, of which it is a special case."""
        from tipfem.case.shaped_tank import ShapedTank  # here, because it is derived from this class

        shaped = ShapedTank(rectangle((0.0, 0.0), self.size.tolist()), self.spacing, self.jitter, self.seed)
        shaped._regions, shaped._walls, shaped.bodies = self._regions, self._walls, self.bodies
        shaped.default_laws = self.default_laws
        particles = shaped.sample(fluids, fitted=fitted, empty=empty, grading=grading)
        self.domain, self.bodies = shaped.domain, shaped.bodies
        return particles

    def _initial_velocity(self, position: Array, fluid: Array, numbers_of: list[int]) -> Array:
        """Velocities (N, d) [m/s] at the start: of the regions; along walls that slip, 0 at others."""
        velocity = initial_velocities(self._regions, numbers_of, position, fluid, self.spacing, self.period)
        for name, (axis, upper) in SIDES.items():
            if axis >= len(self.size) or axis in self.period.axes:
                continue
            here = position[:, axis] == (self.size[axis] if upper else 0.0)
            if Wall(name, particles=[], **self._options(name)).slips:
                velocity[here, axis] = 0.0
            else:
                velocity[here] = 0.0
        return velocity

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
        inside = region.mask(position)
        # Wall particles take the fluid of their neighbours, so a region with wall particles only would be lost
        # silently.
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
            inside |= region.mask(x)
        return inside

    def _faces(self, axis: int) -> set[float]:
        """Coordinates of the faces of filled boxes along one axis [m]."""
        boxes = [region.box for region in self._regions if region.box is not None]
        return {float(x) for box in boxes for x in box[:, axis]}


def _in_box(x: Array, corners: Array, slack: Array) -> Array:
    """Mask (K,) of the points in a box, up to ``slack`` (d,) outside; faces on the tank's walls belong to it."""
    return np.asarray(((x > corners[0] - slack) & (x < corners[1] + slack)).all(axis=1))

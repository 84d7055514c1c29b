"""Tanks filled with fluids, sampled by particles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from tipfem.arguments import explained, numbers, rounded
from tipfem.case.body import Body
from tipfem.case.declaration import Unit, require
from tipfem.case.default_laws import Rule, Setting, default_body_law, default_law
from tipfem.case.fluid import Fluid, ranks
from tipfem.case.grading import Grading, thinned
from tipfem.case.memory import too_many
from tipfem.case.particles import Particles
from tipfem.case.region import Filling, Region, region_of
from tipfem.case.walls import OPTIONS, Wall
from tipfem.errors import Invalid, Several
from tipfem.geometry.blocks import BlockedBox
from tipfem.geometry.box_points import BoxPoints
from tipfem.geometry.box_sides import AXIS, misnamed, side_of, sides_of
from tipfem.geometry.lattice import Part, heaviest_beside
from tipfem.geometry.period import Period, axisymmetric, no_period
from tipfem.geometry.plane.curves import has_curve
from tipfem.geometry.plane.domain import LEAST_GAP, Domain, domain_of, gap_between
from tipfem.geometry.plane.even_faces import evened
from tipfem.geometry.plane.shape_points import ShapePoints
from tipfem.geometry.plane.shapes import Shape, cut_out, rectangle
from tipfem.geometry.plane.touching import SKIN, TOUCHING, shifts_apart
from tipfem.geometry.solid_points import SolidPoints
from tipfem.geometry.solids import Solid
from tipfem.typing import Array

LEAST_WIDTH = 8  # of a periodic tank [spacings]: no cell may reach around a quarter of it
# By this part of the tank's size, what is filled in reaches beyond its faces. Less in tanks with a shape, because walls
# along no axis meet the faces at round-off only.
SLACK_OF_BOX, SLACK_OF_SHAPE = 1e-9, 1e-12
FARTHEST = 2e3  # from the origin, in sizes of the tank: beyond, as in UTM coordinates, round-off moves fluids at rest


@dataclass(frozen=True)
class TankNumbers:
    """The numbers of a tank, as `Tank` and case files take them.

    Attributes:
        size: edge lengths of a box, one corner of which is the origin.
        spacing: target distance between particles.
        jitter: random displacement of the particles off the walls; a tank in 3-D needs some, 0.1 for instance.
        seed: of the random displacement.
        periodic: "x": no walls on the left and right of a box in 2-D, what leaves there enters on the other side; "xy":
            nor below and above.
        coordinates: "axisymmetric": the plane of a tank in 2-D is that of r and z, and the left side of a box is the
            axis, or what the outline of another shape has of r = 0.

    Raises:
        ValueError: a value is out of range.
    """

    size: Annotated[Sequence[Annotated[float, Gt(0)]], Len(2, 3), Unit("m")] | None
    spacing: Annotated[float, Gt(0), Unit("m")]
    jitter: Annotated[float, Ge(0), Le(0.4), Unit("spacings")] = 0.0
    seed: Annotated[int, Ge(0)] = 0
    periodic: Literal["x", "xy"] | None = None
    coordinates: Literal["planar", "axisymmetric"] = "planar"

    def __post_init__(self) -> None:
        require(self, ("tank",), "tank", ("size", "spacing", "jitter", "periodic", "coordinates"))
        try:
            np.random.default_rng(self.seed)
        except (TypeError, ValueError):
            raise Invalid("tank.seed", f"is {self.seed!r}; it must be a whole number >= 0") from None


class Tank:
    """A closed tank with one row of wall particles, to be filled with fluids; `tipfem.tank` makes one.

    Particles are placed on a rectilinear lattice. Every face of a filled box inside the tank runs midway between two
    lattice lines: the interface of two fluids is there, and so the volumes of layers are exact. Between faces the lines
    are evenly spaced, on each side of a face by a little more or less than ``spacing``. A layer between two faces can
    be one line. The walls of a box are lines of the lattice. Other shapes have particles at all corners of their walls
    and about one spacing apart between them, and lines along the straight walls that run along an axis.

    Its arguments are those of `tipfem.tank`, ``size`` None with a ``shape``. The jitter is up to 0.4 spacings. A tank
    in 3-D needs some: the cubes of a regular lattice have no unique Delaunay mesh, and would be cut into simplices
    without volume. The wall particles in 3-D are displaced too, along their walls, unless all walls of a full tank are
    no-slip walls.

    Attributes:
        size: (d,) array, of the box around a shape [m].
        lower, upper: (d,) corners of its bounding box [m].
        sides: names of its walls.
        default_laws: the laws of the walls that `wall` does not describe, and why; none before a case has chosen them.
        domain: the polygon that bounds it, with corners on arcs where fills meet them, known once it has been sampled;
            None for a box without bodies.
        period: of its positions.

    The arguments are attributes too.

    Raises:
        ValueError: a size or the spacing is not a positive number, the spacing exceeds half an edge, the jitter is out
            of range, ``periodic`` is neither "x" nor "xy" nor None, or a periodic tank is in 3-D or too narrow; or a
            corner of a shape is too sharp, or a gap too narrow.
    """

    solid: Solid | None = None

    def __init__(
        self,
        size: Sequence[float] | None,
        spacing: float,
        jitter: float = 0.0,
        seed: int = 0,
        periodic: str | None = None,
        shape: Shape | Solid | None = None,
        coordinates: str = "planar",
    ) -> None:
        TankNumbers(size, spacing, jitter, seed, periodic, coordinates)  # type: ignore[arg-type]  # refuses bad values
        if shape is not None and size is None:
            self.lower, self.upper = shape.box
            self.size = self.upper - self.lower
        else:
            self.size = numbers(size)
            self.lower, self.upper = np.zeros_like(self.size), self.size
        self.spacing, self.jitter, self.seed = spacing, jitter, seed
        self.solid = shape if isinstance(shape, Solid) else None
        self.shape = shape = shape if isinstance(shape, Shape) else None
        if spacing > self.size.min() / 2 * (1 + 1e-9):  # edges of files are round-off shorter
            text = f"is {spacing:g} m, too large for a tank of {self.size.tolist()} m; it must be at most half the "
            raise Invalid("tank.spacing", f"{text}smallest edge, {self.size.min() / 2:g} m")
        self.sides: tuple[str, ...] = tuple(sides_of(range(self.size.size), coordinates))
        self._regions: list[Region] = []
        self.bodies: list[Body] = []
        self.blocks: BlockedBox | None = None
        self._boxes: dict[str, Array] = {}
        self._walls: dict[str, dict[str, Any]] = {}
        self.default_laws: dict[str, Rule] = {}
        self._body_law = "no-slip"
        self._sealed = False
        self.domain: Domain | None = None
        self.periodic, self.period = periodic, no_period(len(self.size))
        if periodic is not None:
            self._make_periodic(periodic)
        self.coordinates = coordinates
        if coordinates == "axisymmetric":
            self._make_axisymmetric()
        self._require_room(graded=True)
        if self.solid is not None:
            require_near(self.lower, self.upper)
            self.sides = self.solid.names
        if shape is not None:
            assert self.shape is not None
            require_near(self.lower, self.upper)
            self.sides = self.shape.sides
            self.domain = domain_of(self.shape, spacing)
            self.domain.require_resolved(spacing)

    def _make_periodic(self, periodic: str) -> None:
        """Leave out the walls across the periodic axes; see the class for errors."""
        if len(self.size) != 2:
            text = f"is {periodic!r} and size {self.size.tolist()} m; only tanks in 2-D are periodic"
            raise Invalid("tank.periodic", text)
        width = np.where(["x" in periodic, "y" in periodic], self.size, 0.0)
        for length, name in zip(width.tolist(), ("wide", "high"), strict=True):
            if 0 < length < LEAST_WIDTH * self.spacing * (1 - 1e-9):
                text = f"is {periodic!r} and the tank {length:g} m {name}; with a spacing of {self.spacing:g} m it"
                least = LEAST_WIDTH * self.spacing
                raise Invalid("tank.periodic", f"{text} must be {least:g} m or more, {LEAST_WIDTH} spacings")
        self.period = Period(width)
        self.sides = tuple(name for name in self.sides if side_of(name)[0] not in self.period.axes)

    def _make_axisymmetric(self) -> None:
        """Make the left side of a box the axis, or what a shape has of it; see the class for errors."""
        given = {"is in 3-D": len(self.size) != 2, "is periodic": bool(self.period)}
        if self.shape is not None:
            given["reaches beyond the axis"] = self.lower[0] < 0
            self.shape = self.shape.with_axis(AXIS)
        if found := [what for what, there in given.items() if there]:
            text = "it must be a box of (radius, height), or a shape at r >= 0"
            raise Invalid("tank.coordinates", f"is 'axisymmetric' and the tank {found[0]}; {text}")
        self.period = axisymmetric()

    def choose_laws(self, setting: Setting) -> None:
        """Choose the laws of the walls that `wall` does not describe, for a case; see `tipfem.case.default_laws`."""
        self._body_law = default_body_law(sharp=setting.sharp and not setting.thick)
        names = [name for name in self.sides if name not in self._walls and name != AXIS]
        self.default_laws = {name: default_law(setting, curved=self._is_curved(name)) for name in names}

    @property
    def is_box(self) -> bool:
        """Whether its sides are those of a box; otherwise they are sides of `domain`."""
        return self.shape is None and self.solid is None

    def _is_curved(self, side: str) -> bool:
        """Whether a side is a curve, or has one; those of a box are straight."""
        return self.shape is not None and has_curve(self.domain, side)

    def _options(self, side: str) -> dict[str, Any]:
        """Options of a side, or its law where it has none; empty for a fixed no-slip wall."""
        if side == AXIS and self.period.axial:
            return {"slip": True}
        rule = self.default_laws.get(side)
        options = self._walls.get(side) or {"law": rule.law if rule else None}
        given = {name: value for name, value in options.items() if value is not None and value is not False}
        return {} if not given or given == {"law": "no-slip"} else given

    def seal(self) -> None:
        """Refuse further changes: a case has taken its particles and walls from the tank."""
        self._sealed = True

    def block(self, name: str, box: Sequence[Sequence[float]], **what: Any) -> Tank:
        """Take a box out of a tank in 3-D: a block on its floor, a column, a step, a dam with a gap.

        Its sides are walls of the tank, ``name`` with "left", "right", "bottom", "top", "back" or "front", as far as
        fluids can reach them. Blocks may overlap, touch each other and the walls; their faces are at least 1.2 spacings
        apart from other faces, those of fills too.

        Args:
            name: of the block.
            box: (lower corner, upper corner) [m]; what is outside of the tank is cut off.
            what: as of `wall`, for all of its sides.

        Returns:
            The tank itself, so that calls can be chained.

        Raises:
            ValueError: the tank is no box in 3-D, the name is taken, the block is outside of it, cuts it in two, or
                touches another one at an edge or a corner alone; or a `Case` has been made of the tank already.
        """
        self._require_open("block")
        here, corners, key = f"block {name!r}", numbers(box), ("blocks", name)
        if self.solid is not None:
            raise Invalid(key, "is taken out of a box; this tank has another shape", here)
        if len(self.size) != 3:
            raise Invalid(key, "is for tanks in 3-D; in 2-D cut it out of the tank's shape, see tipfem.shapes", here)
        if not isinstance(name, str) or not name or name in self._boxes or name in self.sides:
            raise Invalid(key, "has no name of its own; give each block one that no other and no wall has", here)
        if corners.shape != (2, 3) or not (corners[0] < corners[1]).all():
            text = f"is {box!r}; it must be (lower, upper), two corners of 3 coordinates with lower < upper"
            raise Invalid((*key, "box"), text, here)
        if (corners[1] <= 0).any() or (corners[0] >= self.size).any():
            raise Invalid((*key, "box"), f"is {box!r} m, outside the tank of {self.size.tolist()} m", here)
        try:
            blocks = BlockedBox(self.size, {**self._boxes, name: corners})
        except ValueError as error:
            raise Invalid((*key, "box"), f"is {box!r} m; blocks {error}", here) from error
        lost = [side for side in self._walls if side not in blocks.names]
        if outer := [side for side in lost if side.rpartition(" ")[0] not in self._boxes]:
            raise Invalid((*key, "box"), f"is {box!r} m, and nothing is left of the wall {outer[0]!r}", here)
        for side in lost:  # of a block that this one covers there
            del self._walls[side]
        self._boxes[name], self.blocks, self.sides = corners, blocks, blocks.names
        for side in blocks.names if what else ():
            if side.rpartition(" ")[0] == name:
                self.wall(side, **what)
        return self

    @property
    def boxes(self) -> dict[str, Array]:
        """Lower and upper corner (2, 3) of each block [m], by its name."""
        return dict(self._boxes)

    def _require_open(self, what: str) -> None:
        if self._sealed:
            text = f"{what}: a Case has been made of this tank already and would not see the change; describe the tank "
            raise ValueError(f"{text}before, or make a new one")

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
        slack = self.size * (SLACK_OF_BOX if self.is_box else SLACK_OF_SHAPE)
        parts = {"box": box, "disc": disc, "where": where, "shape": shape}
        self._regions.append(region_of(fluid, self.box, slack, velocity, **parts))
        return self

    def add(self, body: Body) -> Tank:
        """Put a rigid body into the tank; in 2-D only. What fills the tank surrounds it.

        Args:
            body: inside the tank, three spacings or more off its walls and off other bodies. One with a ``gap`` may
                touch them, drawn on them or up to 0.1 spacings off: it is put 0.05 spacings off.

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
            raise Invalid(("bodies", body.name), ": bodies are for 2-D only", f"body {body.name!r}")
        if body.name in [other.name for other in self.bodies]:
            raise ValueError(f"add: there is a body {body.name!r} already; every body needs a name of its own")
        self.bodies.append(body)
        return self

    def wall(self, side: str, **what: Any) -> Tank:
        """Make a wall slip, slide or move: ``wall("top", velocity=(1, 0))``, ``wall("left", slip=True)``.

        Straight walls that are not described have the law "layer" in 2-D; for others see `tipfem.case.default_laws`.
        Walls of which only a velocity, a motion or a contact angle is said are no-slip walls.

        Args:
            side: left, right, bottom or top; back or front (low and high z) too in 3-D. The name of a side, where the
                tank has another shape.
            what: law, slip, slip_length, velocity, motion or contact_angle, see `Wall`.

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
        if side == AXIS and self.period.axial:
            raise Invalid(("walls", side), ": it is the axis of symmetry, no wall; leave it out", f"wall {side!r}")
        if side in self._walls:
            raise ValueError(f"wall {side!r} is described twice; give all of its properties in one call")
        if not what or set(what) - set(OPTIONS):
            text = f": {sorted(what)} given; it takes one or more of {sorted(OPTIONS)}"
            raise Invalid(("walls", side), text, f"wall {side!r}")
        Wall(side, particles=[], **what)  # refuses bad values here
        self._walls[side] = what
        return self

    @property
    def box(self) -> Array:
        """(2, d) lower and upper corner of the box around the tank [m]."""
        return np.stack([self.lower, self.upper])

    @property
    def regions(self) -> tuple[Region, ...]:
        """The regions filled by `fill`, in order."""
        return tuple(self._regions)

    @property
    def wall_options(self) -> dict[str, dict[str, Any]]:
        """The arguments of `wall`, by the wall's name; with the law of the others, once a case has chosen one."""
        others = [name for name in self.default_laws if self._options(name)]
        return {name: dict(what) for name, what in self._walls.items()} | {name: self._options(name) for name in others}

    def doubts(self, gravity: Array) -> list[str]:
        """See `Case.doubts`; gravity (d,) [m/s^2]."""
        return misnamed(self._walls, gravity.tolist())

    def walls(self, particles: Particles) -> list[Wall]:
        """The walls that are not fixed and no-slip, on the tank's own particles as `sample` gives them."""
        if self.shape is not None:
            walls = [Wall(name, side=name, **what) for name, what in self.wall_options.items()]
            return [*walls, *([Wall(AXIS, side=AXIS, slip=True)] if self.period.axial and AXIS in self.sides else [])]
        result = []
        for name in [*self._walls, *(side for side in self.sides if side not in self._walls)]:
            what = self._options(name) or ({"law": "no-slip"} if self.solid is not None else {})
            if not what:
                continue
            if (planes := self.blocks or self.solid) is not None:
                reach = self.solid.near if self.solid else 1e-9 * self.spacing
                on = planes.on_edges(particles.position, reach)[:, planes.names.index(name)]
                result.append(Wall(name, particles=particles.wall & on, **what))
                continue
            axis, upper = side_of(name)
            coordinate = float(self.size[axis]) if upper else 0.0
            on_wall = particles.wall & (particles.position[:, axis] == coordinate)
            result.append(Wall(name, particles=on_wall, **what))
        return result

    def holds(self, x: Array) -> Array:
        """Mask (K,) of the positions (K, d) [m] that are in a part that has been filled."""
        inside = np.zeros(len(x), dtype=bool)
        for region in self._regions:
            inside |= region.mask(x)
        return inside

    def sample(
        self, fluids: Sequence[Fluid], *, fitted: bool = False, empty: bool = False, grading: Grading | None = None
    ) -> Particles:
        """Particles of the filled tank, walls included.

        Args:
            fluids: the case's fluids; ``Particles.fluid`` indexes this list.
            fitted: put particles on the faces between two fluids, instead of on both sides of them, and give
                them the heavier one. The sharp interface needs this.
            empty: let parts of the tank be empty. They have no particles except wall particles, whose fluid is -1.
                In 2-D there are particles on the faces of empty parts, which are the initial free surfaces.
            grading: target spacings that thin out the lattice away from interfaces.

        Returns:
            Particles with N of about prod(size / spacing + 1).

        Raises:
            ValueError: a part of the tank is empty, too thin, or holds a fluid that is not in the list; a
                filled part holds no particle off the walls; a ``where`` raised or did not return a mask; a tank in 3-D
                has no jitter.
        """
        self._require_room(graded=grading is not None)
        if len(self.size) == 3 and not self.jitter:
            text = "is 0; a regular lattice in 3-D cannot be meshed, its cubes are cut into simplices without volume; "
            raise Invalid("tank.jitter", f"{text}set jitter, to 0.1 for instance")
        filling = Filling(self._regions, fluids, empty=empty)
        part = filling.fluid if fitted else filling.is_empty if empty and len(self.size) == 2 else None
        points = self._placed(filling, part, filling.is_empty if empty else None, fitted=fitted)
        filling.require_particles(points.position, points.wall, self.spacing)
        if part is not None:
            points = points.fitted(part)
        fluid, on_face = filling.label(points.position), points.on_face
        rank = np.append(ranks(fluids), -1)
        if on_face.any():
            face = points.position[on_face]
            fluid[on_face] = heaviest_beside(face, self.box, self.spacing, filling.fluid, rank, self.period)
        thin, stride = np.ones((2, len(fluid)))
        if grading and not isinstance(points, SolidPoints):  # which the first mesh thins out
            thin, stride = thinned(grading, points, fluid, filling.fluid, fluids, self.spacing)
        if self.jitter:
            by = np.random.default_rng(self.seed).uniform(-1, 1, points.position.shape) * self.jitter * self.spacing
            by *= stride[:, None]
            along_walls = fitted or empty or bool(self.wall_options)
            if part is not None and len(self.size) == 3:
                assert not isinstance(points, ShapePoints)
                points = points.along_faces(by, self.spacing, part)
            points = points.shifted(by, along_walls=along_walls)
        kept = (thin > 0) & (points.wall | (fluid >= 0)) & ~points.images
        position, fluid, wall = self.period.wrapped(points.position)[kept], fluid[kept], points.wall[kept]
        curved = self.jitter or any(region.given and region.box is None for region in self._regions)
        if part is not None and curved and len(self.size) == 2:
            domain = points.domain if isinstance(points, ShapePoints) else None
            stays, added = evened(position, wall, on_face[kept], self.spacing, part, domain)
            new = heaviest_beside(added, self.box, self.spacing, filling.fluid, rank, self.period)
            position, fluid = np.concatenate([position[stays], added]), np.append(fluid[stays], new)
            wall = np.append(wall[stays], np.zeros(len(added), dtype=bool))
        velocity = filling.velocity(position, fluid, self.spacing, self.period)
        velocity[wall] = points.along_walls(position[wall], velocity[wall], self._slips)
        return Particles(position, fluid, wall, velocity, spacing=self.spacing)

    def _require_room(self, *, graded: bool) -> None:
        """Raise ValueError if the particles do not fit into the memory."""
        of_shape = self.solid.whole if self.solid is not None else self.shape and self.shape.area
        content = of_shape or float(np.prod(self.size))
        if wrong := too_many(content, self.spacing, len(self.size), graded=graded):
            raise Invalid("tank.spacing", wrong)

    def _placed(
        self, filling: Filling, part: Part | None, is_empty: Part | None, *, fitted: bool
    ) -> BoxPoints | ShapePoints | SolidPoints:
        """The points that become particles, before they are fitted to faces; see `sample` for errors."""
        faces = [filling.faces(axis) for axis in range(len(self.size))]
        if self.solid is not None:
            return SolidPoints.of(self.solid, self.spacing, faces)
        if self.shape is None and not self.bodies:
            if self.blocks is not None:
                faces = [both | self.blocks.cuts(axis) for axis, both in enumerate(faces)]
            return BoxPoints.of(self.size, self.spacing, faces, self.period, is_empty, self.blocks, fitted=fitted)
        self.domain = self._meshed(part)
        return ShapePoints.of(self.domain, self.box, self.spacing, faces, part, is_empty, fitted=fitted)

    def _slips(self, side: str) -> bool:
        """Whether fluids slide along a wall, or along the outline of the body of that name."""
        for body in self.bodies:
            if body.name == side:
                return body.with_law(self._body_law).slips
        name = AXIS if self.period.axial and side == "left" else side
        return Wall(name, particles=[], **self._options(name)).slips

    def _meshed(self, part: Part | None) -> Domain:
        """The polygon of the tank around its bodies, whose outlines become those of the polygon; see `sample`."""
        outline = shape = self._outline
        touch = self._put_on_skins()
        for body in self.bodies:
            try:
                shape = cut_out(shape, [body.outline])
            except ValueError as error:
                text = f": it must be inside the tank and off all walls: {error}"
                raise self._crowded(_body_invalid(body, text)) from error
        domain = domain_of(shape, self.spacing, part)
        if self.bodies:
            try:
                domain.require_resolved(self.spacing, touch)
            except ValueError as error:
                raise self._crowded(error) from error
        first = len(outline.loops)
        loops = [domain.start[domain.loop == first + k][::-1] for k in range(len(self.bodies))]
        self.bodies = [body.meshed(loop) for body, loop in zip(self.bodies, loops, strict=True)]
        return domain

    def _put_on_skins(self) -> Array | None:
        """Shift bodies drawn on walls or each other a skin apart; the mask of loops that touch, None if none may."""
        if not any(body.gap for body in self.bodies):
            return None
        tank = domain_of(self._outline, self.spacing)
        outlines = [domain_of(body.outline, self.spacing) for body in self.bodies]
        may = np.array([False, *(body.gap is not None for body in self.bodies)])
        shift, touch, left = shifts_apart(outlines, tank, may[:, None] | may, self.spacing)
        if left is not None:
            text = f": it has no room at {rounded(left.place)} m: what touches stays {SKIN:g} spacings apart "
            text += f"({SKIN * self.spacing:.3g} m), on each side of it; make it narrower by {left.missing:.3g} m, or "
            raise _body_invalid(self.bodies[left.number], f"{text}the gap wider")
        self.bodies = [body.moved(by) if by.any() else body for body, by in zip(self.bodies, shift, strict=True)]
        loops = np.append(np.zeros(len(self._outline.loops), dtype=int), 1 + np.arange(len(self.bodies)))
        return np.asarray(touch[np.ix_(loops, loops)])

    @property
    def _outline(self) -> Shape:
        return rectangle(self.lower, self.upper.tolist()) if self.shape is None else self.shape

    def _crowded(self, other: ValueError) -> ValueError:
        """The errors on all bodies that are too close to a wall or to a body before them; another where none is."""
        found, tank, least = list[Invalid](), domain_of(self._outline, self.spacing), LEAST_GAP * self.spacing
        why = f"{least:.4g} m or more ({LEAST_GAP:g} spacings) off all walls and other bodies, for fluid is between "
        why += "them: move it, or choose a smaller spacing"
        outlines = [domain_of(body.outline, self.spacing) for body in self.bodies]

        def may_touch(one: int, other: int) -> bool:
            return self.bodies[one].gap is not None or self.bodies[other].gap is not None

        def touching(one: int, other: int, gap: float) -> bool:
            return may_touch(one, other) and 0 < gap < TOUCHING * self.spacing

        for b, outline in enumerate(outlines):
            gap, place, edge = gap_between(outline, tank, outside=False)
            gap = math.inf if touching(b, b, gap) else gap
            beside, may = f"the wall {tank.sides[tank.side[edge]]!r}", may_touch(b, b)
            for k in range(b):
                both = (outline, outlines[k]), (outlines[k], outline)
                nearest = min((gap_between(*pair, outside=True) for pair in both), key=lambda gap: gap[0])
                if touching(b, k, nearest[0]):
                    continue
                if nearest[0] < gap:
                    gap, place, beside = nearest[0], nearest[1], f"body {self.bodies[k].name!r}"
                    may = may_touch(b, k)
            if gap < least * (1 - 1e-6):
                distance = f"{gap:.4g} m away from" if gap > 0 else "on, or on the wrong side of,"
                text = f": it is {distance} {beside} at {rounded(place)} m; it must be"
                text += f" {least:.4g} m or more off it" if found else f" inside the tank and {why}"
                if may or not found:
                    how = "draw it there, up to 0.1 spacings off" if may else "give it gap = 'seal'"
                    text += f". To let it touch that, {how}"
                found.append(_body_invalid(self.bodies[b], text))
        return found[0] if len(found) == 1 else Several(found) if found else other


def require_near(lower: Array, upper: Array) -> None:
    """Raise ValueError if a tank from ``lower`` to ``upper`` (d,) [m] is too far from the origin."""
    far, size = float(np.abs([lower, upper]).max()), float((upper - lower).max())
    if far > FARTHEST * size:
        text = f": it is {far:.4g} m from the origin and {size:.4g} m wide or high; numbers keep too few digits beyond "
        raise Invalid("tank", f"{text}{FARTHEST:g} times its size. Move it, by {rounded(-np.round(lower))} m")


def _body_invalid(body: Body, text: str) -> Invalid:
    return Invalid(("bodies", body.name), text, f"tank: body {body.name!r}")


@explained("say tank(size=(0.584, 0.584), spacing=0.02)")
def tank(
    size: Sequence[float] | None = None,
    spacing: Any = None,
    *,
    shape: Any = None,
    jitter: float = 0.0,
    seed: int = 0,
    periodic: str | None = None,
    coordinates: str = "planar",
) -> Tank:
    """A closed tank to be filled: ``tank((1, 1), 0.05).fill(air).fill(water, box=((0, 0), (1, 0.5)))``.

    Args:
        size: (d,) edge lengths of a box [m].
        spacing: target distance between particles [m].
        shape: instead of ``size``, in 2-D: a shape of `tipfem.shapes`, a list of corners (x, y) [m], or a polygon of
            shapely, with holes or without. In 3-D: a convex solid of `tipfem.solids`.
        jitter: random displacement of the particles off the walls [spacings]; needed in 3-D.
        seed: of the random displacement.
        periodic: "x" for a box in 2-D without walls on the left and right, where what leaves on one side enters on the
            other: channels, shear layers, waves without side walls; "xy" for one without any walls.
        coordinates: "axisymmetric" for a round tank: ``size`` is its radius and its height, positions are (r, z), and
            the left side of the box is the axis. Volumes, energies and forces are those of the whole of it.

    Raises:
        ValueError: an argument is missing or out of range, see `Tank`.
    """
    if (size is None) == (shape is None):
        raise Invalid("tank", ": give either its size, for a box, or its shape")
    if shape is not None and periodic is not None:
        raise Invalid("tank.periodic", f"is {periodic!r}; a tank with a shape has walls all around")
    if shape is not None and not isinstance(shape, Solid):
        shape = Shape.of(shape)
    return Tank(size, spacing, jitter, seed, periodic, shape, coordinates)

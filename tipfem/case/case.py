"""Case: the flow to be simulated - particles, fluids, forces, walls."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.arguments import numbers
from tipfem.case.axisymmetric import NAMES, around_axis, require_axisymmetric
from tipfem.case.beaches import Beach, zones_of
from tipfem.case.body import Body, require_gaps
from tipfem.case.body import doubts as of_bodies
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.default_laws import Setting, default_body_law
from tipfem.case.fluid import Fluid, checked_fluids, described_viscosity, typical_viscosity, without_layers
from tipfem.case.grading import Grading
from tipfem.case.largest_step import DEFAULT, RESOLVED
from tipfem.case.numerics import FittedRule, Numerics, SurfaceRule
from tipfem.case.open_lines import check_layers, entering_speed
from tipfem.case.openings import LIQUID, Inlet, Opening, Outlet, came_back, check_balance
from tipfem.case.particle_checks import require_apart, require_labels, require_walls_around, require_walls_at_rest
from tipfem.case.particles import Particles
from tipfem.case.region import Filling
from tipfem.case.rheology import Law
from tipfem.case.surface_tension import Pair, TensionTable, tension_contradictions
from tipfem.case.tank import Tank
from tipfem.case.walls import Drawn, Motion, Wall, left_contacts
from tipfem.errors import Invalid
from tipfem.geometry.blocks import BlockedBox
from tipfem.geometry.period import Period, no_period
from tipfem.geometry.place import places
from tipfem.geometry.plane.domain import Domain, around_bodies, domain_of
from tipfem.geometry.plane.shapes import Shape
from tipfem.notebook import facts
from tipfem.typing import Array

# The names of the interface rules; `tipfem.mesh.interface` has their classes.
INTERFACES = ("interpolated", "sharp")
DEFAULT_INTERFACE = "sharp"
# By default, displacements of the fastest particle in a step, and the error of the time integration in it [spacings].
NEAR, FAR, TOLERANCE = 0.5, 2.0, 8e-4
# In full tanks in 3-D fronts flatten cells of what is before them: see `StepControl.shorter` [spacings, J].
SHORTER = 0.25, 0.1
SAME_HEIGHT = 1e-9  # relative difference of heights by round-off
# A wall particle closer than this to the outline of a body is on the body [spacings].
ON_BODY = 1e-3


class Case:
    """A flow to be simulated.

    Args:
        particles: the initial state, or a filled `Tank`, which cannot be changed afterwards.
        fluids: the fluids that the particles' labels index; at least one.
        gravity: (d,) acceleration [m/s^2].
        body_force: function of positions (N, d) [m] and time [s] to further accelerations (N, d)
            [m/s^2], or None.
        interface: "sharp": every cell belongs to one fluid, and interfaces run along edges, in 3-D along faces; or
            "interpolated", the rule of Carvalho & Sanches, which free surfaces in 3-D do not have. By default sharp.
        free_surface: whether fluids may end at a free surface, where the pressure is zero. A tank may then be
            filled in part. Particles given as arrays need walls wherever fluids may flow to.
        numerics: parameters of the method.
        title: the heading of pictures.
        walls: walls that slip, slide or move, in addition to those described in a tank; where there are some, all
            others are fixed and no-slip, otherwise see `tipfem.case.default_laws`. They are the outer walls: together
            they form the convex hull of a closed case.
        tank_motion: rigid motion of all walls together, or None.
        grading: target distances that grow from the spacing at interfaces to larger values away from them; None for
            the same distance everywhere. With the sharp interface only.
        bodies: rigid bodies in the fluids, for particles given as arrays, which have wall particles on the bodies'
            outlines; a tank has its own, see `Tank.add`.
        shape: of the region that the walls enclose, for particles given as arrays in 2-D, as of `tipfem.tank`; None for
            their convex hull. There must be a wall particle at each of its corners; for a round wall give the polygon
            of the wall particles.
        period: (d,) width of the domain along each periodic axis [m], 0 along others, for particles given as arrays;
            in 2-D the first axis may be periodic, or both. A tank has its own.
        surface_tension: by the names of two fluids, as ``{("water", "air"): 0.0728}``, or of one at a free surface
            [N/m]; none by default. With the sharp interface, or with a free surface, in 2-D.
        openings: inlets, outlets and vents in the walls, see `tipfem.Inlet`, `tipfem.Outlet` and `tipfem.Vent`; in 2-D,
            with the sharp interface.
        beaches: where the fluids are damped, see `tipfem.Beach`; in 2-D.
        coordinates: "axisymmetric" where positions (N, 2) are (r, z) of a flow around the axis r = 0, for particles
            given as arrays; a tank has its own, see `tipfem.tank`.

    Attributes:
        particles: the initial state, sampled from the tank if one was given.
        fluids: list of the fluids.
        gravity: (d,) array [m/s^2].
        interface: name of the interface rule.
        walls: list of the walls that slip, slide or move.
        boundary: the walls on the particles.
        domain: the polygon that bounds the fluids, of a tank with a shape; None for the convex hull of the particles.
        blocks: the box of a tank in 3-D with the blocks in it; None without any.
        period: of the positions.
        bodies: list of the bodies.
        surface_tension: that of each interface, see `tipfem.case.surface_tension.TensionTable`.
        openings: list of the openings.
        beaches: list of the zones in which fluids are damped.
        contact_cosines: cosines of the contact angles on each of ``walls``, see `TensionTable.cosines`.
        body_cosines: the same on each of ``bodies``.
        body_label: (N,) number of the body that each particle is on, -1 for none.
        tank: the tank that the particles were sampled from; None for particles given as arrays.
        walls_have_fluids: whether the wall particles' fluids are known (from a tank) and need not be taken from
            their neighbours.
        filled: function of positions (K, d) [m] to a mask (K,) of those in a fluid at the start; None for
            particles given as arrays.
        filling: the tank's regions with the fluids; None where there are none.

    Raises:
        ValueError: arguments are invalid or contradict each other; the message names them and the valid values.
    """

    def __init__(
        self,
        particles: Particles | Tank,
        fluids: Sequence[Fluid],
        gravity: Sequence[float] | Array,
        body_force: Callable[[Array, float], Array] | None = None,
        interface: str | None = None,
        free_surface: bool = False,
        numerics: Numerics | None = None,
        title: str = "",
        walls: Sequence[Wall] = (),
        tank_motion: Motion | None = None,
        grading: Grading | None = None,
        bodies: Sequence[Body] = (),
        shape: Any = None,
        period: Sequence[float] | None = None,
        surface_tension: Mapping[Pair, float] | None = None,
        openings: Sequence[Opening] = (),
        beaches: Sequence[Beach] = (),
        coordinates: str = "planar",
    ) -> None:
        self.fluids = checked_fluids(fluids)
        self.free_surface = free_surface
        dimension = len(particles.size) if isinstance(particles, Tank) else getattr(particles, "dimension", None)
        self.interface = _checked_interface(interface, free_surface)
        self.surface_tension = TensionTable(surface_tension, self.fluids, empty=free_surface)
        self.body_force = body_force
        self.numerics = Numerics() if numerics is None else numerics
        if not isinstance(title, str):
            raise Invalid("title", f"is {title!r}; it must be a text", "Case")
        self.title = title
        self.tank_motion = tank_motion
        self.grading = grading
        self._check_options(dimension)
        self.walls: list[Wall] = _checked_list("walls", walls, Wall, "Wall")
        self.walls_have_fluids = False
        self.filled: Callable[[Array], Array] | None = None
        self.filling: Filling | None = None
        self.tank: Tank | None = None
        self.domain: Domain | None = None
        if isinstance(particles, Tank):
            self.tank = tank = particles
            if tank.period:
                self._check_periodic()
            tank.choose_laws(
                Setting(
                    len(tank.size),
                    self.interface == "sharp",
                    bool(self.walls),
                    self.grading is not None,
                    any(without_layers(fluid) for fluid in self.fluids),
                    full=not self.free_surface,
                )
            )
            particles = tank.sample(
                self.fluids, fitted=self.interface == "sharp", empty=self.free_surface, grading=self.grading
            )
            self.domain = tank.domain
        if not isinstance(particles, Particles):
            raise ValueError(f"Case: particles is a {type(particles).__name__}; it must be a Particles or a tank")
        self.blocks = shape if isinstance(shape, BlockedBox) else None if self.tank is None else self.tank.blocks
        if (self.blocks or (self.tank and self.tank.solid)) and self.interface != "sharp":
            what = "with blocks" if self.blocks else "with sloping walls"
            raise Invalid("interface", f"is {self.interface!r}; a tank {what} needs 'sharp'", "Case")
        if shape is not None and self.blocks is None:
            if self.tank is not None or particles.dimension != 2:
                text = "Case: shape is given; it is for particles given as arrays, in 2-D; a tank has its own"
                raise ValueError(text)
            self.domain = shape if isinstance(shape, Domain) else domain_of(Shape.of(shape), particles.spacing)
        self.particles = particles
        if self.tank is not None:
            self.walls_have_fluids, self.filled = True, self.tank.holds
            if self.tank.regions:
                self.filling = Filling(self.tank.regions, self.fluids, empty=self.free_surface)
            self.walls = [*self.tank.walls(particles), *self.walls]
        self.period = self._checked_period(period, coordinates)
        self.coordinates = NAMES[self.period.axial]
        self.contact_cosines = [self.surface_tension.cosines(wall) for wall in self.walls]
        held = [
            w.name for w, each in zip(self.walls, self.contact_cosines, strict=True) if any(h for _, h in each.values())
        ]
        if held and particles.dimension == 3:
            text = "has two angles, between which a contact is held; in 3-D give one"
            raise Invalid(("walls", held[0], "contact_angle"), text, f"wall {held[0]!r}")
        if tank_motion is not None and held:
            text = "is given with two contact angles of a wall; only a tank at rest holds contacts between them"
            raise Invalid("tank_motion", text, "Case")
        self.gravity = self._checked_gravity(gravity)
        self.bodies = self._checked_bodies(bodies)
        self.body_cosines = [self.surface_tension.cosines(body, "bodies") for body in self.bodies]
        self.body_label = self._labelled(particles)
        if self.bodies and self.domain is None:
            self.domain = around_bodies(particles.position, particles.spacing, [body.corners for body in self.bodies])
        self.openings = self._checked_openings(openings)
        self.is_box = particles.dimension == 2 and shape is None and (self.tank is None or self.tank.is_box)
        box = self._box_sides() if self.is_box and (self.openings or beaches) else {}
        self._check_particles(particles)
        self.boundary = Boundary(
            particles,
            self.walls if (drawn := self._drawn) is None else drawn.carrying(self.walls),
            self.tank_motion,
            self.domain if self.blocks is None else self.blocks,
            fixed_volume=not self.grounded,
            room=self.has_room,
            period=self.period,
            bodies=len(self.bodies),
            openings=self.openings,
            sides=box,
            normal=[o.normal(len(self.fluids)) for o in self.openings],
            joins=self.interface == "sharp",
        )
        self._check_surface()
        self._check_laws()
        if self.period.axial:
            require_axisymmetric(self)
        refused = {"the case is in 3-D": self.particles.dimension != 2, "tank_motion is given": tank_motion is not None}
        refused["sides are periodic"], refused["the flow is axisymmetric"] = bool(self.period), self.period.axial
        why = next((what for what, there in refused.items() if there), "")
        self.beaches = zones_of(beaches, self.boundary.domain, box, 1e-9 * particles.spacing, why)
        if (passages := self.boundary.passages) is not None:
            places = [self.particles.position[on] for on in passages.nodes]
            check_layers(self.boundary.lines, places, [fluid.name for fluid in self.fluids])
        if self.openings and self.tank is not None:
            self.particles = self._moving_at_openings(self.tank)
            self._check_inlets_are_wet(self.tank)
        if self.tank is not None:
            self.tank.seal()

    @property
    def potential_gravity(self) -> Array:
        """(d,) gravity where it has a potential [m/s^2]; along periodic sides its work is external."""
        return np.where(self.period.width > 0, 0.0, np.asarray(self.gravity, dtype=float))

    @property
    def box(self) -> Array:
        """(2, d) lower and upper corner of the box around the walls at the start, or of the period [m]."""
        position = self.particles.position[self.particles.wall | self.period.everywhere]
        ends = np.stack([position.min(axis=0), position.max(axis=0)])
        return np.where(self.period.width > 0, [np.zeros_like(self.period.width), self.period.width], ends)

    @property
    def extent(self) -> Array:
        """(d,) of the particles at the start; along periodic axes the period [m]."""
        return np.where(self.period.width > 0, self.period.width, np.ptp(self.particles.position, axis=0))

    @property
    def two_sided(self) -> bool:
        """Whether each fluid has a pressure of its own on interfaces, see `tipfem.Numerics`."""
        chosen = self.numerics.pressure
        return chosen == "two-sided" or (chosen == "auto" and self.interface == "sharp" and len(self.fluids) > 1)

    def came_back(self, history: Sequence[Mapping[str, float]]) -> dict[str, str]:
        """Lines on openings by which much of what left has come back, or liquids leave; by the rows of a history."""
        lightest = min(fluid.density for fluid in self.fluids)
        liquids = [fluid.name for fluid in self.fluids if fluid.density > LIQUID * lightest]
        least = self.particles.spacing ** (3 if self.period.axial else 2)
        return came_back(self.openings, history, liquids, least)

    @property
    def _has_surfaces(self) -> bool:
        """Whether fluids may have surfaces: it holds several, or is not full."""
        return len(self.fluids) > 1 or bool((self.particles.fluid < 0).any())

    @property
    def _drawn(self) -> Drawn | None:
        """Film that no-slip walls draw out as they slide; None without surfaces, or where they are interpolated."""
        if not self._has_surfaces or self.interface != "sharp":
            return None
        fluid = max(self.fluids, key=lambda each: each.density)
        gravity = float(np.linalg.norm(self.gravity))
        fluids = self.particles.fluid if self.particles.dimension == 3 else None
        return Drawn(fluid.name, typical_viscosity(fluid) / fluid.density, gravity, self.particles.spacing, fluids)

    def doubts(self) -> list[str]:
        """Lines on what can be simulated, but not as it may be meant; a simulation of the case warns of them."""
        found = self.surface_tension.doubts(empty=self.free_surface)
        if self._has_surfaces:
            found += left_contacts(self.boundary.walls, self._drawn)
        if self.bodies:
            found += of_bodies(self.bodies, self.boundary.tank_at(0.0), self.potential_gravity, self.particles.spacing)
        return found if self.tank is None else found + self.tank.doubts(self.gravity)

    def slips(self) -> list[str]:
        """Lines on probable slips of units, which commands show."""
        angles = [(f"wall {wall.name!r}", wall.contact_angle) for wall in self.walls]
        angles += [(f"body {body.name!r}", body.contact_angle) for body in self.bodies]
        size = float(self.extent.max()), float(np.linalg.norm(self.gravity))
        return self.surface_tension.slips(*size, angles, empty=self.free_surface)

    def _check_options(self, dimension: int | None) -> None:
        """Check the options that can be checked without the particles."""
        if self.body_force is not None and not callable(self.body_force):
            raise Invalid("body_force", f"is {self.body_force!r}; it must be a function of positions and time", "Case")
        for name, kind in (("numerics", Numerics), ("tank_motion", Motion), ("grading", Grading)):
            value = getattr(self, name)
            if not isinstance(value, kind) and (value is not None or name == "numerics"):
                raise Invalid(name, f"is {value!r}; it must be a {kind.__name__}", "Case")
        self._check_interface(dimension)

    def _check_interface(self, dimension: int | None = None) -> None:
        """Raise ValueError for what the interface rule rules out."""
        for path, text in contradictions(
            self.interface,
            free_surface=self.free_surface,
            pressure=self.numerics.pressure,
            graded=self.grading is not None,
            dimension=dimension,
            tension=self.surface_tension.given,
        ):
            raise Invalid(path, text, "Case")

    def _check_surface(self) -> None:
        """Raise ValueError for lengths of a rule that the case does not have."""
        if self.free_surface and self.interface == "sharp" and self.numerics.surface != SurfaceRule():
            text = "is given; it is for free surfaces with interface = 'interpolated'; those of 'sharp' follow fitting"
            raise Invalid("numerics.surface", text, "Case")
        rule = self.numerics.fitting
        if self.particles.dimension == 3 and rule != FittedRule(thin_film=rule.thin_film):
            raise Invalid("numerics.fitting", "is given in 3-D, where thin_film alone has a meaning", "Case")

    def _check_laws(self) -> None:
        """Refuse what laws of viscosity do not go with."""
        lawful = [fluid for fluid in self.fluids if isinstance(fluid.viscosity, Law)]
        if lawful and self.interface != "sharp" and len(self.fluids) > 1:
            text = "follows a law, and cells of several fluids have one viscosity: interface must be 'sharp', in 2-D"
            raise Invalid(("fluids", lawful[0].name, "viscosity"), text, f"Fluid {lawful[0].name!r}")
        thick = next((fluid for fluid in lawful if without_layers(fluid)), None)
        for kind, members in (("wall", self.walls), ("body", self.bodies)):
            layered = next((member for member in members if member.law == "layer"), None)
            if thick is not None and layered is not None:
                text = f"is 'layer', and {thick.name} follows a law of viscosity, which has no such walls: "
                path = ("walls" if kind == "wall" else "bodies", layered.name, "law")
                raise Invalid(path, f"{text}it must be 'no-slip'", f"{kind} {layered.name!r}")

    def _checked_period(self, given: Sequence[float] | None, coordinates: str) -> Period:
        """The period of the positions, that of the tank if there is one; see the class for errors."""
        position = self.particles.position
        if self.tank is not None:
            if given is not None:
                raise ValueError(f"Case: period is {given!r} beside a tank; say tank(..., periodic='x') or 'xy'")
            if coordinates != "planar":
                text = f"is {coordinates!r} beside a tank; say tank(..., coordinates={coordinates!r})"
                raise Invalid("coordinates", text, "Case")
            period = self.tank.period
        elif coordinates != "planar":
            period, self.walls = around_axis(self, coordinates, periodic=given is not None)
        elif given is None:
            return no_period(self.particles.dimension)
        else:
            width = numbers(given)
            if position.shape[1] != 2 or width.shape != (2,) or not (0 < width[0] < np.inf and 0 <= width[1] < np.inf):
                text = f"Case: period is {given!r}; it must be (width, 0) or (width, height), in metres, for particles "
                raise ValueError(f"{text}in 2-D: the first axis may be periodic, or both")
            period = Period(width)
            for k in period.axes:
                outside = (position[:, k] < 0) | (position[:, k] >= width[k])
                if outside.any():
                    i = int(np.argmax(outside))
                    text = f": particle {i} at {position[i].tolist()} is outside the period, 0 <= {'xy'[k]} < "
                    raise Invalid("particles", f"{text}{width[k]:g} m", "Case")
        if period:
            self._check_periodic()
        return period

    def _check_periodic(self) -> None:
        """Raise ValueError for what cannot be combined with periodic sides."""
        refused = {
            "free_surface is True": self.free_surface,
            "a grading is given": self.grading is not None,
            "tank_motion is given": self.tank_motion is not None,
            "shape is given": self.domain is not None,
            "there are bodies": self.tank is not None and bool(self.tank.bodies),
            "a wall has a motion": any(wall.motion is not None for wall in self.walls),
            "a wall is part of a side (between)": any(wall.between is not None for wall in self.walls),
        }
        for what, given in refused.items():
            if given:
                text = f": {what}, which cannot be combined with periodic sides; leave one of them out"
                raise Invalid("tank.periodic", text, "Case")

    def _checked_gravity(self, gravity: Sequence[float] | Array) -> Array:
        d, given = self.particles.dimension, numbers(gravity)
        if given.shape != (d,) or not np.isfinite(given).all():
            raise Invalid("gravity", f"is {gravity!r}; it must be {d} finite accelerations in m/s^2", "Case")
        if given.any() and self.period.everywhere:
            text = f"is {given.tolist()} m/s^2 in a domain that is periodic in all directions; no wall holds the "
            text += "fluids there, and they would fall forever: set it to 0, or keep walls in one direction"
            raise Invalid("gravity", text, "Case")
        return given

    def _checked_bodies(self, bodies: Sequence[Body]) -> list[Body]:
        """The bodies as a list, those of the tank if there is one; see the class for errors."""
        result: list[Body] = _checked_list("bodies", bodies, Body, "Body")
        if result and self.tank is not None:
            raise Invalid("bodies", "are given beside a tank; put them into the tank by tank.add(body)", "Case")
        result = result if self.tank is None else list(self.tank.bodies)
        names = [body.name for body in result]
        if len(set(names)) < len(names):
            raise Invalid("bodies", f"are named {names}; every body needs a name of its own", "Case")
        if result and (self.particles.dimension != 2 or self.period.axial):
            where = "planar flows" if self.period.axial else "2-D"
            raise ValueError(f"Case: there are bodies ({', '.join(names)}), which are for {where} only")
        if self.numerics.jacobian == "matrix-free" and any(body.floats for body in result):
            raise ValueError("Case: with Numerics(jacobian='matrix-free') no body can float; say jacobian='rows'")
        sharp = self.interface == "sharp"
        if not sharp and (slipping := [body for body in result if body.slips]):
            text = ": fluids slip along it, which needs interface = 'sharp'; say law = 'no-slip'"
            if not slipping[0].slips_everywhere:
                text = ": it has a contact_angle, which needs interface = 'sharp' on a body"
            raise Invalid(("bodies", slipping[0].name), text, f"body {slipping[0].name!r}")
        surface = "free_surface = true, in a full tank, too: its gap is empty space"
        at_rest = "a tank at rest where a body floats; leave tank_motion out"
        still = self.tank_motion is None or not any(body.floats for body in result)
        needs = {surface: self.free_surface, "interface = 'sharp'": sharp, at_rest: still}
        full = self.walls_have_fluids and bool((self.particles.fluid >= 0).all())
        room = "empty space above the fluids, where a body floats; in a full tank say gap = 'seep'"
        needs[room] = not full or not any(body.floats and body.gap == "seal" for body in result)
        one = "one fluid in a full tank, where a body floats: its gap would take one fluid up and give another back"
        needs[one] = not full or len(self.fluids) == 1 or not any(body.floats for body in result)
        require_gaps(result, needs)
        thick = any(without_layers(fluid) for fluid in self.fluids)
        return [body.with_law(default_body_law(sharp=sharp and not thick)) for body in result]

    def _checked_openings(self, given: Sequence[Opening]) -> list[Opening]:
        """The openings as a list; see the class for errors."""
        result: list[Opening] = _checked_list("openings", given, Inlet | Outlet, "Inlet, Outlet and Vent")
        refused = {
            "the case is in 3-D": self.particles.dimension != 2,
            f"interface is {self.interface!r}": self.interface != "sharp",
            "sides are periodic": bool(self.period),
            "tank_motion is given": self.tank_motion is not None,
            "budget is 'detailed'": self.numerics.budget == "detailed",
            "jacobian is 'matrix-free'": self.numerics.jacobian == "matrix-free",
            "volume_correction is 0": self.numerics.volume_correction == 0,
        }
        for opening in result:
            for what, there in refused.items():
                if there:
                    raise opening.invalid("", f": {what}, with which openings do not work")
            if getattr(opening, "head", None) is not None and not np.any(self.gravity):
                raise opening.invalid("head", "is a height of fluid, which weighs nothing here; give gravity")
            opening.fluids([f.name for f in self.fluids])
        check_balance(result, self.free_surface)
        return result

    def _moving_at_openings(self, tank: Tank) -> Particles:
        """The particles, with those at openings as fast as the fluids that fill the tank there."""
        passages, boundary = self.boundary.passages, self.boundary
        assert passages is not None
        on = np.unique(np.concatenate(passages.nodes))
        fast = np.zeros((len(on), 2))
        for region in tank.regions:
            here = region.mask(self.particles.position[on])
            fast[here] = region.initial_velocity(self.particles.position[on[here]])
        free = np.zeros((len(self.particles), 2, 2))
        free[boundary.index], free[passages.open] = boundary.free, np.eye(2)
        velocity = self.particles.velocity.copy()
        velocity[on] = np.einsum("kij,kj->ki", free[on], fast)
        return self.particles.shallow_copy(velocity=velocity)

    def _check_inlets_are_wet(self, tank: Tank) -> None:
        """Check that under a free surface fluid stands before each inlet; see the class for errors."""
        assert self.boundary.passages is not None
        for line, on in zip(self.boundary.lines, self.boundary.passages.nodes, strict=True):
            if self.free_surface and line.opening.velocities:
                before = self.particles.position[on] + self.particles.spacing * line.inwards
                dry = ~tank.holds(before[1:-1])
                if dry.any():
                    where = f"at {np.round(before[1:-1][np.argmax(dry)], 6).tolist()} m"
                    text = f": there is no fluid before it, {where}; fill a strip 2 spacings wide with what enters"
                    raise line.opening.invalid("", text)

    def _box_sides(self) -> dict[str, Array]:
        """A point (2,) on each wall of a box, with NaN where any coordinate will do [m]."""
        box, none = self.box, np.nan
        return {
            "left": np.array([box[0, 0], none]),
            "right": np.array([box[1, 0], none]),
            "bottom": np.array([none, box[0, 1]]),
            "top": np.array([none, box[1, 1]]),
        }

    def _labelled(self, particles: Particles) -> Array:
        """(N,) number of the body that each particle is on, -1 for none."""
        label = np.full(len(particles), -1, dtype=np.int32)
        wall = np.flatnonzero(particles.wall)
        for number, body in enumerate(self.bodies):
            on = wall[body.distance(particles.position[wall]) < ON_BODY * particles.spacing]
            if len(on) < 3:
                text = f": only {len(on)} wall particles are on the outline of body {body.name!r}; it needs 3 or more"
                raise Invalid(("bodies", body.name), text, "Case")
            label[on] = number
        return label

    def _check_particles(self, particles: Particles) -> None:
        if self.grading:
            largest = self.grading.of_fluids([f.name for f in self.fluids], particles.spacing)
            inside = np.zeros(len(particles), dtype=bool)
            self.grading.sizing(particles.position, particles.fluid, inside, largest, particles.spacing)
        require_labels(particles, len(self.fluids), dry_walls=self.free_surface)
        self._check_interface(particles.dimension)
        require_apart(particles)
        require_walls_at_rest(particles, moving=bool(self.walls) or self.tank_motion is not None)
        inner = (self.body_label >= 0) | (self.free_surface and particles.dimension == 2) | (self.blocks is not None)
        require_walls_around(particles, self.period, self.domain, inner)

    def _repr_html_(self) -> str:
        """For notebooks."""
        return facts(
            f"Case: {self.title or 'without a title'}",
            {
                "fluids": ", ".join(
                    f"{f.name} ({f.density:g} kg/m³, {described_viscosity(f.viscosity)})" for f in self.fluids
                ),
                "size": f"{' x '.join(f'{edge:g}' for edge in self.extent)} m",
                "spacing": f"{self.particles.spacing:g} m",
                "particles": f"{len(self.particles)}, {int(self.particles.wall.sum())} of them on walls",
                "interface": f"{self.interface}{', free surface' if self.free_surface else ''}",
            },
        )

    def fluid_index(self, name: str | Fluid) -> int:
        """Index of a fluid, given by its name or itself; `ValueError` if there is no such fluid."""
        if isinstance(name, Fluid) and name in self.fluids:
            return self.fluids.index(name)
        names = [f.name for f in self.fluids]
        if not isinstance(name, str) or name not in names:
            raise ValueError(f"there is no fluid {name!r} in this case; it has {names}")
        return names.index(name)

    def entering_speed(self) -> float:
        """See `tipfem.case.openings.entering_speed`; for the fluids at the start."""
        passages = self.boundary.passages
        if passages is None:
            return 0.0
        position, filled = self.particles.position, self.particles.fluid >= 0
        places = [position[on] for on in passages.nodes]
        return entering_speed(self.boundary.lines, places, position[filled], self.gravity)

    @property
    def has_room(self) -> bool:
        """Whether there is empty space, into which fluids may enter though none leaves."""
        return self.free_surface

    @property
    def grounded(self) -> bool:
        """Whether the pressure is given somewhere, so that it is no longer known up to a constant only.

        Then the volume of the fluids is not that of the tank, or fluids can leave it: walls may change it.
        """
        return self.free_surface or any(not opening.velocities for opening in self.openings)

    def acceleration(self, position: Array, time: float) -> Array:
        """Gravity and body force per mass (N, d) [m/s^2] at positions (N, d) [m] and a time [s].

        Raises:
            ValueError: the body force has the wrong shape or is not finite.
        """
        force: Array = np.tile(self.gravity, (len(position), 1))
        if self.body_force is not None:
            # Of a copy: the function may work in place.
            extra = np.asarray(self.body_force(position.copy(), time), dtype=float)
            if extra.shape == position.shape and not np.isfinite(extra).all():
                i = int(np.argmin(np.isfinite(extra).all(axis=1)))
                text = f"Case: body_force at t = {time:g} s gave {extra[i].tolist()} at {position[i].tolist()}; it "
                raise ValueError(f"{text}must be finite accelerations")
            if extra.shape != position.shape:
                text = f"Case: body_force at t = {time:g} s gave shape {extra.shape}; it must be finite accelerations "
                raise ValueError(f"{text}of shape {position.shape}")
            force += extra
        return np.asarray(force)

    def natural_frequency(self) -> float:
        """Frequency of the fastest motion that forces drive at the scale of a spacing [1/s].

        It is that of `gravity_frequency`, or with tension 0.05 over the capillary time, if more; a step of 0.05 over it
        resolves this motion.
        """
        return max(self.gravity_frequency(), RESOLVED / self.surface_tension.capillary_time(self.particles.spacing))

    @property
    def _far(self) -> bool:
        """Whether particles may move far in a step, by default: where the elements tell what a step can deform.

        In 2-D there are none between a free surface and what it is about to meet. Inlets and outlets cut off what
        enters and leaves in a step. And where the interpolated interface follows particles, their cells are made anew
        after each step. Without gravity and tension no force limits the step, and an error in spacings does not see a
        disturbance that is small beside one.
        """
        cut = self.openings or (self.free_surface and self.particles.dimension == 2) or self.interface != "sharp"
        return not cut and self.numerics.largest_move is None and math.isfinite(self.default_step())

    @property
    def largest_move(self) -> float:
        """Target of the step control for the displacement of the fastest particle [spacings]."""
        return FAR if self._far else self.numerics.largest_move or NEAR

    @property
    def step_control(self) -> dict[str, Any]:
        """The step control's ``target``, ``tolerance``, ``free`` and ``shorter``, see `StepControl` [spacings].

        A given tolerance holds for all steps, the default for those in which particles move by more than `NEAR`, so
        that steps are never more than with moves up to it.
        """
        tolerance, found = self.numerics.time_tolerance, dict[str, Any](target=self.largest_move)
        if self.particles.dimension == 3 and not self.free_surface:
            found["shorter"] = SHORTER
        by_default = tolerance is None and self._far
        return {**found, "tolerance": TOLERANCE if by_default else tolerance or math.inf, "free": NEAR * by_default}

    def default_step(self) -> float:
        """Largest time step where none is given [s]: 0.1 over `gravity_frequency`, or the capillary time if shorter.

        Infinite without gravity, body force and surface tension.
        """
        gravity, capillary = self.gravity_frequency(), self.surface_tension.capillary_time(self.particles.spacing)
        return min(DEFAULT / gravity, capillary) if gravity else capillary

    def restoring_acceleration(self) -> float:
        """Largest acceleration of a particle that is off by a spacing, by other forces than gravity [m/s^2]."""
        return self.surface_tension.acceleration(self.particles.spacing)

    def gravity_frequency(self) -> float:
        """Frequency sqrt(|b| / h) with the largest acceleration b by gravity and body force at the start [1/s]."""
        force = self.acceleration(self.particles.position, 0.0)
        return float(np.sqrt(np.linalg.norm(force, axis=1).max() / self.particles.spacing))

    def pressure_reference(self) -> int:
        """The wall particle, highest against all forces, at which a closed tank's pressure is zero; -1 without walls.

        Of several at the same height, the first by its place (`tipfem.geometry.place`); without walls the mean is zero.
        """
        # Corners neither slide nor are relocated; a curve all around has none, and remeshing keeps the particle there.
        if not self.particles.wall.any() or any(not opening.velocities for opening in self.openings):
            return -1
        stays = self.boundary.stays
        wall = np.flatnonzero(stays if stays.any() else self.particles.wall)
        position = self.particles.position[wall]
        height = -position @ self.acceleration(self.particles.position, 0.0).mean(axis=0)
        highest = np.flatnonzero(height >= height.max() - SAME_HEIGHT * np.abs(height).max())
        return int(wall[highest[np.argmin(places(position[highest]))]])


def contradictions(
    interface: str,
    *,
    free_surface: bool,
    pressure: str,
    graded: bool,
    dimension: int | None = None,
    tension: Mapping[Pair, Any] | None = None,
) -> Iterator[tuple[str, str]]:
    """Contradictions between a case and its interface rule: keys of wrong values, with reasons; d None is unknown."""
    if graded and interface != "sharp":
        yield "grading", f"is given with interface = {interface!r}; it needs 'sharp'"
    if pressure == "two-sided" and interface != "sharp":
        why = "a free surface has" if free_surface else f"interface is {interface!r}, which has"
        yield (
            "numerics.pressure",
            f"is 'two-sided'; {why} one pressure for all fluids: it must be 'auto' or 'continuous'",
        )
    if dimension == 3 and interface != "sharp" and free_surface:
        yield "interface", f"is {interface!r} with a free surface in 3-D; it must be 'sharp' there"
    if tension:
        pairs = any(not isinstance(pair, str) for pair in tension)
        for text in tension_contradictions(interface, pressure=pressure, pairs=pairs):
            yield "surface_tension", text


def _checked_list(name: str, given: Any, kind: Any, words: str) -> list[Any]:
    """An argument of a case as a list of a kind; see `Case` for errors."""
    if not (isinstance(given, Sequence) and all(isinstance(one, kind) for one in given)):
        raise Invalid(name, f"is {given!r}; it must be a list of {words}", "Case")
    return list(given)


def _checked_interface(interface: str | None, free_surface: bool) -> str:
    """The name of the interface rule; see `Case` for errors."""
    if not isinstance(free_surface, bool):
        raise Invalid("free_surface", f"is {free_surface!r}; it must be True or False", "Case")
    if interface is None:
        return DEFAULT_INTERFACE
    if not isinstance(interface, str) or interface not in INTERFACES:
        raise Invalid("interface", f"is {interface!r}; it must be one of {sorted(INTERFACES)}", "Case")
    return interface

"""Case: what is simulated - particles, fluids, forces, walls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from tipfem.arguments import numbers
from tipfem.case.boundary import Boundary
from tipfem.case.fluid import Fluid
from tipfem.case.grading import Grading
from tipfem.case.numerics import Numerics
from tipfem.case.particles import Particles
from tipfem.case.tank import Tank
from tipfem.case.walls import Motion, Wall
from tipfem.typing import Array

INTERFACES = ("interpolated", "sharp")
DEFAULT_INTERFACE = "sharp"
SURFACE_INTERFACE = "interpolated"  # the default with a free surface


@dataclass
class Case:
    """A flow to be simulated.

    Attributes:
        particles: the initial state, or a filled `Tank`.
        fluids: the fluids that the particles' labels index; at least one.
        gravity: (d,) acceleration [m/s^2].
        body_force: function of positions (N, d) [m] and time [s] to further accelerations (N, d)
            [m/s^2], or None.
        interface: "sharp": every element belongs to one fluid, and interfaces run along edges (2-D only); or
            "interpolated", the rule of Carvalho & Sanches. By default sharp, with a free surface interpolated.
        free_surface: whether the fluids may end where nothing is: at zero pressure. A tank may then be filled in
            part; particles given as arrays need walls all around, too, where fluids may come to.
        numerics: the method's numbers.
        title: what pictures are headed with.
        walls: those that slip, slide or move, beside what a tank says of its own; all others are fixed
            and no-slip.
        tank_motion: rigid motion of all walls together, or None.
        grading: of the distance between particles, from the spacing at interfaces to more elsewhere; None for the same
            distance everywhere. With the sharp interface only.
        tank: the tank that the particles were sampled from; None for particles given as arrays.

    Raises:
        ValueError: something does not fit together; the message names what, where and what would.
    """

    particles: Any
    fluids: Sequence[Fluid]
    gravity: Sequence[float] | Array
    body_force: Callable[[Array, float], Array] | None = None
    interface: Any = None
    free_surface: bool = False
    numerics: Numerics = field(default_factory=Numerics)
    title: str = ""
    walls: Sequence[Wall] = ()
    tank_motion: Motion | None = None
    grading: Grading | None = None
    tank: Tank | None = field(init=False, default=None, repr=False)
    # A tank knows what is at its walls; of other particles those off the walls say it.
    walls_have_fluids: bool = field(init=False, default=False, repr=False)
    # And where there is any fluid: a mask (K,) of positions (K, d).
    filled: Callable[[Array], Array] | None = field(init=False, default=None, repr=False)

    def __post_init__(self) -> None:
        given = self.fluids
        self.fluids = list(given) if isinstance(given, Sequence) else []
        if not self.fluids or not all(isinstance(f, Fluid) for f in self.fluids):
            raise ValueError(f"Case: fluids is {given!r}; it must be a list of at least one Fluid")
        names = [f.name for f in self.fluids]
        if len(set(names)) < len(names):
            raise ValueError(f"Case: fluids are named {names}; every fluid needs a name of its own")
        if not isinstance(self.free_surface, bool):
            raise ValueError(f"Case: free_surface is {self.free_surface!r}; it must be True or False")
        if self.interface is None:
            self.interface = SURFACE_INTERFACE if self.free_surface else DEFAULT_INTERFACE
        if not isinstance(self.interface, str) or self.interface not in INTERFACES:
            raise ValueError(f"Case: interface is {self.interface!r}; it must be one of {sorted(INTERFACES)}")
        if self.free_surface and self.interface == "sharp":
            raise ValueError("Case: with free_surface=True, interface must be 'interpolated' (the default then)")
        if self.body_force is not None and not callable(self.body_force):
            raise ValueError(f"Case: body_force is {self.body_force!r}; it must be a function of positions and time")
        if not isinstance(self.numerics, Numerics):
            raise ValueError(f"Case: numerics is {self.numerics!r}; it must be a Numerics")
        if not (isinstance(self.walls, Sequence) and all(isinstance(wall, Wall) for wall in self.walls)):
            raise ValueError(f"Case: walls is {self.walls!r}; it must be a list of Wall")
        if not (self.tank_motion is None or isinstance(self.tank_motion, Motion)):
            raise ValueError(f"Case: tank_motion is {self.tank_motion!r}; it must be a Motion")
        if not (self.grading is None or isinstance(self.grading, Grading)):
            raise ValueError(f"Case: grading is {self.grading!r}; it must be a Grading")
        if self.grading and self.free_surface:
            raise ValueError("Case: grading is given and free_surface is True; there is no grading with a free surface")
        if self.grading and self.interface != "sharp":
            raise ValueError(f"Case: with grading, interface must be 'sharp', in 2-D; it is {self.interface!r}")
        if isinstance(self.particles, Tank):
            self.tank = filled = self.particles
            self.particles = filled.sample(
                self.fluids, fitted=self.interface == "sharp", empty=self.free_surface, grading=self.grading
            )
            self.walls_have_fluids, self.filled = True, filled.holds
            self.walls = [*filled.walls(self.particles), *self.walls]
        if not isinstance(self.particles, Particles):
            raise ValueError(f"Case: particles is a {type(self.particles).__name__}; it must be a Particles or a tank")
        self._check_particles(self.particles)
        self.boundary = Boundary(self.particles, self.walls, self.tank_motion, closed=self.closed)

    def _check_particles(self, particles: Particles) -> None:
        gravity = numbers(self.gravity)
        if gravity.shape != (particles.dimension,) or not np.isfinite(gravity).all():
            raise ValueError(
                f"Case: gravity is {self.gravity!r}; it must be {particles.dimension} finite accelerations in m/s^2"
            )
        self.gravity = gravity
        if self.grading:
            largest = self.grading.of_fluids([f.name for f in self.fluids], particles.spacing)
            inside = np.zeros(len(particles), dtype=bool)
            self.grading.sizing(particles.position, particles.fluid, inside, largest, particles.spacing)
        lowest = np.where(particles.wall & self.free_surface, -1, 0)  # -1: a wall where there is no fluid
        bad = (particles.fluid < lowest) | (particles.fluid >= len(self.fluids))
        if bad.any():
            i = int(np.argmax(bad))
            raise ValueError(
                f"Case: particle {i} has fluid {int(particles.fluid[i])}; with {len(self.fluids)} fluid(s) it "
                f"must lie between 0 and {len(self.fluids) - 1}"
            )
        if self.interface == "sharp" and particles.dimension != 2:
            raise ValueError(
                "Case: interface is 'sharp' (the default), which is for 2-D only; for these particles in 3-D it must "
                "be 'interpolated'"
            )
        median = particles.require_distinct()
        if not 0.1 <= particles.spacing / median <= 10:
            raise ValueError(
                f"Case: spacing is {particles.spacing:g} m, but the particles stand {median:g} m apart (median); "
                "the two may differ by a factor of 10 at most"
            )
        if not self.walls and self.tank_motion is None and (particles.velocity[particles.wall] != 0).any():
            i = int(np.flatnonzero(particles.wall & (particles.velocity != 0).any(axis=1))[0])
            raise ValueError(
                f"Case: wall particle {i} has velocity {particles.velocity[i].tolist()} m/s; walls are fixed, "
                "it must be zero"
            )
        if particles.wall.all():
            raise ValueError("Case: all particles are wall particles; there is no fluid to move")
        self._check_walls_surround(particles)

    def _check_walls_surround(self, particles: Particles) -> None:
        centred = (particles.position - particles.position.mean(axis=0)) / particles.spacing
        try:
            facets = ConvexHull(centred).equations
        except QhullError as error:
            raise ValueError(
                f"Case: the {len(particles)} particles enclose no space; {particles.dimension + 1} or more are "
                "needed, not all on one line or in one plane"
            ) from error
        # Facets of one straight wall share their equation but for round-off; one of them will do.
        facets = facets[np.unique(facets.round(12), axis=0, return_index=True)[1]]
        fluid = np.flatnonzero(~particles.wall)
        beyond = np.zeros(len(fluid), dtype=bool)
        for facet in facets:  # one by one: all at once would take facets x particles of memory
            beyond |= centred[fluid] @ facet[:-1] + facet[-1] > -1e-9
        if beyond.any():
            i = int(fluid[np.argmax(beyond)])
            raise ValueError(
                f"Case: particle {i} at {particles.position[i].tolist()} lies outside the walls (or on them); "
                "wall particles must surround all others"
            )

    def fluid_index(self, name: str) -> int:
        """Index of a fluid by its name.

        Raises:
            ValueError: there is no fluid of that name.
        """
        names = [f.name for f in self.fluids]
        if name not in names:
            raise ValueError(f"there is no fluid {name!r} in this case; it has {names}")
        return names.index(name)

    @property
    def closed(self) -> bool:
        """Whether walls surround the fluids on all sides, so that pressure is known up to a constant."""
        return not self.free_surface

    def acceleration(self, position: Array, time: float) -> Array:
        """Gravity and body force (N, d) [m/s^2] at positions (N, d) [m] and a time [s].

        Raises:
            ValueError: the body force has the wrong shape or is not finite.
        """
        force = np.broadcast_to(np.asarray(self.gravity), position.shape).copy()
        if self.body_force is not None:
            extra = np.asarray(self.body_force(position, time), dtype=float)
            if extra.shape == position.shape and not np.isfinite(extra).all():
                i = int(np.argmin(np.isfinite(extra).all(axis=1)))
                raise ValueError(
                    f"Case: body_force at t = {time:g} s gave {extra[i].tolist()} at {position[i].tolist()}; "
                    "it must be finite accelerations"
                )
            if extra.shape != position.shape:
                raise ValueError(
                    f"Case: body_force at t = {time:g} s gave shape {extra.shape}; it must be finite accelerations "
                    f"of shape {position.shape}"
                )
            force += extra
        return force

    def natural_frequency(self) -> float:
        """sqrt(|b| / h) [1/s] with the largest acceleration b by gravity and body force at the start."""
        force = self.acceleration(self.particles.position, 0.0)
        return float(np.sqrt(np.linalg.norm(force, axis=1).max() / self.particles.spacing))

    def pressure_reference(self) -> int:
        """The wall particle at which a closed tank's pressure is zero: the highest, against gravity and body force."""
        # Not one that slides or is set elsewhere; corners never are.
        wall = np.flatnonzero(self.boundary.stays)
        height = -self.particles.position[wall] @ self.acceleration(self.particles.position, 0.0).mean(axis=0)
        return int(wall[np.argmax(height)])

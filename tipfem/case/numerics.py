"""Numerics: parameters of the method."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from tipfem.case.declaration import Unit, require
from tipfem.case.particles import largest_length
from tipfem.errors import Invalid
from tipfem.typing import Array


@dataclass(frozen=True)
class RelocationRule:
    """When and where to particles are relocated with the interpolated interface. All lengths in target spacings h.

    Attributes:
        too_close: a particle closer than this to another is relocated.
        too_close_to_wall: a particle closer than this to a face of the wall is relocated.
        long_edge: edges within a fluid longer than this take a particle at their middle.
        long_mixed_edge: edges between two fluids longer than this take a particle at a third of
            their length, so that no gap opens between the fluids.
        urgent: a particle closer than this to another is relocated into any edge longer than h.
        at_surface: factor on these distances if one of the two particles is on a free surface.
        along_surface: the same factor if both are, and for the heights over a wall of particles on the surface.

    Raises:
        ValueError: a length is not positive, or relocated particles would be relocated again at once.
    """

    too_close: Annotated[float, Gt(0), Unit("spacings")] = 0.6
    too_close_to_wall: Annotated[float, Gt(0), Unit("spacings")] = 0.4
    long_edge: Annotated[float, Gt(0), Unit("spacings")] = 1.2
    long_mixed_edge: Annotated[float, Gt(0), Unit("spacings")] = 1.8
    urgent: Annotated[float, Gt(0), Unit("spacings")] = 0.35
    at_surface: Annotated[float, Gt(0)] = 0.75
    along_surface: Annotated[float, Gt(0)] = 0.5

    def __post_init__(self) -> None:
        require(self, ("numerics", "relocation"))
        for name, factor, where in (("long_edge", 2, "into"), ("long_mixed_edge", 3, "at a third of")):
            if (value := getattr(self, name)) < factor * self.too_close - 1e-12:
                text = f"is {value:g}, below {'twice' if factor == 2 else 'three times'} too_close {self.too_close:g}; "
                text += f"a particle set {where} such an edge would be moved again at once"
                raise Invalid(("numerics", "relocation", name), text, "RelocationRule")


@dataclass(frozen=True)
class SurfaceRule:
    """Rule for fluid simplices. Lengths in target spacings h; R is the radius of the circumscribed circle (ball).

    Attributes:
        alpha: simplices inside the fluid, at its surface, are fluid if R < alpha h.
        inner: the same for simplices with a particle below the surface. Simplices whose particles are all below the
            surface are always fluid.
        first: factor on alpha for the first mesh of particles given as arrays. A tank knows which parts are filled.
        join: simplices outside the fluid become fluid if R < join h and their smallest height is below gap h. So
            drops merge and waves close.
        gap: see ``join``.
        touch: a particle that is lower than this over a dry wall touches it.
        wet: the same over a face of the wall that is wet at one end, once the particle has passed the middle.
        dry: the particle leaves that face again when it falls behind this fraction of the distance between its ends;
            0.5 is the middle.

    Raises:
        ValueError: a number is out of range.
    """

    alpha: Annotated[float, Ge(0.75), Le(10), Unit("spacings")] = 1.2
    inner: Annotated[float, Ge(0.75), Le(20), Unit("spacings")] = 1.8
    first: Annotated[float, Ge(0.5), Le(2)] = 0.85
    join: Annotated[float, Ge(0.3), Le(10), Unit("spacings")] = 0.8
    gap: Annotated[float, Ge(0.1), Le(2), Unit("spacings")] = 0.6
    touch: Annotated[float, Ge(0.4), Le(2), Unit("spacings")] = 0.6
    wet: Annotated[float, Ge(0.4), Le(3), Unit("spacings")] = 1.2
    dry: Annotated[float, Ge(0), Le(0.5)] = 0.25

    def __post_init__(self) -> None:
        require(self, ("numerics", "surface"))
        if self.inner < self.alpha:
            text = f"is {self.inner:g}, below alpha {self.alpha:g}; it must not be"
            raise Invalid("numerics.surface.inner", text, "SurfaceRule")


@dataclass(frozen=True)
class FittedRule:
    """When the triangulation is changed with the sharp interface. All lengths in target spacings h.

    "Interface" here includes walls: both are chains of edges that the triangulation keeps.

    Attributes:
        too_close: a particle inside a fluid closer than this to another is removed.
        too_close_to_interface: the same for its distance to an edge of an interface or a wall.
        too_close_along_interface: the same for the distance between neighbours along an interface or a wall.
        long_edge: edges of interfaces and walls longer than this are split before any others.
        removable: particles inside a fluid closer than this to another are removed too, if there are more long
            edges to split than particles removed so far.
        thin_film: a film thinner than this breaks.
        contact_reach: how far a contact may slide along a wall in one repair, from the foot of the interface's
            next particle on the wall.
        flip_tolerance: how far a particle may be inside a circumcircle before an edge is flipped; relative, see
            `flips.excess`. Positive, because flips without a gain disturb fluids at rest.

    Raises:
        ValueError: a number is out of range, or not a number.
    """

    too_close: Annotated[float, Ge(0.1), Le(0.95), Unit("spacings")] = 0.6
    too_close_to_interface: Annotated[float, Ge(0.05), Le(0.8), Unit("spacings")] = 0.4
    too_close_along_interface: Annotated[float, Ge(0.1), Le(0.95), Unit("spacings")] = 0.55
    long_edge: Annotated[float, Ge(1.2), Le(5), Unit("spacings")] = 1.5
    removable: Annotated[float, Ge(0.1), Le(0.95), Unit("spacings")] = 0.75
    thin_film: Annotated[float, Ge(0), Le(0.8), Unit("spacings")] = 0.3
    contact_reach: Annotated[float, Ge(0), Le(3), Unit("spacings")] = 0.8
    flip_tolerance: Annotated[float, Ge(0), Le(0.2)] = 1e-3

    def __post_init__(self) -> None:
        require(self, ("numerics", "fitting"))


@dataclass(frozen=True)
class Numerics:
    """Parameters of the method.

    Attributes:
        rho_inf: spectral radius at infinity of generalized-alpha.
        stabilisation: c in tau = c dt T of the PSPG term; T is the length of step that the flow itself
            asks for (see `tipfem.step.solve.flow_time`).
        volume_correction: rate at which the source in J - 1 = s restores the lost volume of a fluid, in
            units of sqrt(|b| / h) with the largest acceleration b by gravity and body force at the start, or
            without any in those of v / h with the speed v of the fastest particle relative to the tank; 0
            switches the source off. A higher rate reduces the error of volume and adds noise to the pressure.
            With the sharp interface any rate > 0 means that interfaces are moved to keep the volumes of the
            start, and 0 that only the changes of volume by remeshing are undone.
        momentum_transfer: with the interpolated interface, whether a particle whose mass a remeshing increases takes
            momentum from the neighbours that lost it (see `momentum_transfer`). The paper's method does not.
        newton_tolerance: of the largest scaled residual, expressed as a displacement.
        acceleration_tolerance: of the same residual as an acceleration, relative to that of the flow (the root mean
            square over its mass, at most gravity, at least 1e-4 of gravity); the tighter of both holds. It keeps the
            pressure accurate for short steps and large spacings, and slow flows as accurate as fast ones. In steps
            shorter than the flow asks for it falls with their square, to 1 %. The largest
            residual is that of a few particles where the mesh has just changed; the root mean square of all is about
            2 % of it.
        newton_iterations: largest number of iterations, after which a step is refused.
        jacobian: how products with the Jacobian are formed in the Krylov iterations: "rows" gathers its rows once per
            linearisation; "matrix-free" stores no rows and computes each product from the elements, which takes less
            memory and more time. Solutions agree to the tolerance.
        pressure: how many values pressure has on interfaces between fluids. "two-sided", with the sharp interface: one
            for each connected component of a fluid there, so that the solve keeps the volume of each component.
            Results have the heaviest fluid's. "continuous": one per particle, so that the fluids on both sides share
            its equation of continuity. "auto": two-sided with the sharp interface, continuous otherwise.
        sliding: whether liquids slide along each other at the sharp interface, where that is stable, see
            docs/theory/sliding.md.
        mass: the mass matrix of the elements. "lumped": each particle has an equal part of the mass of its cells.
            "consistent": that of velocities that are linear in the cells. "interfaces": consistent in cells that touch
            an interface between fluids, lumped elsewhere. See docs/theory/equations.md.
        largest_move: target of the step control for the displacement of the fastest particle; more than 0.5
            only if J of no element falls below its limit (see `StepControl`). A step in which a particle moves
            0.15 spacings more than this is refused. Left out, it is 2 where fluids fill a closed tank, or have a
            free surface in 3-D, meet at the sharp interface, and are driven by gravity, a body force or surface
            tension; and 0.5 elsewhere (see `Case.largest_move`).
        time_tolerance: of the error that the time integration makes in the displacements of a step, which the length
            of the next follows (see `StepControl`). Left out, it is 0.0008 where ``largest_move`` is left out and 2,
            for steps that move a particle by more than 0.5 spacings; others do not follow the error. A value 1/8 as
            large halves the steps that it limits.
        smallest_jacobian: limit of J; a step in which an element's J falls below it is refused.
        triangulation: with the interpolated interface and without free surface: "repair" flips edges of the last mesh,
            in 3-D swaps edges and faces where that makes better cells, and removes and inserts relocated particles,
            where possible; "rebuild" calls Qhull in every step.
        energy_balance: with the sharp interface, whether kinetic and potential energy that remeshing adds is taken
            back, see docs/theory/energy-of-remeshing.md.
        budget: what the history has of energy and momentum: "total"; or "detailed", also what each kind of repair of
            the mesh adds to those of each fluid, see docs/theory/energy-of-remeshing.md. No step depends on it.
        relocation: when and where to particles are relocated with the interpolated interface.
        fitting: when the triangulation is changed, with the sharp interface.
        surface: which simplices are fluid, with a free surface.

    Raises:
        ValueError: a number is out of range or not a number, or a rule has the wrong type.
    """

    rho_inf: Annotated[float, Ge(0), Le(1)] = 0.0
    stabilisation: Annotated[float, Ge(1e-6), Le(10)] = 0.25
    volume_correction: Annotated[float, Ge(0), Le(100)] = 1.0
    momentum_transfer: bool = True
    newton_tolerance: Annotated[float, Ge(1e-14), Le(1e-1), Unit("spacings")] = 2.5e-5
    acceleration_tolerance: Annotated[float, Ge(1e-12), Le(1)] = 1e-2
    newton_iterations: Annotated[int, Ge(1), Le(100)] = 12
    jacobian: Literal["rows", "matrix-free"] = "rows"
    pressure: Literal["auto", "continuous", "two-sided"] = "auto"
    sliding: bool = True
    mass: Literal["lumped", "consistent", "interfaces"] = "lumped"
    largest_move: Annotated[float | None, Ge(0.01), Le(2), Unit("spacings")] = None
    time_tolerance: Annotated[float | None, Ge(1e-8), Le(1), Unit("spacings")] = None
    smallest_jacobian: Annotated[float, Ge(0), Le(0.9)] = 0.05
    triangulation: Literal["repair", "rebuild"] = "repair"
    energy_balance: bool = True
    budget: Literal["total", "detailed"] = "total"
    relocation: RelocationRule = field(default_factory=RelocationRule)
    fitting: FittedRule = field(default_factory=FittedRule)
    surface: SurfaceRule = field(default_factory=SurfaceRule)

    def __post_init__(self) -> None:
        require(self, ("numerics",))

    def tolerance(
        self,
        force: Array,
        acceleration: float,
        cm: float,
        spacing: float,
        smallest: float,
        part: float = 1.0,
        capillary: float = 0.0,
        viscous: float = 0.0,
    ) -> float:
        """Tolerance of the largest scaled residual [spacings].

        Args:
            force: (N, d) gravity and body force [m/s^2].
            acceleration: of the flow at the start of the step, root mean square over its mass [m/s^2].
            cm: d a / d u of the time integration [1/s^2].
            spacing: of the particles [m].
            smallest: residual that round-off leaves [spacings].
            part: length of the step, relative to that which the flow asks for, at most 1. The tolerance of the
                acceleration follows its square, as the error of the time integration does: runs with shorter and
                shorter steps would otherwise end with errors of Newton's method, which do not fall with the step.
            capillary: acceleration by surface tension, that counts as gravity does [m/s^2].
            viscous: nu dt / h^2, the largest. A residual is scaled by its particle's own part in viscous forces, by
                1 / (1 + nu dt / h^2) or so: of a motion that neighbours share, it hides as much, see `HIDDEN`.
        """
        gravity = max(largest_length(force), capillary)
        strength = min(max(acceleration, QUIET * gravity), gravity) if gravity > 0 else acceleration
        strength *= max(part * part, SHORT)
        by_force = self.acceleration_tolerance * strength / (cm * spacing) if strength > 0 else float("inf")
        return max(min(self.newton_tolerance, by_force) / (1.0 + viscous + min(HIDDEN * viscous, HIDDEN)), smallest)


# What a scaled residual hides of smooth motions beside nu dt / h^2, from where that is 1: without it, errors of
# decaying vortices fell at first order only once they were below 2e-4.
HIDDEN = 9.0
# A flow that accelerates less than that, relative to gravity, is solved no more accurately.
QUIET = 1e-4
SHORT = 1e-2  # the least factor on the tolerance of accelerations in short steps

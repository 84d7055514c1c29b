"""Numerics: parameters of the method."""

from __future__ import annotations

from dataclasses import dataclass, field

from tipfem.arguments import is_number
from tipfem.case.particles import largest_length
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

    too_close: float = 0.6
    too_close_to_wall: float = 0.4
    long_edge: float = 1.2
    long_mixed_edge: float = 1.8
    urgent: float = 0.35
    at_surface: float = 0.75
    along_surface: float = 0.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (is_number(value) and value > 0):
                raise ValueError(f"RelocationRule: {name} is {value!r}; it must be > 0 (in spacings)")
        if self.long_edge < 2 * self.too_close - 1e-12:
            raise ValueError(
                f"RelocationRule: long_edge {self.long_edge:g} is below twice too_close {self.too_close:g}; "
                "a particle set into such an edge would be moved again at once"
            )
        if self.long_mixed_edge < 3 * self.too_close - 1e-12:
            raise ValueError(
                f"RelocationRule: long_mixed_edge {self.long_mixed_edge:g} is below three times too_close "
                f"{self.too_close:g}; a particle set at a third of such an edge would be moved again at once"
            )


@dataclass(frozen=True)
class SurfaceRule:
    """Which simplices are fluid. Lengths in target spacings h; R is the radius of the circumscribed circle (ball).

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

    alpha: float = 1.2
    inner: float = 1.8
    first: float = 0.85
    join: float = 0.8
    gap: float = 0.6
    touch: float = 0.6
    wet: float = 1.2
    dry: float = 0.25

    def __post_init__(self) -> None:
        for name, low, high in (
            ("alpha", 0.75, 10.0),
            ("inner", 0.75, 20.0),
            ("first", 0.5, 2.0),
            ("join", 0.3, 10.0),
            ("gap", 0.1, 2.0),
            ("touch", 0.4, 2.0),
            ("wet", 0.4, 3.0),
            ("dry", 0.0, 0.5),
        ):
            value = getattr(self, name)
            if not (is_number(value) and low <= value <= high):
                raise ValueError(f"SurfaceRule: {name} is {value!r}; it must lie between {low:g} and {high:g}")
        if self.inner < self.alpha:
            raise ValueError(f"SurfaceRule: inner {self.inner:g} is below alpha {self.alpha:g}; it must not be")


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

    too_close: float = 0.6
    too_close_to_interface: float = 0.4
    too_close_along_interface: float = 0.55
    long_edge: float = 1.5
    removable: float = 0.75
    thin_film: float = 0.3
    contact_reach: float = 0.8
    flip_tolerance: float = 1e-3

    def __post_init__(self) -> None:
        for name, low, high in (
            ("too_close", 0.1, 0.95),
            ("too_close_to_interface", 0.05, 0.8),
            ("too_close_along_interface", 0.1, 0.95),
            ("long_edge", 1.2, 5.0),
            ("removable", 0.1, 0.95),
            ("thin_film", 0.0, 0.8),
            ("contact_reach", 0.0, 3.0),
            ("flip_tolerance", 0.0, 0.2),
        ):
            value = getattr(self, name)
            if not (is_number(value) and low <= value <= high):
                raise ValueError(f"FittedRule: {name} is {value!r}; it must lie between {low:g} and {high:g}")


@dataclass(frozen=True)
class Numerics:
    """Parameters of the method.

    Attributes:
        rho_inf: spectral radius at infinity of generalized-alpha, 0 to 1.
        stabilisation: c in tau = c dt T of the PSPG term, > 0; T is the length of step that the flow itself
            asks for (see `tipfem.step.solve.flow_time`).
        volume_correction: rate at which the source in J - 1 = s restores the lost volume of a fluid, in
            units of sqrt(|b| / h) with the largest acceleration b by gravity and body force at the start, or
            without any in those of v / h with the speed v of the fastest particle relative to the tank; 0
            switches the source off. A higher rate reduces the error of volume and adds noise to the pressure.
            With the sharp interface any rate > 0 means that interfaces are moved to keep the volumes of the
            start, and 0 that only the changes of volume by remeshing are undone.
        momentum_transfer: with the interpolated interface, whether a particle whose mass a remeshing increases takes
            momentum from the neighbours that lost it (see `momentum_transfer`). The paper's method does not.
        newton_tolerance: of the largest scaled residual, expressed as a displacement in spacings.
        acceleration_tolerance: of the same residual as an acceleration, relative to that of the flow (the root mean
            square over its mass, at most gravity, at least 1e-4 of gravity); the tighter of both holds. It keeps the
            pressure accurate for short steps and large spacings, and slow flows as accurate as fast ones. In steps
            shorter than the flow asks for it falls with their square, to a hundredth. The largest
            residual is that of a few particles where the mesh has just changed; the root mean square of all is about a
            fiftieth of it.
        newton_iterations: largest number of iterations, after which a step is refused.
        jacobian: how products with the Jacobian are formed in the Krylov iterations: "rows" gathers its rows once per
            linearisation; "matrix-free" stores no rows and computes each product from the elements, which takes less
            memory and more time. Solutions agree to the tolerance.
        pressure: how many values pressure has on interfaces between fluids. "two-sided", with the sharp interface: one
            for each connected component of a fluid there, so that the solve keeps the volume of each component.
            Results have the heaviest fluid's. "continuous": one a particle, so that the fluids on both sides share its
            equation of continuity. "auto": two-sided with the sharp interface, continuous otherwise.
        mass: the mass matrix of the elements. "lumped": each particle has an equal part of the mass of its cells.
            "consistent": that of velocities that are linear in the cells. "interfaces": consistent in cells that touch
            an interface between fluids, lumped elsewhere. See docs/theory/method.md.
        largest_move: target of the step control for the displacement of the fastest particle, in spacings; more than
            0.5 only if J of no element falls below its limit (see `StepControl`). A step in which a particle moves
            0.15 spacings more than this is refused.
        smallest_jacobian: limit of J; a step in which an element's J falls below it is refused.
        triangulation: with the interpolated interface in 2-D and without free surface: "repair" flips edges of the
            last mesh, and removes and inserts relocated particles, where possible; "rebuild" calls Qhull in every step.
        energy_balance: with the sharp interface, whether kinetic and potential energy that remeshing adds or takes in a
            step is taken back or given back, see docs/theory/energy.md.
        budget: what the history has of energy and momentum: "total"; or "detailed", also what each kind of repair of
            the mesh adds to those of each fluid, see docs/theory/energy.md. No step depends on it.
        relocation: when and where to particles are relocated with the interpolated interface.
        fitting: when the triangulation is changed, with the sharp interface.
        surface: which simplices are fluid, with a free surface.

    Raises:
        ValueError: a number is out of range or not a number, or a rule has the wrong type.
    """

    rho_inf: float = 0.0
    stabilisation: float = 0.25
    volume_correction: float = 1.0
    momentum_transfer: bool = True
    newton_tolerance: float = 1e-5
    acceleration_tolerance: float = 1e-2
    newton_iterations: int = 12
    jacobian: str = "rows"
    pressure: str = "auto"
    mass: str = "lumped"
    largest_move: float = 0.35
    smallest_jacobian: float = 0.05
    triangulation: str = "repair"
    energy_balance: bool = True
    budget: str = "total"
    relocation: RelocationRule = field(default_factory=RelocationRule)
    fitting: FittedRule = field(default_factory=FittedRule)
    surface: SurfaceRule = field(default_factory=SurfaceRule)

    def __post_init__(self) -> None:
        for name, low, high in (
            ("rho_inf", 0.0, 1.0),
            ("stabilisation", 1e-6, 10.0),
            ("volume_correction", 0.0, 100.0),
            ("newton_tolerance", 1e-14, 1e-1),
            ("acceleration_tolerance", 1e-12, 1.0),
            ("newton_iterations", 1, 100),
            ("largest_move", 0.01, 0.8),
            ("smallest_jacobian", 0.0, 0.9),
        ):
            value = getattr(self, name)
            if not (is_number(value) and low <= value <= high):
                raise ValueError(f"Numerics: {name} is {value!r}; it must lie between {low:g} and {high:g}")
        if self.newton_iterations != int(self.newton_iterations):
            raise ValueError(f"Numerics: newton_iterations is {self.newton_iterations!r}; it must be a whole number")
        if self.triangulation not in ("repair", "rebuild"):
            raise ValueError(f"Numerics: triangulation is {self.triangulation!r}; it must be 'repair' or 'rebuild'")
        if self.budget not in ("total", "detailed"):
            raise ValueError(f"Numerics: budget is {self.budget!r}; it must be 'total' or 'detailed'")
        if self.jacobian not in ("rows", "matrix-free"):
            raise ValueError(f"Numerics: jacobian is {self.jacobian!r}; it must be 'rows' or 'matrix-free'")
        if self.pressure not in ("auto", "continuous", "two-sided"):
            raise ValueError(f"Numerics: pressure is {self.pressure!r}; it must be 'auto', 'continuous' or 'two-sided'")
        if self.mass not in ("lumped", "consistent", "interfaces"):
            raise ValueError(f"Numerics: mass is {self.mass!r}; it must be 'lumped', 'consistent' or 'interfaces'")
        for name, kind in (("relocation", RelocationRule), ("fitting", FittedRule), ("surface", SurfaceRule)):
            if not isinstance(getattr(self, name), kind):
                raise ValueError(f"Numerics: {name} is {getattr(self, name)!r}; it must be a {kind.__name__}")
        for name in ("momentum_transfer", "energy_balance"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"Numerics: {name} is {getattr(self, name)!r}; it must be True or False")

    def tolerance(
        self, force: Array, acceleration: float, cm: float, spacing: float, smallest: float, part: float = 1.0
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
        """
        gravity = largest_length(force)
        strength = min(max(acceleration, QUIET * gravity), gravity) * max(part * part, SHORT)
        by_force = self.acceleration_tolerance * strength / (cm * spacing) if strength > 0 else float("inf")
        return max(min(self.newton_tolerance, by_force), smallest)


# A flow that accelerates less than that, relative to gravity, is solved no more accurately.
QUIET = 1e-4
SHORT = 1e-2  # the least factor on the tolerance of accelerations in short steps

"""Numerics: the numbers of the method."""

from __future__ import annotations

from dataclasses import dataclass, field

from tipfem.alpha_shape import SurfaceRule
from tipfem.fitting import FittedRule
from tipfem.particles import Array, largest_length
from tipfem.relocation_rule import RelocationRule
from tipfem.validation import is_number


@dataclass(frozen=True)
class Numerics:
    """The numbers of the method.

    Attributes:
        rho_inf: of generalized-alpha, 0 to 1.
        stabilisation: c in tau = c dt^2 of the PSPG term, > 0.
        volume_correction: rate at which the source in J - 1 = s gives lost volume back to a fluid, in
            units of sqrt(|b| / h) with the largest acceleration b by gravity and body force at the start; 0
            switches the source off. The higher, the smaller the error of volume and the noisier the pressure.
            With the sharp interface: whether (> 0) interfaces are moved so that volumes stay those of the
            start, or (0) only what the remeshing itself changed is undone.
        momentum_transfer: with the interpolated interface, whether a particle that a remeshing made heavier takes
            on the velocity of the neighbours its new mass came from (see `tipfem.transfer`). The paper's method
            does not.
        newton_tolerance: of the largest scaled residual, in spacings: how far it would move its particle.
        acceleration_tolerance: of the same residual as an acceleration, relative to gravity; the
            tighter of both holds. Without it, short steps and large spacings would leave pressure loose.
            The largest is that of a few particles where the mesh has just changed; the root of the mean square
            of all is a fiftieth of it.
        newton_iterations: after which a step is refused.
        largest_move: displacement of the fastest particle that the length of a step aims at, in spacings; more than
            0.5 only where no element would be crushed (see `StepControl`). A step in which one moves by 0.15 spacings
            more is refused.
        smallest_jacobian: a step in which an element's J falls below it is refused.
        triangulation: of the interpolated interface in 2-D, between walls: "repair" flips the last mesh, and takes
            relocated particles out of it and puts them in, where that can be done; "rebuild" asks Qhull every time.
        relocation: when particles are moved, and where to, with the interpolated interface.
        fitting: when the triangulation is changed, with the sharp interface.
        surface: which simplices are fluid, with a free surface.

    Raises:
        ValueError: a number is out of range or none, or a rule is none of its kind.
    """

    rho_inf: float = 0.0
    stabilisation: float = 0.25
    volume_correction: float = 1.0
    momentum_transfer: bool = True
    newton_tolerance: float = 1e-5
    acceleration_tolerance: float = 1e-2
    newton_iterations: int = 8
    largest_move: float = 0.35
    smallest_jacobian: float = 0.05
    triangulation: str = "repair"
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
        for name, kind in (("relocation", RelocationRule), ("fitting", FittedRule), ("surface", SurfaceRule)):
            if not isinstance(getattr(self, name), kind):
                raise ValueError(f"Numerics: {name} is {getattr(self, name)!r}; it must be a {kind.__name__}")
        if not isinstance(self.momentum_transfer, bool):
            raise ValueError(f"Numerics: momentum_transfer is {self.momentum_transfer!r}; it must be True or False")

    def tolerance(self, force: Array, cm: float, spacing: float, smallest: float) -> float:
        """Largest scaled residual that counts as solved [spacings].

        Args:
            force: (N, d) gravity and body force [m/s^2].
            cm: d a / d u of the time integration [1/s^2].
            spacing: of the particles [m].
            smallest: what round-off leaves of a residual [spacings].
        """
        strength = largest_length(force)
        by_force = self.acceleration_tolerance * strength / (cm * spacing) if strength > 0 else float("inf")
        return max(min(self.newton_tolerance, by_force), smallest)

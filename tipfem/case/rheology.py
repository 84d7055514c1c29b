"""Laws of viscosity: fluids whose viscosity depends on how they are sheared, and on pressure.

The viscous stress is 2 mu(g, p) D with the rate of strain D, the shear rate g = sqrt(2 D : D) and the pressure p. The
kernels take each law as a row of numbers, see `tipfem.fem.rheology`.

A yield stress is regularised, as by T. C. Papanastasiou, Journal of Rheology 31, 1987: below it the fluid does not
stand still, but creeps with the viscosity tau_y m. A layer of height H that has stopped creeps at about H / m.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Le

from tipfem.case.declaration import Unit, declared, require
from tipfem.typing import Array

NEWTON, HERSCHEL_BULKLEY, CARREAU, GRANULAR, SMAGORINSKY = range(5)
WIDTH = 8  # of a row: the kind, and seven numbers
LEAST_RATE = 1e-12  # [1/s]


@dataclass(frozen=True)
class Law:
    """A law of viscosity; ``law`` is its name in case files, ``has_layers`` whether walls may have "layer"."""

    law: ClassVar[str]
    fast: ClassVar[tuple[str, ...]]
    has_layers: ClassVar[bool] = False

    def __post_init__(self) -> None:
        require(self)

    def row(self, density: float) -> tuple[float, ...]:
        """The law as `WIDTH` numbers, or fewer, of a fluid with a density [kg/m^3]."""
        raise NotImplementedError

    @property
    def typical(self) -> float:
        """Viscosity of a fast flow [Pa s]: the first of the numbers ``fast`` that is not 0."""
        return next((value for name in self.fast if (value := float(getattr(self, name)))), 0.0)

    def __str__(self) -> str:
        fields = declared(type(self))
        given = ", ".join(f"{name} {getattr(self, name):g}" for name in fields)
        return f"{self.law}: {given}"


@dataclass(frozen=True)
class HerschelBulkley(Law):
    """A yield stress and a power law beyond it: tau = tau_y + K g^n. Mud, concrete, drilling fluids, paints.

    mu = tau_y (1 - exp(-m g)) / g + K (g^2 + g_0^2)^((n - 1) / 2).

    Attributes:
        yield_stress: tau_y.
        consistency: K, in Pa s^n.
        index: n; less than 1 for fluids that become thinner as they are sheared.
        regularisation: m: 10 to 100 over the shear rates of the flow.
        least_rate: g_0, below which the power law has a constant viscosity.
    """

    yield_stress: Annotated[float, Ge(0), Unit("Pa")]
    consistency: Annotated[float, Gt(0), Unit("Pa s^n")]
    index: Annotated[float, Ge(0.1), Le(3), Unit("")]
    regularisation: Annotated[float, Gt(0), Unit("s")] = 100.0
    least_rate: Annotated[float, Gt(0), Unit("1/s")] = 1e-3

    law: ClassVar[str] = "herschel-bulkley"
    fast: ClassVar = ("consistency",)

    def row(self, density: float) -> tuple[float, ...]:
        """See `Law.row`."""
        numbers = self.yield_stress, self.consistency, self.index, self.regularisation, self.least_rate
        return HERSCHEL_BULKLEY, *numbers


@dataclass(frozen=True)
class Bingham(Law):
    """A yield stress and a constant viscosity beyond it: tau = tau_y + mu g.

    Attributes:
        yield_stress: tau_y.
        viscosity: mu.
        regularisation: m: 10 to 100 over the shear rates of the flow.
    """

    yield_stress: Annotated[float, Ge(0), Unit("Pa")]
    viscosity: Annotated[float, Gt(0), Unit("Pa s")]
    regularisation: Annotated[float, Gt(0), Unit("s")] = 100.0

    law: ClassVar[str] = "bingham"
    fast: ClassVar = ("viscosity",)

    def row(self, density: float) -> tuple[float, ...]:
        """See `Law.row`."""
        return HERSCHEL_BULKLEY, self.yield_stress, self.viscosity, 1.0, self.regularisation, 1.0


@dataclass(frozen=True)
class PowerLaw(Law):
    """A power of the shear rate: tau = K g^n. Polymer solutions, pastes, suspensions.

    mu = K (g^2 + g_0^2)^((n - 1) / 2).

    Attributes:
        consistency: K, in Pa s^n.
        index: n; less than 1 for fluids that become thinner as they are sheared.
        least_rate: g_0, below which the viscosity is constant.
    """

    consistency: Annotated[float, Gt(0), Unit("Pa s^n")]
    index: Annotated[float, Ge(0.1), Le(3), Unit("")]
    least_rate: Annotated[float, Gt(0), Unit("1/s")] = 1e-3

    law: ClassVar[str] = "power"
    fast: ClassVar = ("consistency",)

    def row(self, density: float) -> tuple[float, ...]:
        """See `Law.row`."""
        return HERSCHEL_BULKLEY, 0.0, self.consistency, self.index, 1.0, self.least_rate


@dataclass(frozen=True)
class Carreau(Law):
    """A viscosity between two limits: mu = mu_inf + (mu_0 - mu_inf) (1 + (t g)^2)^((n - 1) / 2). Polymers, blood.

    Attributes:
        at_rest: mu_0.
        at_infinity: mu_inf, of fast shear.
        time: t, one over the shear rate from which on the viscosity changes.
        index: n.
    """

    at_rest: Annotated[float, Gt(0), Unit("Pa s")]
    at_infinity: Annotated[float, Ge(0), Unit("Pa s")]
    time: Annotated[float, Gt(0), Unit("s")]
    index: Annotated[float, Ge(0.1), Le(3), Unit("")]

    law: ClassVar[str] = "carreau"
    fast: ClassVar = ("at_infinity", "at_rest")

    def row(self, density: float) -> tuple[float, ...]:
        """See `Law.row`."""
        return CARREAU, self.at_rest, self.at_infinity, self.time, self.index


@dataclass(frozen=True)
class Granular(Law):
    """Dry grains, whose friction follows the inertial number: tau = mu(I) p, I = g d / sqrt(p / rho_s).

    mu(I) = mu_s + (mu_2 - mu_s) / (I_0 / I + 1), without the pressure of the air between them. P. Jop, Y. Forterre,
    O. Pouliquen, Nature 441, 2006. Where p <= 0, and in addition elsewhere, there is ``least_viscosity``.

    Attributes:
        static_friction: mu_s, the tangent of the angle at which a heap comes to rest.
        fast_friction: mu_2, of fast shear.
        diameter: d of the grains.
        grain_density: rho_s.
        inertial_number: I_0.
        regularisation: m: 10 to 100 over the shear rates of the flow.
        least_viscosity: what is left at a free surface.
    """

    static_friction: Annotated[float, Gt(0), Le(2), Unit("")]
    fast_friction: Annotated[float, Gt(0), Le(3), Unit("")]
    diameter: Annotated[float, Gt(0), Unit("m")]
    grain_density: Annotated[float, Gt(0), Unit("kg/m^3")]
    inertial_number: Annotated[float, Gt(0), Unit("")] = 0.3
    regularisation: Annotated[float, Gt(0), Unit("s")] = 100.0
    least_viscosity: Annotated[float, Ge(0), Unit("Pa s")] = 1e-2

    law: ClassVar[str] = "granular"
    fast: ClassVar = ("least_viscosity",)

    def row(self, density: float) -> tuple[float, ...]:
        """See `Law.row`."""
        friction = self.static_friction, self.fast_friction - self.static_friction, self.inertial_number
        grains = self.diameter * math.sqrt(self.grain_density), self.regularisation, self.least_viscosity
        return GRANULAR, *friction, *grains


@dataclass(frozen=True)
class Smagorinsky(Law):
    """An eddy viscosity beside the fluid's own: mu + rho (C h)^2 g, h^2 the area of a cell (in 3-D h^3 its volume).

    It stands for eddies smaller than the cells, in flows whose large eddies are resolved. J. Smagorinsky, Monthly
    Weather Review 91, 1963.

    Attributes:
        viscosity: mu, the fluid's own.
        constant: C.
    """

    viscosity: Annotated[float, Ge(0), Unit("Pa s")]
    constant: Annotated[float, Ge(0), Le(0.5), Unit("")] = 0.17

    law: ClassVar[str] = "smagorinsky"
    fast: ClassVar = ("viscosity",)
    has_layers: ClassVar[bool] = True

    def row(self, density: float) -> tuple[float, ...]:
        """See `Law.row`."""
        return SMAGORINSKY, self.viscosity, density * self.constant**2


LAWS: Mapping[str, type[Law]] = {
    kind.law: kind for kind in (Bingham, PowerLaw, HerschelBulkley, Carreau, Granular, Smagorinsky)
}


def law_record(viscosity: float | Law) -> Any:
    """A viscosity as plain values: a number, or a dict with the name and the numbers of its law."""
    return {"law": viscosity.law, **dataclasses.asdict(viscosity)} if isinstance(viscosity, Law) else viscosity


def law_from(record: Any) -> Any:
    """Law from its `law_record`; other values as they are."""
    if not isinstance(record, Mapping):
        return record
    return LAWS[record["law"]](**{name: value for name, value in record.items() if name != "law"})


def viscosities(laws: Array, fluid: Array, rate: Array, pressure: Array, size2: Array) -> Array:
    """Viscosity (M,) of cells [Pa s], as the kernels have it.

    ``laws`` (F, `WIDTH`) are rows of `Law.row`, ``rate`` (M,) shear rates [1/s], ``size2`` (M,) squares of sizes [m^2].
    """
    out = np.empty(len(rate))
    for f, (kind, *n) in enumerate(laws):
        own = fluid == f
        g, p = np.maximum(rate[own], LEAST_RATE), np.maximum(pressure[own], 0.0)
        if kind == HERSCHEL_BULKLEY:
            power = n[1] * (g**2 + n[4] ** 2) ** (0.5 * (n[2] - 1.0))
            out[own] = power - n[0] * np.expm1(-n[3] * g) / g
        elif kind == CARREAU:
            out[own] = n[1] + (n[0] - n[1]) * (1.0 + (n[2] * g) ** 2) ** (0.5 * (n[3] - 1.0))
        elif kind == GRANULAR:
            friction = n[0] + n[1] * n[3] * g / (n[2] * np.sqrt(p) + n[3] * g)
            out[own] = n[5] - friction * p * np.expm1(-n[4] * g) / g
        else:
            out[own] = n[0] + n[1] * size2[own] * g  # Smagorinsky; of a number the second is 0
    return out


def yield_stresses(laws: Array) -> Array:
    """Yield stress (F,) of fluids [Pa], of grains over their pressure; 0 of fluids that have none."""
    return np.where(np.isin(laws[:, 0], (HERSCHEL_BULKLEY, GRANULAR)), laws[:, 1], 0.0)

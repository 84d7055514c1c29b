"""Region: a part of a tank that is filled with a fluid."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tipfem.case.fluid import Fluid
from tipfem.case.lattice import BESIDE
from tipfem.case.period import Period
from tipfem.typing import Array


@dataclass
class Region:
    """A filled part of the tank.

    Attributes:
        fluid: that fills it.
        part: its description in messages.
        contains: function of positions (K, d) [m] to a mask (K,) of those in the region.
        box: (2, d) lower and upper corner of a box [m]; None for other shapes.
        given: the argument of `Tank.fill` for the region, "box", "disc", "where" or "shape", with its value; empty
            for the whole tank.
        velocity: at the start: (d,) [m/s], or function of positions (K, d) [m] to velocities (K, d) [m/s]; None at
            rest.
    """

    fluid: Fluid
    part: str
    contains: Callable[[Array], Array]
    box: Array | None = None
    given: dict[str, Any] = field(default_factory=dict)
    velocity: Callable[[Array], Array] | Array | None = None

    def mask(self, x: Array) -> Array:
        """Mask (K,) of the points (K, d) [m] in the region.

        Raises:
            ValueError: a user's function raised, or did not return a mask.
        """
        here = f"fill {self.fluid.name!r}: {self.part}"
        try:
            inside = np.asarray(self.contains(x.copy()))  # a copy: a user's function may work in place
        except Exception as error:
            raise ValueError(
                f"{here} raised {type(error).__name__} for positions of shape {x.shape}: {error}"
            ) from error
        if inside.shape != (len(x),) or inside.dtype != bool:
            raise ValueError(
                f"{here} gave {inside.dtype} of shape {inside.shape}; it must be a mask, bool of shape {(len(x),)}"
            )
        return inside

    def initial_velocity(self, x: Array) -> Array:
        """Velocities (K, d) [m/s] at the points (K, d) [m] of the region.

        Raises:
            ValueError: a user's function raised, or did not return finite velocities.
        """
        if self.velocity is None or not len(x):
            return np.zeros_like(x)
        if not callable(self.velocity):
            return np.broadcast_to(self.velocity, x.shape)
        here = f"fill {self.fluid.name!r}: velocity={name_of(self.velocity)}"
        try:
            result = np.asarray(self.velocity(x.copy()), dtype=float)
        except Exception as error:
            raise ValueError(
                f"{here} raised {type(error).__name__} for positions of shape {x.shape}: {error}"
            ) from error
        if result.shape != x.shape:
            raise ValueError(f"{here} gave shape {result.shape}; it must be velocities of shape {x.shape}")
        bad = ~np.isfinite(result).all(axis=1)
        if bad.any():
            i = int(np.argmax(bad))
            raise ValueError(f"{here} gave {result[i].tolist()} at {x[i].tolist()}; it must be finite")
        return result


def initial_velocities(
    regions: Sequence[Region], number: Sequence[int], position: Array, fluid: Array, spacing: float, period: Period
) -> Array:
    """Velocities (N, d) of particles at the start [m/s]: those of the last region around each.

    A particle on a face has the velocity of a region beside it that is of its own fluid: the face itself, by round-off,
    may be in any region or in none.

    Args:
        regions: in the order in which they were filled.
        number: of the fluid of each.
        position: (N, d) of the particles [m].
        fluid: (N,) of the particles, -1 for none.
        spacing: of the particles [m].
        period: of the positions.

    Raises:
        ValueError: see `Region.mask` and `Region.initial_velocity`.
    """
    velocity = np.zeros_like(position)
    if all(region.velocity is None for region in regions):
        return velocity

    def last(x: Array) -> Array:
        found = np.full(len(x), len(regions))  # none
        for k, region in enumerate(regions):
            found[region.mask(x)] = k
        return found

    of, fluid_of = last(position), np.append(number, -1)
    for side in itertools.product((-1, 1), repeat=position.shape[1]):
        other = np.flatnonzero((fluid_of[of] != fluid) & (fluid >= 0))
        beside = last(period.wrapped(position[other] + BESIDE * spacing * np.array(side)))
        fits = fluid_of[beside] == fluid[other]
        of[other[fits]] = beside[fits]
    for k, region in enumerate(regions):
        velocity[of == k] = region.initial_velocity(position[of == k])
    velocity[fluid < 0] = 0.0
    return velocity


def name_of(function: Callable[[Array], Array]) -> str:
    """The name of a user's function, for messages."""
    return str(getattr(function, "__name__", type(function).__name__))

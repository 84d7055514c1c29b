"""Region: a part of a tank that is filled with a fluid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tipfem.case.fluid import Fluid
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


def name_of(function: Callable[[Array], Array]) -> str:
    """The name of a user's function, for messages."""
    return str(getattr(function, "__name__", type(function).__name__))

"""Beaches: parts of a tank before a wall in which the fluids are damped, so that waves do not come back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, MinLen

from tipfem.case.boundary.passages import edges_named
from tipfem.case.declaration import Unit, require
from tipfem.errors import Invalid
from tipfem.geometry.plane.domain import Domain
from tipfem.typing import Array


@dataclass(frozen=True, kw_only=True)
class Beach:
    """Damping of the fluids before a wall: an acceleration -c v, c = strength (2 pi / period) (1 - s / length)^2.

    s is the distance to the wall. It stops all that moves there, currents too. It should be one and a half waves long.

    Attributes:
        wall: name of the wall: left, right, bottom or top of a box, or a straight side of a shape.
        length: from the wall to where the damping begins [m].
        period: of the waves that are to be damped [s].
        strength: of the damping at the wall, over 2 pi / period.

    Raises:
        ValueError: a value is out of its range.
    """

    wall: Annotated[str, MinLen(1)]
    length: Annotated[float, Gt(0), Unit("m")]
    period: Annotated[float, Gt(0), Unit("s")]
    strength: Annotated[float, Gt(0)] = 1.5

    def __post_init__(self) -> None:
        require(self, self.path)

    @property
    def name(self) -> str:
        """By which case files find it: that of its wall."""
        return self.wall

    @property
    def path(self) -> tuple[str, ...]:
        """Keys that lead to it in a case file."""
        return "beaches", self.wall if isinstance(self.wall, str) else ""

    def rate(self, distance: Array) -> Array:
        """Damping (K,) at distances (K,) from the wall [1/s]."""
        part = np.clip(1 - distance / self.length, 0.0, 1.0)
        return np.asarray(2 * math.pi * self.strength / self.period * part**2)


@dataclass(frozen=True)
class Zone:
    """A beach in a tank."""

    beach: Beach  # as given
    start: Array  # (2,) a point on its wall [m]
    inwards: Array  # (2,) unit vector from the wall into the tank

    def rate(self, position: Array) -> Array:
        """Damping (K,) at positions (K, 2) [1/s]."""
        return self.beach.rate((position - self.start) @ self.inwards)


def zones_of(beaches: Any, domain: Any, sides: Mapping[str, Array], slack: float, refused: str) -> list[Zone]:
    """The zones of beaches in a tank, whose ``domain`` bounds the fluids.

    ``sides`` are of a box, see `edges_named`, empty where the edges have names, within ``slack`` [m]; ``refused`` is
    what the case has that does not go with beaches, in words. `Invalid` if they are no beaches, two are at one wall, or
    a wall is not there or not straight.
    """
    if not (isinstance(beaches, Sequence) and all(isinstance(beach, Beach) for beach in beaches)):
        raise Invalid("beaches", f"is {beaches!r}; it must be a list of Beach", "Case")
    found: list[Zone] = []
    for beach in beaches:
        path, subject = beach.path, f"beach {beach.wall!r}"
        if refused:
            raise Invalid(path, f": {refused}; beaches are for tanks in 2-D that stand still", subject)
        assert isinstance(domain, Domain)
        named = edges_named(domain, sides, slack)
        if beach.wall not in named:
            raise Invalid((*path, "wall"), f"is {beach.wall!r}; the tank has {', '.join(named)}", subject)
        if any(zone.beach.wall == beach.wall for zone in found):
            raise Invalid((*path, "wall"), f"is {beach.wall!r}, which has a beach already", subject)
        edges = named[beach.wall]
        if np.ptp(domain.direction[edges], axis=0).max() > 1e-9:
            raise Invalid((*path, "wall"), f"is {beach.wall!r}, which is not straight; beaches are", subject)
        along = domain.direction[edges[0]]  # with the fluid on the left
        found.append(Zone(beach, domain.start[edges[0]], np.array([-along[1], along[0]])))
    return found

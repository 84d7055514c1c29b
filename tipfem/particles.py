"""Particles: the state of the flow, as plain NumPy arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

Array = np.ndarray


@dataclass
class Particles:
    """The state on N particles in d dimensions (2 or 3). Arrays left out start at zero.

    Attributes:
        position: (N, d) [m].
        fluid: (N,) index into the case's list of fluids.
        wall: (N,) True for the fixed ghost particles that make the walls.
        velocity: (N, d) [m/s].
        acceleration: (N, d) [m/s^2].
        pressure: (N,) [Pa], positive in compression.
        spacing: target distance h between neighbours [m]; by default the median distance
            from a particle to its nearest neighbour.

    Raises:
        ValueError: an array has the wrong shape, a value is not finite, or two particles
            stand on the same place.
    """

    position: Array
    fluid: Array
    wall: Array
    velocity: Any = None
    acceleration: Any = None
    pressure: Any = None
    spacing: float = field(default=0.0)

    def __post_init__(self) -> None:
        self.position = np.array(self.position, dtype=np.float64)
        if self.position.ndim != 2 or self.position.shape[1] not in (2, 3) or not len(self.position):
            raise ValueError(f"Particles: position has shape {self.position.shape}; it must be (N, 2) or (N, 3)")
        n, d = self.position.shape
        self.fluid = _shaped("fluid", self.fluid, (n,), np.int32)
        self.wall = _shaped("wall", self.wall, (n,), bool)
        self.velocity = _shaped("velocity", self.velocity, (n, d), np.float64)
        self.acceleration = _shaped("acceleration", self.acceleration, (n, d), np.float64)
        self.pressure = _shaped("pressure", self.pressure, (n,), np.float64)
        for name in ("position", "velocity", "acceleration", "pressure"):
            _require_finite(name, getattr(self, name))
        if not self.spacing:
            self.spacing = self._require_distinct()
        if not (np.isfinite(self.spacing) and self.spacing > 0):
            raise ValueError(f"Particles: spacing is {self.spacing!r} m; it must be > 0")

    @property
    def dimension(self) -> int:
        """Number of space dimensions d."""
        return int(self.position.shape[1])

    def __len__(self) -> int:
        return len(self.position)

    def copy(self, **changes: Any) -> Particles:
        """A new state with copies of all arrays, and ``changes`` in place of some of them."""
        arrays = {
            name: np.array(getattr(self, name))
            for name in ("position", "fluid", "wall", "velocity", "acceleration", "pressure")
        }
        return replace(self, **{**arrays, **changes})

    def require_distinct(self) -> None:
        """Check that no two particles coincide.

        Raises:
            ValueError: two particles are closer than 1e-6 spacings.
        """
        self._require_distinct()

    def _require_distinct(self) -> float:
        """Check for duplicates and return the median distance to the nearest neighbour [m]."""
        if len(self) < 2:
            raise ValueError("Particles: one particle alone has no spacing; give at least two")
        distance, neighbour = cKDTree(self.position).query(self.position, k=2)
        spacing = self.spacing or float(np.median(distance[:, 1]))
        i = int(np.argmin(distance[:, 1]))
        if not distance[i, 1] > 1e-6 * spacing:
            j = int(neighbour[i, 1] if neighbour[i, 1] != i else neighbour[i, 0])
            raise ValueError(
                f"Particles: {min(i, j)} and {max(i, j)} are duplicates at {self.position[i].tolist()}; "
                "every particle needs a place of its own"
            )
        return spacing


def _shaped(name: str, values: Any, shape: tuple[int, ...], dtype: Any) -> Array:
    """``values`` as an array of the given shape; zeros for None."""
    if values is None:
        return np.zeros(shape, dtype)
    array = np.asarray(values)
    if array.shape != shape:
        raise ValueError(f"Particles: {name} has shape {array.shape}; for these positions it must be {shape}")
    return np.array(array, dtype=dtype)


def _require_finite(name: str, values: Array) -> None:
    bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(f"Particles: {name} of particle {i} is {values[i].tolist()}; it must be finite")

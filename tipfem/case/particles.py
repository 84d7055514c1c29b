"""Particles: the state of the flow, as plain NumPy arrays."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tipfem.arguments import is_number, numbers
from tipfem.typing import Array


@dataclass
class Particles:
    """The state on N particles in d dimensions (2 or 3). Arrays left out start at zero.

    Attributes:
        position: (N, d) [m].
        fluid: (N,) index into the case's list of fluids.
        wall: (N,) True for the ghost particles that make the walls.
        velocity: (N, d) [m/s].
        acceleration: (N, d) [m/s^2].
        pressure: (N,) [Pa], positive in compression.
        spacing: target distance h between neighbours [m]; by default the median distance
            from a particle to its nearest neighbour. Where targets differ from place to place, the smallest.
        target: (N,) distance that each particle is to have from its neighbours [m]. It follows from the case's
            `Grading`, at the start of a simulation and in every step; ``spacing`` without one.

    Raises:
        ValueError: an array has the wrong shape or no numbers, a value is not finite, a label is no
            whole number, or two particles are closer than 1e-6 spacings.
    """

    position: Array
    fluid: Array
    wall: Array
    velocity: Any = None
    acceleration: Any = None
    pressure: Any = None
    spacing: float = field(default=0.0)
    target: Any = field(init=False, default=None)

    def __post_init__(self) -> None:
        self._own_arrays()
        if not self.spacing:
            self.spacing = self.require_distinct()
        else:
            self._require_spacing()
            self.require_distinct()
        if self.target is None:
            self.target = np.full(len(self), float(self.spacing))

    def _require_spacing(self) -> None:
        if not (is_number(self.spacing) and self.spacing > 0):
            raise ValueError(f"Particles: spacing is {self.spacing!r} m; it must be > 0")

    def _own_arrays(self) -> None:
        """Replace the arrays by copies of the right type; see the class for errors."""
        position = numbers(self.position)
        if position.ndim != 2 or position.shape[1] not in (2, 3) or not len(position):
            raise ValueError(f"Particles: position has shape {position.shape}; it must be (N, 2) or (N, 3), of numbers")
        self.position = position
        n, d = position.shape
        self.fluid = _shaped("fluid", self.fluid, (n,), np.int32)
        self.wall = _shaped("wall", self.wall, (n,), bool)
        self.velocity = _shaped("velocity", self.velocity, (n, d), np.float64)
        self.acceleration = _shaped("acceleration", self.acceleration, (n, d), np.float64)
        self.pressure = _shaped("pressure", self.pressure, (n,), np.float64)
        if self.target is not None:
            self.target = _shaped("target", self.target, (n,), np.float64)
            if not (self.target > 0).all():
                i = int(np.argmin(self.target > 0))
                raise ValueError(f"Particles: target of particle {i} is {self.target[i]} m; it must be > 0")
        for name in ("position", "velocity", "acceleration", "pressure"):
            _require_finite(name, getattr(self, name))

    @property
    def dimension(self) -> int:
        """Number of space dimensions d."""
        return int(self.position.shape[1])

    @property
    def max_speed(self) -> float:
        """Largest speed of a particle [m/s]."""
        return largest_length(self.velocity)

    def __len__(self) -> int:
        return len(self.position)

    def copy(self, **changes: Any) -> Particles:
        """A new state with copies of all arrays, and ``changes`` in place of some of them.

        Checked like a new one but for distances: a step makes several copies, and particles that came
        too close in it are relocated.

        Raises:
            TypeError: there is no attribute of that name.
            ValueError: as for a new state, see above.
        """
        unknown = set(changes) - set(vars(self))
        if unknown:
            raise TypeError(f"Particles: there is no {', '.join(sorted(unknown))} to change")
        new = copy.copy(self)
        vars(new).update(changes)
        new._require_spacing()
        new._own_arrays()
        return new

    def shallow_copy(self, **changes: Any) -> Particles:
        """The state with ``changes`` in place of some of its arrays; it shares the others, and nothing is checked.

        For what a step computes by itself: `copy` is for everybody else.
        """
        new = copy.copy(self)
        vars(new).update(changes)
        return new

    def require_distinct(self) -> float:
        """Check that no two particles coincide.

        Returns:
            The median distance from a particle to its nearest neighbour [m]; of one particle alone,
            its spacing.

        Raises:
            ValueError: there is one particle alone and no spacing, or two are closer than 1e-6 spacings,
                or than 1e-6 of that median if it is smaller.
        """
        if len(self) < 2:
            if not self.spacing:
                raise ValueError("Particles: one particle alone has no spacing; give at least two")
            return self.spacing
        distance, neighbour = cKDTree(self.position).query(self.position, k=2)
        median = float(np.median(distance[:, 1]))
        i = int(np.argmin(distance[:, 1]))
        # A spacing that is far too large must not make all particles duplicates.
        if not distance[i, 1] > 1e-6 * min(self.spacing or median, median):
            j = int(neighbour[i, 1] if neighbour[i, 1] != i else neighbour[i, 0])
            raise ValueError(
                f"Particles: {min(i, j)} and {max(i, j)} are duplicates at {self.position[i].tolist()}; "
                "every particle needs a place of its own"
            )
        return median


def largest_length(vectors: Array) -> float:
    """Largest length of vectors (N, d)."""
    return float(np.sqrt(sum(axis * axis for axis in vectors.T).max()))


def _shaped(name: str, values: Any, shape: tuple[int, ...], dtype: Any) -> Array:
    """``values`` as a new array of the given shape and type; zeros for None."""
    if values is None:
        return np.zeros(shape, dtype)
    given = numbers(values)
    if given.shape != shape:
        raise ValueError(
            f"Particles: {name} has shape {given.shape}; for these positions it must be {shape}, of numbers"
        )
    with np.errstate(invalid="ignore"):  # NaN has no whole number; the comparison below finds it
        array = given.astype(dtype, copy=False)
    if array.dtype.kind != "f" and (array != given).any():
        i, kind = int(np.argmax(array != given)), "True or False" if dtype is bool else "a whole number"
        raise ValueError(f"Particles: {name} of particle {i} is {given[i]}; it must be {kind}")
    return array


def _require_finite(name: str, values: Array) -> None:
    if np.isfinite(values).all():
        return
    bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    i = int(np.argmax(bad))
    raise ValueError(f"Particles: {name} of particle {i} is {values[i].tolist()}; it must be finite")

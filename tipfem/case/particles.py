"""Particles: the state of the flow, as plain NumPy arrays."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from tipfem.arguments import is_number, numbers
from tipfem.errors import Invalid
from tipfem.scratch import scratch
from tipfem.typing import Array

# Positions farther from the origin than this, in spacings, keep too few digits: a wall's line has a width of 1e-6.
FARTHEST = 1e8


class Particles:
    """The state on N particles in d dimensions (2 or 3). Arrays left out start at zero.

    Args:
        position: (N, d) [m].
        fluid: (N,) index into the case's list of fluids.
        wall: (N,) True for the particles of the walls.
        velocity: (N, d) [m/s].
        acceleration: (N, d) [m/s^2].
        pressure: (N,) [Pa], positive in compression.
        spacing: target distance h between neighbours [m]; by default the median distance
            from a particle to its nearest neighbour. Where target distances vary, the smallest.

    Attributes:
        target: (N,) distance that each particle is to have from its neighbours [m]. It follows from the case's
            `Grading`, at the start of a simulation and in every step; ``spacing`` without one.

    The arguments are attributes too, as new arrays of the shapes above.

    Raises:
        ValueError: an array has the wrong shape or is not numeric, a value is not finite, a label is not a
            whole number, or two particles are closer than 1e-6 spacings.
    """

    def __init__(
        self,
        position: ArrayLike,
        fluid: ArrayLike,
        wall: ArrayLike,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        pressure: ArrayLike | None = None,
        spacing: float = 0.0,
    ) -> None:
        self._set_arrays(position, fluid, wall, velocity, acceleration, pressure)
        self.spacing = spacing
        if not spacing:
            self.spacing = self.require_distinct()
            self._require_spacing()
        else:
            self._require_spacing()
            self.require_distinct()
        self.target: Array = np.full(len(self), float(self.spacing))

    def _require_spacing(self) -> None:
        if not (is_number(self.spacing) and self.spacing > 0):
            raise Invalid("particles", f": spacing is {self.spacing!r} m; it must be a number > 0", "Particles")
        if (farthest := float(np.abs(self.position).max())) > FARTHEST * self.spacing:
            i = int(np.argmax(np.abs(self.position).max(axis=1)))
            text = f": particle {i} is at {self.position[i].tolist()} m; {farthest:.3g} m from the origin numbers keep "
            text += f"too few digits for a spacing of {self.spacing:g} m: it must be at most {FARTHEST:.0e} spacings"
            raise Invalid("particles", text, "Particles")

    def _set_arrays(
        self,
        position: ArrayLike,
        fluid: ArrayLike,
        wall: ArrayLike,
        velocity: ArrayLike | None,
        acceleration: ArrayLike | None,
        pressure: ArrayLike | None,
    ) -> None:
        """Set the arrays to checked copies of the right type; see the class for errors."""
        x = numbers(position)
        if x.ndim != 2 or x.shape[1] not in (2, 3) or not len(x):
            text = f": position has shape {x.shape}; it must be (N, 2) or (N, 3), of numbers"
            raise Invalid("particles", text, "Particles")
        n, d = x.shape
        self.position = x
        self.fluid = _shaped("fluid", fluid, (n,), np.int32)
        self.wall = _shaped("wall", wall, (n,), bool)
        self.velocity = _shaped("velocity", velocity, (n, d), np.float64)
        self.acceleration = _shaped("acceleration", acceleration, (n, d), np.float64)
        self.pressure = _shaped("pressure", pressure, (n,), np.float64)
        for name in ("position", "velocity", "acceleration", "pressure"):
            _require_finite(name, getattr(self, name))

    def _set_target(self, target: ArrayLike) -> None:
        self.target = _shaped("target", target, (len(self),), np.float64)
        if not (self.target > 0).all():
            i = int(np.argmin(self.target > 0))
            text = f": target of particle {i} is {self.target[i]} m; it must be a number > 0"
            raise Invalid("particles", text, "Particles")

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

        It is checked like a new state except for distances: particles too close after a step are relocated.

        Raises:
            TypeError: there is no attribute of that name.
            ValueError: as for a new state, see the class.
        """
        unknown = set(changes) - set(vars(self))
        if unknown:
            raise TypeError(f"Particles: there is no {', '.join(sorted(unknown))} to change")
        values = {**vars(self), **changes}
        new = copy.copy(self)
        new.spacing = values.pop("spacing")
        new._require_spacing()
        target = values.pop("target")
        new._set_arrays(**values)
        new._set_target(target)
        return new

    def shallow_copy(self, **changes: Any) -> Particles:
        """The state with ``changes`` in place of some of its arrays; it shares the others, and nothing is checked."""
        new = object.__new__(type(self))  # `copy.copy` takes ten times as long
        vars(new).update(vars(self), **changes)
        return new

    def require_distinct(self) -> float:
        """The median distance from a particle to its nearest neighbour [m], for a single one its spacing; checked.

        Raises:
            ValueError: there is a single particle and no spacing, or two are closer than 1e-6 spacings, or than 1e-6 of
                that median if it is smaller.
        """
        if len(self) < 2:
            if not self.spacing:
                raise Invalid("particles", ": a single particle has no spacing; give at least two", "Particles")
            return self.spacing
        distance, neighbour = cKDTree(self.position).query(self.position, k=2)
        median = float(np.median(distance[:, 1]))
        i = int(np.argmin(distance[:, 1]))
        # A spacing that is far too large must not make all particles duplicates.
        if not distance[i, 1] > 1e-6 * min(self.spacing or median, median):
            j = int(neighbour[i, 1] if neighbour[i, 1] != i else neighbour[i, 0])
            text = f": {min(i, j)} and {max(i, j)} are duplicates at {self.position[i].tolist()}; every particle needs "
            raise Invalid("particles", f"{text}a position of its own", "Particles")
        return median


def squared_lengths(vectors: Array) -> Array:
    """Squares (N,) of the lengths of vectors (N, d), which the next call overwrites."""
    total, square = scratch("lengths", (2, len(vectors)))
    for k, column in enumerate(vectors.T):  # by columns: NumPy takes several times as long along a short axis
        np.multiply(column, column, out=square if k else total)
        if k:
            total += square
    return np.asarray(total)


def largest_length(vectors: Array) -> float:
    """Largest length of vectors (N, d)."""
    return float(np.sqrt(squared_lengths(vectors).max()))


def _shaped(name: str, values: Any, shape: tuple[int, ...], dtype: Any) -> Array:
    """``values`` as a new array of the given shape and type; zeros for None."""
    if values is None:
        return np.zeros(shape, dtype)
    given = numbers(values)
    if given.shape != shape:
        text = f": {name} has shape {given.shape}; for these positions it must be {shape}, of numbers"
        raise Invalid("particles", text, "Particles")
    with np.errstate(invalid="ignore"):  # NaN has no whole number; the comparison below finds it
        array = given.astype(dtype, copy=False)
    if array.dtype.kind != "f" and (array != given).any():
        i, kind = int(np.argmax(array != given)), "True or False" if dtype is bool else "a whole number"
        raise Invalid("particles", f": {name} of particle {i} is {given[i]}; it must be {kind}", "Particles")
    return array


def _require_finite(name: str, values: Array) -> None:
    if np.isfinite(values).all():
        return
    bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    i = int(np.argmax(bad))
    raise Invalid("particles", f": {name} of particle {i} is {values[i].tolist()}; it must be finite", "Particles")

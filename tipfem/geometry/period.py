"""Period: the periodic sides of a domain, where what leaves on one side enters on the other, and its coordinates."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from tipfem.typing import Array


class Period:
    """The periodic axes of a domain of d dimensions; along each it begins at 0. And whether x is a radius.

    Whatever measures cells has it: in an axisymmetric flow, ``axial``, in the plane (r, z), a triangle stands for a
    ring. ``width`` (d,) is that of the domain along each axis [m], 0 for one that is not periodic; ``axes`` are numbers
    of those that are. For ``array`` see `tipfem.backend.periodic`.
    """

    def __init__(self, width: Array, *, axial: bool = False) -> None:
        self.width, self.axial = np.asarray(width, dtype=float), axial
        self.axes = [int(k) for k in np.flatnonzero(self.width > 0)]
        inverse = np.divide(1.0, self.width, out=np.zeros(len(self.width)), where=self.width > 0)
        self.array = np.stack([self.width, inverse]) if self.axes else np.zeros(1)
        if axial:
            self.array = np.zeros((1, 1, 1))

    def radius(self, position: Array) -> Array:
        """2 pi r [m] at positions (..., d) where the flow is axisymmetric; 1 where it is planar, or in 3-D."""
        return 2 * np.pi * position[..., 0] if self.axial else np.ones(position.shape[:-1])

    def section(self, volume: Array, position: Array, spacing: float | Array) -> Array:
        """Areas of the cross-section [m^2] of what has volumes (K,), about a ``spacing`` wide, at positions (K, 2)."""
        return volume / np.maximum(self.radius(position), 0.25 * np.pi * spacing) if self.axial else volume

    @property
    def planar(self) -> "Period":
        """The period for areas and heights in the plane: without the radius."""
        return _NONE[2] if self.axial else self

    @property
    def turn(self) -> float:
        """Derivative of `radius` by the first coordinate."""
        return 2 * np.pi if self.axial else 0.0

    def __bool__(self) -> bool:
        """Whether any axis is periodic; False for coordinates (r, z), too."""
        return bool(self.axes)

    @property
    def everywhere(self) -> bool:
        """Whether all axes are periodic, so that there are no walls."""
        return len(self.axes) == len(self.width)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Period) and self.axial == other.axial and np.array_equal(self.width, other.width)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Period({self.width.tolist()}{', axial=True' if self.axial else ''})"

    @cached_property
    def tree_box(self) -> Array | None:
        """``boxsize`` of `scipy.spatial.cKDTree` for positions that are `wrapped`; None without periodic axes."""
        return self.width if self else None

    def shortest(self, difference: Array, axis: int | None = None) -> Array:
        """Differences of positions (..., d) [m] to the nearest image; with an ``axis``, components (...,) along it."""
        for k in self.axes:
            inverse = self.array[1, k]
            if axis is None:
                difference = difference.copy()
                difference[..., k] -= self.width[k] * np.floor(difference[..., k] * inverse + 0.5)
            elif axis == k:
                difference = difference - self.width[k] * np.floor(difference * inverse + 0.5)
        return difference

    def wrapped(self, position: Array) -> Array:
        """Positions (N, d) [m] inside the domain, 0 <= x < width; the same array where none has to move."""
        for k in self.axes:
            x, width = position[:, k], self.width[k]
            out = (x < 0) | (x >= width)
            if out.any():
                position = position.copy()
                inside = x[out] - width * np.floor(x[out] / width)
                position[out, k] = np.where(inside < width, inside, 0.0)
        return position

    def unwrapped(self, corners: Array) -> Array:
        """Corners (M, n, d) of cells [m], each beside the first corner of its cell; the same array if not periodic."""
        if not self:
            return corners
        return np.asarray(corners[:, :1] + self.shortest(corners - corners[:, :1]))


def no_period(dimension: int) -> Period:
    """No axis of ``dimension`` is periodic."""
    return _NONE[dimension]


def axisymmetric() -> Period:
    """Coordinates (r, z) of an axisymmetric flow."""
    return _AXIAL


_AXIAL = Period(np.zeros(2), axial=True)
_NONE = {d: Period(np.zeros(d)) for d in (1, 2, 3)}

"""Grading: target spacings that depend on position and fluid."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from scipy.spatial import cKDTree

from tipfem.arguments import is_number, numbers
from tipfem.case.declaration import Unit, require
from tipfem.case.fluid import Fluid
from tipfem.errors import Invalid
from tipfem.geometry.box_points import BoxPoints
from tipfem.geometry.lattice import Part
from tipfem.geometry.plane.shape_points import ShapePoints
from tipfem.typing import Array

# Gradation limiting takes time for every distinct size; this many represent all of them.
SIZES = 16
# Every stride-th line of a lattice is kept. These strides share factors, so that lattices of different strides have
# points in common. Lines may be farther apart than the target by the factor ROUNDED.
STRIDES = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256])
ROUNDED = 1.06
THINNEST = 100 * (1 + 1e-9)  # spacings in the smallest target in films; steps are as short as that allows


@dataclass(frozen=True)
class Grading:
    """Target distances between particles, as a function of position and fluid.

    At interfaces, and in fluids that are not named, the target is the case's spacing, which is the smallest. Away
    from interfaces it grows to the fluid's largest target, also along walls. Particles are created and removed to
    follow it as the fluids move: edges become 0.7 to 1.7 targets long.

    Attributes:
        largest: by a fluid's name, the target far from its interfaces [m].
        growth: largest gradient of the target.
        where: function of positions (K, d) [m] to upper limits (K,) of the targets [m], for regions that need a finer
            resolution, such as boundary layers; or None. It must return values > 0; inf sets no limit, and values below
            the case's spacing count as that. It is evaluated at all particles at the start and after every step, in
            the frame that does not move with the tank. If no fluid is named, only this function limits the targets.
        film_resolution: the smallest target [m] in films and sheets, where targets are the thickness of a fluid that is
            thinner than the spacing. A film breaks by `FittedRule.thin_film` of it. By default the spacing.

    Raises:
        ValueError: a number is out of range, or not a number.
    """

    largest: Mapping[str, float] = field(default_factory=dict)
    growth: Annotated[float, Ge(0.02), Le(0.5)] = 0.2
    where: Callable[[Array], Array] | None = None
    film_resolution: Annotated[float | None, Gt(0), Unit("m")] = None

    def __post_init__(self) -> None:
        if not isinstance(self.largest, Mapping):
            text = f"is {self.largest!r}; it must name fluids, as {{'air': 0.01}} does"
            raise Invalid("grading.largest", text, "Grading")
        for name, value in self.largest.items():
            if not (is_number(value) and value > 0):
                text = f"is {value!r} m; it must be a finite number > 0"
                raise Invalid(("grading", "largest", name), text, "Grading, largest")
        object.__setattr__(self, "largest", dict(self.largest))
        require(self, ("grading",), names=("growth", "film_resolution"))
        if self.where is not None and not callable(self.where):
            raise Invalid("grading.where", f"is {self.where!r}; it must be a function of positions", "Grading")

    def summary(self) -> dict[str, object]:
        """The grading as it is written with results."""
        given = {"largest": dict(self.largest), "growth": self.growth, "where": self.where is not None}
        return given if self.film_resolution is None else {**given, "film_resolution": self.film_resolution}

    def of_fluids(self, names: list[str], spacing: float) -> Array:
        """Largest target (F,) of each fluid [m], by its name; ``spacing`` of the case is the smallest [m].

        Raises:
            ValueError: ``largest`` names a fluid that does not exist, or its target is below the spacing; or the
                resolution of films is not.
        """
        for name, value in self.largest.items():
            if name not in names:
                text = f"names {name!r}; the names of the case's fluids are {names}"
                raise Invalid("grading.largest", text, "Grading")
            if value < spacing * (1 - 1e-9):
                text = f"is {value!r} m, below the spacing of {spacing!r} m, which is the smallest target"
                raise Invalid(("grading", "largest", name), text, "Grading, largest")
        if (film := self.film_resolution) is not None and not spacing / THINNEST <= film <= spacing * (1 + 1e-9):
            text = f"is {film!r} m; it must be from 1/100 of the spacing, {spacing / 100:.4g} m, to {spacing:.4g} m"
            raise Invalid("grading.film_resolution", text, "Grading")
        others = np.inf if self.where and not self.largest else spacing
        return np.array([self.largest.get(name, others) for name in names], dtype=float)

    def sizing(self, position: Array, fluid: Array, at_interface: Array, largest: Array, spacing: float) -> Array:
        """The sizing function before its gradient is limited: target spacings (N,) [m].

        Args:
            position: (N, d) [m].
            fluid: (N,) of each particle; -1 for none, as on dry walls, where the target is the largest of all.
            at_interface: (N,) mask.
            largest: (F,) from `of_fluids`.
            spacing: the smallest target [m].

        Raises:
            ValueError: `where` raised, or returned values of the wrong shape or not > 0.
        """
        widest = max(axis.max() - axis.min() for axis in position.T)
        size = np.minimum(
            np.where(at_interface, spacing, np.where(fluid < 0, largest.max(), largest.take(fluid))), widest
        )
        if self.where is not None:
            try:
                given = numbers(self.where(position.copy()))
            except Exception as error:
                text = f"raised {type(error).__name__} for positions of shape {position.shape}: {error}"
                raise Invalid("grading.where", text, "Grading") from error
            if given.shape != size.shape:
                text = f"gave shape {given.shape} for positions of shape {position.shape}; it must be targets > 0 in "
                raise Invalid("grading.where", f"{text}metres, one for each, of shape {size.shape}", "Grading")
            if not (given > 0).all():
                i = int(np.argmin(given > 0))
                text = f"gave {given[i]} at {position[i].tolist()}; it must be > 0, in metres"
                raise Invalid("grading.where", text, "Grading")
            size = np.minimum(size, np.maximum(given, spacing))
        return np.asarray(size)


def thinned(
    grading: Grading,
    points: BoxPoints | ShapePoints,
    fluid: Array,
    fluid_at: Part,
    fluids: Sequence[Fluid],
    spacing: float,
) -> tuple[Array, Array]:
    """Mask (N,) of the points of a tank that become particles, and the strides (N,) of their lines.

    Every stride-th line along all axes becomes particles, fewer on walls. Corners of walls stay, and so do particles at
    interfaces; those on arcs are corners. ``points`` are as fine as the spacing, ``fluid_at`` has the fluids of
    positions elsewhere.
    """
    at_interface, line = points.at_interfaces(fluid, fluid_at), points.line
    largest = grading.of_fluids([f.name for f in fluids], spacing)
    size = points.limited(grading.sizing(points.position, fluid, at_interface, largest, spacing), spacing)
    target = limit_gradation_at_points(points.position, size, grading.growth)
    stride = STRIDES[np.searchsorted(STRIDES, ROUNDED * target / spacing, side="right") - 1]
    kept = at_interface | (line < 0).any(axis=1) | (line % stride[:, None] == 0).all(axis=1)
    return points.fewer_on_walls(kept, at_interface, target, stride, spacing), stride


def limit_gradation_at_points(position: Array, size: Array, growth: float) -> Array:
    """The largest target spacings (N,) [m] at most ``size`` (N,), growing by ``growth`` per distance at most."""
    levels = np.unique(size)
    if len(levels) > SIZES:
        levels = levels[np.linspace(0, len(levels) - 1, SIZES).astype(int)]
    target = size.copy()
    levels = levels[np.isfinite(levels)]
    for low, high in itertools.pairwise([*levels, np.inf]):
        of_this = (size >= low) & (size < high)
        larger = np.flatnonzero(target > low)
        if len(larger) and of_this.any():
            distance = cKDTree(position[of_this]).query(position[larger])[0]
            target[larger] = np.minimum(target[larger], low + growth * distance)
    return np.asarray(target)

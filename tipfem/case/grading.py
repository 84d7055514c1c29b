"""Grading: target spacings that depend on place and fluid."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from tipfem.arguments import is_number, numbers
from tipfem.case.fluid import Fluid
from tipfem.typing import Array

# A function of places is asked for sizes at all particles of a lattice; these many sizes stand for all of them.
SIZES = 16
# Every so many lines of a lattice are kept, the most that are not farther apart than this part of the target: numbers
# that share factors, so that thinned lattices have points in common where they meet.
STRIDES = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256])
ROUNDED = 1.06


@dataclass(frozen=True)
class Grading:
    """How far apart particles stand, as a function of place and fluid.

    At interfaces, and in fluids that are not named, the target is the case's own spacing, which is the smallest. Away
    from interfaces it grows to what a fluid allows, also along walls. Particles are created and removed to follow it
    as the fluids move: edges come to be 0.7 to 1.7 targets long.

    Attributes:
        largest: by a fluid's name, the target far from its interfaces [m].
        growth: by how much the target grows per distance, 0.02 to 0.5.
        where: function of positions (K, d) [m] to the largest targets (K,) there [m], for places that are to be
            resolved better - a boundary layer, say; or None. It must give values > 0; inf sets no limit, and below the
            case's spacing they count as that. It is asked for all particles at the start and after every step, in
            the frame that does not move with the tank. If no fluid is named, it alone says what targets are.

    Raises:
        ValueError: a number is out of range or none.
    """

    largest: Mapping[str, float] = field(default_factory=dict)
    growth: float = 0.2
    where: Callable[[Array], Array] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.largest, Mapping):
            raise ValueError(f"Grading: largest is {self.largest!r}; it must name fluids, as {{'air': 0.01}} does")
        for name, value in self.largest.items():
            if not (is_number(value) and value > 0):
                raise ValueError(f"Grading: largest of {name!r} is {value!r} m; it must be a finite number > 0")
        object.__setattr__(self, "largest", dict(self.largest))
        if not (is_number(self.growth) and 0.02 <= self.growth <= 0.5):
            raise ValueError(f"Grading: growth is {self.growth!r}; it must lie between 0.02 and 0.5")
        if self.where is not None and not callable(self.where):
            raise ValueError(f"Grading: where is {self.where!r}; it must be a function of positions")

    def summary(self) -> dict[str, object]:
        """What results say of it."""
        return {"largest": dict(self.largest), "growth": self.growth, "where": self.where is not None}

    def of_fluids(self, names: list[str], spacing: float) -> Array:
        """(F,) largest target of each fluid [m].

        Raises:
            ValueError: there is no fluid of a name that was given, or its target is below ``spacing`` [m].
        """
        for name, value in self.largest.items():
            if name not in names:
                raise ValueError(f"Grading: largest names {name!r}; the names of the case's fluids are {names}")
            if value < spacing * (1 - 1e-9):
                raise ValueError(
                    f"Grading: largest of {name!r} is {value!r} m, below the spacing of {spacing!r} m, which is the "
                    "smallest target"
                )
        others = np.inf if self.where and not self.largest else spacing
        return np.array([self.largest.get(name, others) for name in names], dtype=float)

    def sizing(self, position: Array, fluid: Array, at_interface: Array, largest: Array, spacing: float) -> Array:
        """(N,) targets if they could change from one particle to the next [m].

        Args:
            position: (N, d) [m].
            fluid: (N,) of each particle.
            at_interface: (N,) mask.
            largest: (F,) from `of_fluids`.
            spacing: the smallest target [m].

        Raises:
            ValueError: `where` gives what it must not.
        """
        widest = max(axis.max() - axis.min() for axis in position.T)
        wish = np.minimum(np.where(at_interface, spacing, largest.take(fluid)), widest)
        if self.where is not None:
            given = numbers(self.where(position.copy()))
            if given.shape != wish.shape:
                raise ValueError(
                    f"Grading: where gave shape {given.shape} for positions of shape {position.shape}; it must be "
                    f"targets > 0 in metres, one for each, of shape {wish.shape}"
                )
            if not (given > 0).all():
                i = int(np.argmin(given > 0))
                raise ValueError(f"Grading: where gave {given[i]} at {position[i].tolist()}; it must be > 0, in metres")
            wish = np.minimum(wish, np.maximum(given, spacing))
        return np.asarray(wish)


def thinned(
    grading: Grading, position: Array, shape: tuple[int, int], fluid: Array, fluids: Sequence[Fluid], spacing: float
) -> Array:
    """Which points of a lattice are to be particles: every one, every second, every third ... along both axes.

    Args:
        grading: of the targets.
        position: (N, 2) of the lattice [m], the second axis running fastest.
        shape: how many lines it has.
        fluid: (N,) of the points; where they differ from one to the next there is an interface.
        fluids: that the numbers stand for.
        spacing: of the lattice, the smallest target [m].

    Returns:
        (N,) mask.
    """
    grid = fluid.reshape(shape)
    at_interface = np.zeros(shape, dtype=bool)
    for one, other in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        differs = grid[one] != grid[other]
        at_interface[one] |= differs
        at_interface[other] |= differs
    largest = grading.of_fluids([f.name for f in fluids], spacing)
    wish = grading.sizing(position, fluid, at_interface.ravel(), largest, spacing)
    target = graded(position, wish, grading.growth)
    stride = STRIDES[np.searchsorted(STRIDES, ROUNDED * target / spacing, side="right") - 1].reshape(shape)
    row, column = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in shape)  # lines are counted from the next wall
    return ((row[:, None] % stride == 0) & (column[None, :] % stride == 0)).ravel()


def graded(position: Array, wish: Array, growth: float) -> Array:
    """(N,) the largest targets that are nowhere above ``wish`` (N,) and grow by ``growth`` per distance at most [m]."""
    sizes = np.unique(wish)
    if len(sizes) > SIZES:
        sizes = sizes[np.linspace(0, len(sizes) - 1, SIZES).astype(int)]
    target = wish.copy()
    sizes = sizes[np.isfinite(sizes)]
    for low, high in itertools.pairwise([*sizes, np.inf]):
        of_this = (wish >= low) & (wish < high)
        open_ones = np.flatnonzero(target > low)
        if len(open_ones) and of_this.any():
            distance = cKDTree(position[of_this]).query(position[open_ones])[0]
            target[open_ones] = np.minimum(target[open_ones], low + growth * distance)
    return target

"""Grading: target spacings that depend on place and fluid."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from tipfem.fluid import Fluid
from tipfem.particles import Array
from tipfem.validation import is_number, numbers

# A function of places is asked for sizes at all particles of a lattice; these many sizes stand for all of them.
SIZES = 16
# A lattice is thinned where the target is this part of twice the distance of its lines.
ROUNDED = 1.06


@dataclass(frozen=True)
class Grading:
    """How far apart particles stand, as a function of place and fluid.

    At interfaces, and in fluids that are not named, the target is the case's own spacing, which is the smallest. Away
    from them it grows to what a fluid allows; particles are created and removed to follow it as the fluids move.

    Attributes:
        largest: by a fluid's name, the target far from its interfaces [m].
        growth: by how much the target grows per distance.
        where: function of positions (K, d) to the largest targets (K,) there [m], for places that are to be resolved
            better; or None. It must give values > 0; below the case's spacing they count as that.

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
                raise ValueError(f"Grading: largest of {name!r} is {value!r} m; it must be > 0")
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
                raise ValueError(f"Grading: largest names {name!r}; the case's fluids are {names}")
            if value < spacing * (1 - 1e-9):
                raise ValueError(
                    f"Grading: largest of {name!r} is {value:g} m, below the spacing of {spacing:g} m, which is the "
                    "smallest target"
                )
        return np.array([self.largest.get(name, spacing) for name in names], dtype=float)

    def wishes(self, position: Array, fluid: Array, at_interface: Array, largest: Array, spacing: float) -> Array:
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
        wish = np.where(at_interface, spacing, largest[fluid])
        if self.where is not None:
            given = numbers(self.where(position.copy()))
            if given.shape != wish.shape or not (given > 0).all():
                bad = given[~(given > 0)][:1].tolist() if given.shape == wish.shape else f"shape {given.shape}"
                raise ValueError(f"Grading: where gave {bad}; it must be targets > 0 in metres, of shape {wish.shape}")
            wish = np.minimum(wish, np.maximum(given, spacing))
        return np.asarray(wish)


def thinned(
    grading: Grading, position: Array, shape: tuple[int, int], fluid: Array, fluids: Sequence[Fluid], spacing: float
) -> Array:
    """Which points of a lattice are to be particles: every one, every other, every fourth ... along both axes.

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
    wish = grading.wishes(position, fluid, at_interface.ravel(), largest, spacing)
    target = graded(position, wish, grading.growth)
    level = np.maximum(np.floor(np.log2(ROUNDED * target / spacing)), 0).astype(int)
    row, column = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in shape)  # lines are counted from the next wall
    mask = (2**level - 1).reshape(shape)
    return (((row[:, None] & mask) == 0) & ((column[None, :] & mask) == 0)).ravel()


def graded(position: Array, wish: Array, growth: float) -> Array:
    """(N,) the largest targets that are nowhere above ``wish`` (N,) and grow by ``growth`` per distance at most [m]."""
    sizes = np.unique(wish)
    if len(sizes) > SIZES:
        sizes = sizes[np.linspace(0, len(sizes) - 1, SIZES).astype(int)]
    target = wish.copy()
    for low, high in itertools.pairwise([*sizes, np.inf]):
        of_this = (wish >= low) & (wish < high)
        open_ones = np.flatnonzero(target > low)
        if len(open_ones) and of_this.any():
            distance = cKDTree(position[of_this]).query(position[open_ones])[0]
            target[open_ones] = np.minimum(target[open_ones], low + growth * distance)
    return target


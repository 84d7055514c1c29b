"""Regions: the parts of a tank that are filled with fluids, and what is where."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tipfem.arguments import is_number, numbers
from tipfem.case.fluid import Fluid
from tipfem.errors import Invalid
from tipfem.geometry.lattice import BESIDE
from tipfem.geometry.period import Period
from tipfem.geometry.plane.shapes import Shape
from tipfem.typing import Array

NEAR = 1e-6  # of a face: what is on it [spacings]
SAMPLED = 500_000  # points at most, at which `Filling.misfit` asks for fluids in the cells between fluids
MISFIT = 0.02  # of a fluid's area: what may be missing or too much at the start without a word


@dataclass
class Region:
    """A filled part of the tank."""

    fluid: Fluid  # that fills it
    part: str  # its description in messages
    contains: Callable[[Array], Array]  # function of positions (K, d) [m] to a mask (K,) of those in the region
    box: Array | None = None  # (2, d) lower and upper corner of a box [m]; None for other shapes
    # the argument of `Tank.fill` for the region, "box", "disc", "where" or "shape", with its value; empty for the whole
    # tank
    given: dict[str, Any] = field(default_factory=dict)
    # at the start: (d,) [m/s], or function of positions (K, d) [m] to velocities (K, d) [m/s]; None at rest
    velocity: Callable[[Array], Array] | Array | None = None

    def mask(self, x: Array) -> Array:
        """Mask (K,) of the points (K, d) [m] in the region; `ValueError` if a user's function raised or made none."""
        here = f"fill {self.fluid.name!r}: {self.part}"
        inside = _called(self.contains, x, here)
        if inside.shape != (len(x),) or inside.dtype != bool:
            text = f"{here} gave {inside.dtype} of shape {inside.shape}; it must be a mask, bool of shape {(len(x),)}"
            raise ValueError(text)
        return inside

    def initial_velocity(self, x: Array) -> Array:
        """Velocities (K, d) [m/s] at points (K, d) [m]; `ValueError` if a user's function raised or made none."""
        if self.velocity is None or not len(x):
            return np.zeros_like(x)
        if not callable(self.velocity):
            return np.broadcast_to(self.velocity, x.shape)
        here = f"fill {self.fluid.name!r}: velocity={name_of(self.velocity)}"
        result = _called(self.velocity, x, here, float)
        if result.shape != x.shape:
            raise ValueError(f"{here} gave shape {result.shape}; it must be velocities of shape {x.shape}")
        bad = ~np.isfinite(result).all(axis=1)
        if bad.any():
            i = int(np.argmax(bad))
            raise ValueError(f"{here} gave {result[i].tolist()} at {x[i].tolist()}; it must be finite")
        return result


def _called(function: Callable[[Array], Any], x: Array, here: str, dtype: Any = None) -> Array:
    """Result of a user's function on a copy of positions (K, d), since it may work in place; see `Region.mask`."""
    try:
        return np.asarray(function(x.copy()), dtype=dtype)
    except Exception as error:
        text = f"{here} raised {type(error).__name__} for positions of shape {x.shape}: {error}"
        raise ValueError(text) from error


def region_of(fluid: Fluid, tank: Array, slack: Array, velocity: Any, **part: Any) -> Region:
    """The region of `Tank.fill`, whose arguments and errors it has, in a box ``tank`` (2, d) [m].

    Boxes and shapes reach ``slack`` (d,) beyond their faces, so that those on walls belong to them [m]. Of ``part``,
    box, disc, where and shape, at most one is not None.
    """
    if not isinstance(fluid, Fluid):
        why = "; a tank knows no names of fluids" if isinstance(fluid, str) else ""
        raise ValueError(f"fill: fluid is {fluid!r}{why}; it must be a Fluid, as tp.Fluid('water', 998.2, 1e-3)")
    given = {name: value for name, value in part.items() if value is not None}
    if len(given) > 1:
        raise ValueError("fill: give one of box, disc, where and shape, not several")
    here = f"fill {fluid.name!r}"
    if not given:
        region = Region(fluid, "tank", lambda x: np.ones(len(x), dtype=bool))
    else:
        ((name, value),) = given.items()
        region = _REGIONS[name](fluid, here, value, tank, slack)
    region.velocity = _checked_velocity(here, velocity, tank.shape[1])
    return region


def _checked_velocity(here: str, velocity: Any, dimension: int) -> Any:
    if velocity is None or callable(velocity):
        return velocity
    vector = numbers(velocity)
    if vector.shape != (dimension,) or not np.isfinite(vector).all():
        text = f"is {velocity!r}; it must be {dimension} finite components in m/s, or a function of positions"
        raise Invalid("velocity", text, here)
    return vector


def _of_box(fluid: Fluid, here: str, box: Any, tank: Array, slack: Array) -> Region:
    corners, size = numbers(box), tank[1] - tank[0]
    if corners.shape != tank.shape or not (corners[0] < corners[1]).all():
        text = f"is {box!r}; it must be (lower, upper), two corners of {len(size)} coordinates with lower < upper"
        raise Invalid("box", text, here)
    if (corners[1] <= tank[0]).any() or (corners[0] >= tank[1]).any():
        raise Invalid("box", f"is {box!r} m, which lies outside the tank of {size.tolist()} m", here)
    corners = np.clip(corners, *tank)

    def contains(x: Array) -> Array:
        return np.asarray(((x > corners[0] - slack) & (x < corners[1] + slack)).all(axis=1))

    return Region(fluid, f"box {box!r}", contains, corners, {"box": box})


def _of_disc(fluid: Fluid, here: str, disc: Any, tank: Array, slack: Array) -> Region:
    given, size = disc if isinstance(disc, Sequence) and len(disc) == 2 else (None, None)
    centre, radius = numbers(given), numbers(size)
    if centre.shape != tank[0].shape or not np.isfinite(centre).all() or not is_number(size) or not radius > 0:
        text = f"is {disc!r}; it must be (centre, radius) with a centre of {tank.shape[1]} coordinates and a radius > 0"
        raise Invalid("disc", text, here)
    return Region(
        fluid,
        f"disc {disc!r}",
        lambda x: ((x - centre) ** 2).sum(axis=1) < radius**2,
        given={"disc": (centre, float(radius))},
    )


def _of_function(fluid: Fluid, here: str, where: Any, tank: Array, slack: Array) -> Region:
    if not callable(where):
        raise ValueError(f"{here}: where is {where!r}; it must be a function of positions")
    return Region(fluid, f"where={name_of(where)}", where, given={"where": where})


def _of_shape(fluid: Fluid, here: str, given: Any, tank: Array, slack: Array) -> Region:
    if tank.shape[1] != 2:
        raise Invalid("shape", "is given in 3-D; shapes are for 2-D only", here)
    try:
        shape = Shape.of(given)
    except ValueError as error:
        raise Invalid("shape", f": {error}", here) from error
    lower, upper = shape.box
    if (upper <= tank[0]).any() or (lower >= tank[1]).any():
        text = f"reaches from {lower.tolist()} to {upper.tolist()} m, outside the tank, which extends from "
        raise Invalid("shape", f"{text}{tank[0].tolist()} to {tank[1].tolist()} m", here)
    reach = float(slack.max())
    return Region(fluid, "shape", lambda x: shape.contains(x) | shape.touches(x, reach), given={"shape": shape})


_REGIONS = {"box": _of_box, "disc": _of_disc, "where": _of_function, "shape": _of_shape}


class Filling:
    """The regions of a tank, later ones replacing earlier ones, with the fluids of a case; else `ValueError`.

    Parts of the tank may be empty if ``empty``; ``number`` is that of the fluid of each region.
    """

    def __init__(self, regions: Sequence[Region], fluids: Sequence[Fluid], *, empty: bool) -> None:
        for region in regions:
            if region.fluid not in fluids:
                text = f"tank is filled with {region.fluid.name!r}, which is not among the case's fluids "
                raise ValueError(f"{text}{[f.name for f in fluids]}")
        self._regions, self._empty = regions, empty
        self.number = [list(fluids).index(region.fluid) for region in regions]
        self._nothing = len(fluids) if empty else 0

    def _last(self, values: Sequence[int], x: Array, nothing: int) -> Array:
        """The value (K,) of the last region that holds each of the points (K, d), or that for none."""
        label = np.full(len(x), nothing, dtype=np.int32)
        for region, value in zip(self._regions, values, strict=True):
            label[region.mask(x)] = value
        return label

    def fluid(self, x: Array) -> Array:
        """Number (K,) of the fluid at points (K, d) [m]; the number of the fluids where there is none."""
        return self._last(self.number, x, self._nothing)

    def is_empty(self, x: Array) -> Array:
        """Mask (K,) of the points (K, d) [m] in parts that may be empty, and are."""
        return np.asarray(self.fluid(x) == self._nothing)

    def label(self, x: Array) -> Array:
        """Number (K,) of the fluid at points (K, d) [m]; -1 where there is none."""
        return self._last(self.number, x, -1)

    def part(self, x: Array, spacing: float, box: Array) -> Array:
        """Number (K,) of the fluid around points (K, d) in the ``box`` (2, d) around the tank [m]; -1 on faces."""
        near = NEAR * spacing * np.array(list(itertools.product((-1, 1), repeat=x.shape[1])))
        around = np.stack([self.fluid(np.clip(x + by, *box)) for by in near])
        return np.where((around == around[0]).all(axis=0), around[0], -1)

    def faces(self, axis: int) -> set[float]:
        """Coordinates of the faces of filled boxes along one axis [m]."""
        boxes = [region.box for region in self._regions if region.box is not None]
        return {float(x) for box in boxes for x in box[:, axis]}

    def require_particles(self, position: Array, wall: Array, spacing: float) -> None:
        """`ValueError` unless fluids fill the tank, and every region holds one of the particles (N, d) [m] off walls.

        Wall particles take the fluid of their neighbours, so a region with wall particles only would be lost silently.
        """
        for number, region in enumerate(self._regions):
            if not (region.mask(position) & ~wall).any():
                raise Invalid(
                    ("fill", number, *(key for key in region.given if key != "where")),
                    f": {region.part} holds no particle off the walls; it lies outside the "
                    f"tank, or is too small for a spacing of {spacing:g} m",
                    f"fill {region.fluid.name!r}",
                )
        fluid = self.label(position)
        if (fluid < 0).any() and not self._empty:
            i = int(np.argmax(fluid < 0))
            text = f": no fluid at {position[i].tolist()}; fill the whole tank first, then parts of it, or give the "
            raise Invalid("tank", f"{text}case a free surface")
        if (fluid < 0).all():
            raise Invalid("tank", ": it is empty; fill at least one part of it with a fluid")

    def misfit(
        self, corners: Array, share: Array, faces: Array, area: Array, period: Period
    ) -> tuple[int, float, float] | None:
        """The fluid whose cells differ most in measure from its regions: its number, what is there and asked [m^d].

        None if none differs by more than `MISFIT`. Cells are sampled densely where a few points in them differ, where
        several fluids are, and at faces between fluids.

        Args:
            corners: (M, d + 1, d) of the cells [m].
            share: (M, F) part of each cell that each fluid fills, with nothing as the last where there is any.
            faces: (M,) mask of those that have another fluid beside them.
            area: (M,) measure of the cells [m^d].
        """

        def parts(cells: Array, count: int) -> Array:
            """Fluids (K, count^2) that are asked for at points of K cells."""
            weights = _points_in_cells(count, len(cells), corners.shape[2])
            points = (weights @ corners[cells]).reshape(-1, corners.shape[2])
            return self.fluid(period.wrapped(points)).reshape(len(cells), count**2)

        fluid = share.argmax(axis=1)
        faces = faces | (share.max(axis=1) < 1 - 1e-9)
        few = parts(np.arange(len(fluid)), 2)
        crossed = np.flatnonzero(faces | (few != fluid[:, None]).any(axis=1))
        asked = parts(crossed, int(np.clip((SAMPLED / max(len(crossed), 1)) ** 0.5, 2, 12)))
        rest = np.delete(np.arange(len(fluid)), crossed)
        largest, worst = 0.0, None
        for number in sorted(set(self.number)):
            same = float(area[rest[fluid[rest] == number]].sum())
            wanted = same + float(area[crossed] @ (asked == number).mean(axis=1))
            there = same + float(area[crossed] @ share[crossed, number])
            if abs(there - wanted) > max(MISFIT * wanted, 1.001 * largest) and wanted > 0:
                largest, worst = abs(there - wanted), (number, there, wanted)
        return worst

    def velocity(self, position: Array, fluid: Array, spacing: float, period: Period) -> Array:
        """Velocities (N, d) of particles at the start [m/s]: those of the last region around each.

        A particle on a face has the velocity of a region beside it that is of its own fluid: the face itself, by
        round-off, may be in any region or in none. See `Region.mask` and `Region.initial_velocity` for errors.
        """
        velocity = np.zeros_like(position)
        if all(region.velocity is None for region in self._regions):
            return velocity
        each = range(len(self._regions))
        of, fluid_of = self._last(each, position, len(each)), np.append(self.number, -1)
        for side in itertools.product((-1, 1), repeat=position.shape[1]):
            other = np.flatnonzero((fluid_of[of] != fluid) & (fluid >= 0))
            beside = self._last(each, period.wrapped(position[other] + BESIDE * spacing * np.array(side)), len(each))
            fits = fluid_of[beside] == fluid[other]
            of[other[fits]] = beside[fits]
        for k, region in enumerate(self._regions):
            velocity[of == k] = region.initial_velocity(position[of == k])
        velocity[fluid < 0] = 0.0
        return velocity


def _points_in_cells(count: int, cells: int, dimension: int) -> Array:
    """Barycentric coordinates (K or 1, count^2, d + 1) of points spread evenly in K cells.

    In triangles the centres of the equal ones in it, in tetrahedra others in each, by chance but the same at all times.
    """
    if dimension == 3:
        return np.random.default_rng(0).dirichlet(np.ones(4), (cells, count**2))
    up = [(i + 1 / 3, j + 1 / 3) for i in range(count) for j in range(count - i)]
    down = [(i + 2 / 3, j + 2 / 3) for i in range(count) for j in range(count - i - 1)]
    at = np.array(up + down) / count
    return np.column_stack([1 - at.sum(axis=1), at])[None]


def name_of(function: Callable[[Array], Array]) -> str:
    """The name of a user's function, for messages."""
    return str(getattr(function, "__name__", type(function).__name__))

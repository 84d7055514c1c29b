"""View of a scene: the part of the domain, and the layers drawn over the fluids."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .arrays import Array, Range
from .camera import checked_angles
from .colours import COLOUR_MAPS, LOOKS
from .scene import Scene
from .slices import Plane

FOLLOWED_SHARE = 1 / 3  # of the domain: the window that follows a fluid, if none is given


@dataclass(frozen=True, kw_only=True)
class View:
    """Part of a scene and layers that a picture shows.

    Attributes:
        window: (x0, y0, x1, y1) the part of the domain that is shown [m]; None shows all of it.
        follow: "front" moves the window with the front of the heaviest fluid, its point of largest x,
            "front:NAME" with the front of the fluid of that name, and "NAME" with its centre. The window keeps its
            size, a third of the domain if none is given, and stays inside the domain.
        fill: colour the cells; without it the interface and the other layers stand alone on white.
        arrows: draw arrows of the velocity, to scale.
        arrow_speed: of the arrow in the legend [m/s]; None takes a round one from the scene, and in `animate` one from
            all of them, so that equal arrows are equal speeds.
        streamlines: draw streamlines of the velocity at this time.
        contours: name of a field whose contours are drawn, or None.
        interval: between contours, in the field's SI unit; None takes a round one from the scene, and in `animate` from
            all of them.
        tracers: number of points that move with the fluids from the first stored time on, with tails behind
            them; used by `animate`, which knows all times.
        colour_map: "viridis" or "cividis", of a lightness that grows steadily, or "blue-red", white in the middle;
            None takes blue-red for components of the velocity and viridis for other fields.
        muted: names of fluids that keep their own colour, and have no contours, where the pressure is shown. None takes
            light ones whose pressure hardly varies, see `tipfem.render.scales.FieldSample`; () takes none.
        smooth: draw the fluids within smoothed outlines, see `tipfem.render.outlines`; False follows the edges of the
            mesh. None smooths in files where the fluids alone are shown, see `for_files`.
        look: "lit" shades the fluids by depth, "flat" fills them with one colour each, for print. None is lit in
            movies, strips and `RunResults.picture`, else flat.
        slice: plane that is shown of a flow in 3-D, such as "y=0.5"; used where results are read.
        camera: azimuth and elevation [degrees] from which a flow in 3-D is seen; None for (-25, 18).

    Raises:
        ValueError: a value is invalid; the message names it.
    """

    window: tuple[float, float, float, float] | None = None
    follow: str | None = None
    fill: bool = True
    arrows: bool = False
    arrow_speed: float | None = None
    streamlines: bool = False
    contours: str | None = None
    interval: float | None = None
    tracers: int = 0
    colour_map: str | None = None
    muted: tuple[str, ...] | None = None
    smooth: bool | None = None
    look: str | None = None
    slice: str | None = None
    camera: tuple[float, float] | None = None

    def for_files(self, field: str | None, mesh: bool, particles: bool) -> "View":
        """This view with the outlines of movies and strips: smoothed where nothing but the fluids is shown.

        Raises:
            ValueError: outlines are to be smoothed beside what follows the mesh.
        """
        measured = {
            "a field": field is not None,
            "the mesh": mesh,
            "the particles": particles,
            "contours": self.contours is not None,
            "cells that are not filled": not self.fill,
        }
        beside = [name for name, there in measured.items() if there]
        if self.smooth and beside:
            raise ValueError(f"smoothed outlines do not fit {beside[0]}, which follows the mesh; leave out one of them")
        smooth = not beside if self.smooth is None else self.smooth
        return replace(self, smooth=smooth, look=self.look or "lit")

    def __post_init__(self) -> None:
        if self.window is not None:
            try:
                x0, y0, x1, y1 = (float(value) for value in self.window)
            except (TypeError, ValueError):
                raise ValueError(f"window {self.window!r}: expected four numbers, x0, y0, x1, y1 [m]") from None
            if not (np.isfinite([x0, y0, x1, y1]).all() and x0 < x1 and y0 < y1):
                raise ValueError(f"window {x0:g} {y0:g} {x1:g} {y1:g}: expected x0 below x1 and y0 below y1")
            object.__setattr__(self, "window", (x0, y0, x1, y1))
        if self.interval is not None and not (np.isfinite(self.interval) and self.interval > 0):
            raise ValueError(f"interval {self.interval:g} between contours: expected a number above 0")
        if self.arrow_speed is not None and not (np.isfinite(self.arrow_speed) and self.arrow_speed > 0):
            raise ValueError(f"arrow speed {self.arrow_speed:g} m/s: expected a number above 0")
        if not 0 <= self.tracers <= 100_000:
            raise ValueError(f"tracers {self.tracers}: expected a number from 0 to 100000")
        if self.muted is not None:
            object.__setattr__(self, "muted", tuple(self.muted))
        if self.slice is not None:
            object.__setattr__(self, "slice", str(Plane.of(self.slice)))
        if self.camera is not None:
            object.__setattr__(self, "camera", checked_angles(self.camera))
        if self.look not in (None, *LOOKS):
            raise ValueError(f"look {self.look!r}: expected one of {', '.join(LOOKS)}")
        if self.colour_map is not None and self.colour_map not in COLOUR_MAPS:
            raise ValueError(f"colour map {self.colour_map!r}: expected one of {', '.join(COLOUR_MAPS)}")

    def bounds(self, scene: Scene) -> tuple[Array, Array]:
        """Corners (2,) [m] of the part of a scene that is shown; `ValueError` if what is followed is not in it."""
        lower, upper = scene.lower, scene.upper
        if self.window is not None:
            lower, upper = np.array(self.window[:2]), np.array(self.window[2:])
        if self.follow is None:
            return lower, upper
        size = upper - lower if self.window is not None else FOLLOWED_SHARE * (upper - lower)
        size = np.minimum(size, scene.upper - scene.lower)
        corner = np.clip(_followed(scene, self.follow) - size / 2, scene.lower, scene.upper - size)
        return corner, corner + size


class Look(NamedTuple):
    """Choice of what a picture shows of a scene."""

    field: str | None = None  # that colours it; None shows the fluids
    field_range: Range | None = None  # (low, high) of the colours
    mesh: bool = False  # whether the edges of the cells are drawn
    particles: bool = False  # whether the particles are
    view: View = View()  # the part shown, the layers and the colour map


def _followed(scene: Scene, follow: str) -> Array:
    """The point (2,) [m] that a window follows."""
    kind, colon, name = follow.partition(":")
    if follow == "front":
        densities = scene.fluid_densities
        fluid = 0 if densities is None else int(np.argmax(densities))
    else:
        name = name if kind == "front" and colon else follow
        if name not in scene.fluid_names:
            raise ValueError(
                f"follow {follow!r}: expected front, front:NAME or NAME; the fluids are: {', '.join(scene.fluid_names)}"
            )
        fluid = scene.fluid_names.index(name)
    # A particle on an interface belongs to both fluids.
    own = scene.fluid == fluid
    if scene.cell_fluid is not None:
        own = np.zeros(len(scene.position), bool)
        own[scene.cells[scene.cell_fluid == fluid]] = True
    points = scene.position[own]
    if len(points) == 0:  # gone at this time, an emptied tank for example
        points = scene.position
    if kind == "front":
        return np.asarray(points[points[:, 0].argmax()])
    return np.asarray(points.mean(axis=0))

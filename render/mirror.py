"""The other half of an axisymmetric flow, so that a picture shows all of a cross-section through the axis."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .arrays import Array

ON_AXIS = 1e-9  # of the spacing: particles that are closer to the axis are on it


def with_mirrored(position: Array, cells: Array, spacing: float) -> tuple[Array, Array, Array]:
    """A mesh on both sides of the axis x = 0, from the half of it with x >= 0; both share the particles on the axis.

    Positions (P, 2) of the particles, and then of the images of those off the axis [m]; cells (2 M, 3), the images
    last; and the number (P,) of the particle that each is an image of.
    """
    off = np.flatnonzero(np.abs(position[:, 0]) > ON_AXIS * spacing)
    image = np.arange(len(position))
    image[off] = len(position) + np.arange(len(off))
    places = np.concatenate([position, position[off] * (-1.0, 1.0)])
    return places, np.concatenate([cells, image[cells][:, ::-1]]), np.concatenate([np.arange(len(position)), off])


def mirrored_outline(facts: Mapping[str, Any]) -> dict[str, Any]:
    """The walls of a tank, see `tipfem.render.tank.TankOutline`, on both sides of the axis."""
    loops = []
    for loop in facts["loops"]:
        corners = np.asarray(loop["corners"], float)
        on = np.flatnonzero((corners[:, 0] == 0) & (np.roll(corners[:, 0], -1) == 0))
        other = corners[::-1] * (-1.0, 1.0)
        if len(on):  # without the edge along the axis, from its upper end to the lower one
            around = np.roll(corners, -int(on[0]) - 1, axis=0)
            loops.append(np.concatenate([around, (around[::-1] * (-1.0, 1.0))[1:-1]]))
        else:
            loops += [corners, other]
    return {**facts, "loops": [{"corners": corners.tolist()} for corners in loops]}

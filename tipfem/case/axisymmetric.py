"""Limits of axisymmetric flows: one table, of cases, commands and probes.

Such a flow is that of a tank with ``coordinates = "axisymmetric"``: positions are (r, z), and each cell is a ring.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tipfem.case.walls import Wall
from tipfem.errors import Invalid
from tipfem.geometry.box_sides import AXIS
from tipfem.geometry.period import Period, axisymmetric

NAMES = ("planar", "axisymmetric")
PROBES = ("WaveProbe", "WallForce", "FilmProbe")  # that measure what such flows do not have


def require_axisymmetric(case: Any) -> None:
    """Check that a case can be simulated as an axisymmetric flow; else `Invalid`."""
    gravity, walls = np.asarray(case.gravity, dtype=float), case.walls
    r, z = case.particles.position.T
    around = [w for w in walls if w.velocity is not None and (w.particles is None or np.ptp(r[w.particles]) > 0)]
    sideways = [w for w in walls if w.motion is not None and (w.particles is None or np.ptp(z[w.particles]) > 0)]
    refused: list[tuple[Any, bool, str]] = [
        ("interface", case.interface != "sharp", f"is {case.interface!r}; it must be 'sharp'"),
        ("gravity", gravity[0] != 0, f"is {gravity.tolist()} m/s^2; it must act along z, (0, g)"),
        ("tank_motion", case.tank_motion is not None, "is given; a round tank stands still"),
        ("numerics.jacobian", case.numerics.jacobian != "rows", f"is {case.numerics.jacobian!r}; it must be 'rows'"),
        ("numerics.budget", case.numerics.budget == "detailed", "is 'detailed'; it must be another"),
        *((("walls", wall.name, "motion"), True, "is given; only a wall across z can move") for wall in sideways),
        *((("walls", wall.name, "velocity"), True, "is given; only a wall along z can slide") for wall in around),
    ]
    for path, there, text in refused:
        if there:
            raise Invalid(path, f"{text} in an axisymmetric flow", "Case")


def around_axis(case: Any, coordinates: str, *, periodic: bool) -> tuple[Period, list[Wall]]:
    """Coordinates (r, z) of particles given as arrays, and walls, with the axis; `Invalid` if they do not fit."""
    if coordinates not in NAMES:
        raise Invalid("coordinates", f"is {coordinates!r}; it must be one of {', '.join(map(repr, NAMES))}", "Case")
    position, axis = case.particles.position, case.particles.wall & (case.particles.position[:, 0] == 0)
    there = any(wall.name == AXIS for wall in case.walls)
    if position.shape[1] != 2 or periodic or not (case.domain is None or there):
        text = "is 'axisymmetric'; particles given as arrays must be (N, 2) then, without period and shape"
        raise Invalid("coordinates", text, "Case")
    if (position[:, 0] < 0).any() or not axis.any():
        i = int(position[:, 0].argmin())
        text = f": particle {i} is at r = {position[i, 0]:g} m; the least radius must be 0, of particles on the axis"
        raise Invalid("particles", text, "Case")
    return axisymmetric(), [*([] if there else [Wall(AXIS, particles=axis, slip=True)]), *case.walls]


def refuses_probe(case: Any, kind: str) -> bool:
    """Whether a probe of a ``kind``, the name of its class, does not fit the coordinates of a case."""
    return bool(case.period.axial) and kind in PROBES

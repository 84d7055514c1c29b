"""Layers: the boundary layers on walls whose law is "layer", by the walls' own history.

A boundary layer thinner than the particles' spacing cannot be resolved. Held at the wall's velocity, the row of
particles at the wall would take the momentum of half a spacing of fluid instead, and every flip, split or collapse
there would take more. Under this law the row slips, with the friction of the layer that the mesh does not have.

Along the wall, let U be the velocity of the fluid outside the layer relative to the wall, and delta the displacement
thickness of the layer. The wall has then taken the momentum rho U delta per area, so with the traction tau

    d(U delta) / dt = tau / rho,    tau = mu U / l,    l = pi / 2 delta,

where the last relation is that of the layer on a wall set off at once (Stokes' first problem, Schlichting & Gersten,
Boundary-Layer Theory, section 5.3: tau = mu U / sqrt(pi nu t), delta = 2 sqrt(nu t / pi)). For Q = |U delta| U delta
this is the linear equation

    dQ / dt = 4 nu / pi |U| U,

which is solved at fixed points of the wall; Q begins with zero where another fluid arrives. For U = a t its traction is
mu U sqrt(3 / (pi nu t)), where the exact one is mu U sqrt(4 / (pi nu t)).

The row of particles at the wall stands for half a spacing h of fluid, and has lost the layer's momentum: its slip
velocity is U (1 - 2 delta / h). So the slip length for that velocity is l (1 - 2 delta / h), and once the layer is as
thick as half a spacing, the mesh resolves it: the wall is a no-slip wall.

A flow that moves at the start has a history that the walls do not know. Its velocities tell the layer: particles at the
wall that slip by V, where the next row has U, have a layer with delta = h / 2 (1 - V / U). So a profile that is zero at
the wall, that of a channel for instance, begins resolved, and a uniform flow as if the wall were set off at that
moment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tipfem.backend.launch import launch
from tipfem.case.boundary.boundary import Boundary
from tipfem.geometry.period import Period
from tipfem.physics.carried import Carried
from tipfem.physics.walls.kernels import AdvancedLayers, LayerFaceArrays, LayerPoints, advance_layers, find_nearest
from tipfem.scratch import owned
from tipfem.typing import Array

LAYER = "layer"  # the law's name
# Slip length where the layer is resolved, in target spacings: the friction keeps the slip below a thousandth of the
# velocity in the next row.
RESOLVED = 1e-3
# Part of the wall's rms velocity below which the flow at a point is too slow for its layer to be called resolved.
FLOWS = 0.3
REACH = 1.5  # distance within which a face acts on a point of the wall, in target spacings
BEYOND = 1.01  # times that: as far as faces are looked for
DRY = -1  # the fluid at a point of the wall that none wets


@dataclass(frozen=True)
class Layers(Carried):
    """The boundary layers at P points of the walls with the law; d dimensions."""

    place: Array  # (P, d) points of these walls in the tank's frame at t = 0 [m]
    part: Array  # (P,) number of the part of a wall that each point is on, see `tipfem.physics.walls.friction.Part`
    fluid: Array  # (P,) the fluid at each point, `DRY` for none
    history: Array  # (P, d) Q = |U delta| U delta at each point, in the tank's frame [m^4/s^2]

    @staticmethod
    def on(boundary: Boundary, place: Array) -> Layers | None:
        """No layers yet, at places (W, d) of wall particles in the tank's frame [m]; None without walls of the law."""
        straight = [(wall, found) for wall, _, found in boundary.members]
        curved = [(c.wall, np.flatnonzero(boundary.on_curve == k)) for k, c in enumerate(boundary.curves)]
        parts = [
            (number, found)
            for number, (wall, found) in enumerate([*straight, *curved])
            if boundary.walls[wall].law == LAYER
        ]
        if not parts:
            return None
        part = np.repeat([number for number, _ in parts], [len(found) for _, found in parts])
        points = np.ascontiguousarray(place[np.concatenate([found for _, found in parts])])
        return Layers(points, part, np.full(len(points), DRY), np.zeros_like(points))


@dataclass(frozen=True)
class LayerFaces:
    """The F faces on the walls with the law in a step."""

    part: Array  # (F,) number of the part of a wall that each is on
    middle: Array  # (F, d) in the tank's frame [m]
    # (F, d) of the fluid in the next row relative to the wall, along it, in the tank's frame, in the middle of the step
    # [m/s]
    velocity: Array
    slip: Array  # (F, d) the same of the particles at the wall, at the start of the step [m/s]
    viscosity: Array  # (F,) kinematic [m^2/s]
    fluid: Array  # (F,) of the faces' cells
    spacing: Array  # (F,) target spacing of the particles [m]
    period: Period  # of the positions

    def nearest(self, layers: Layers) -> tuple[Array, Array]:
        """Distance (P,) [m] of the layers' points to the nearest face of their part, see `_nearest`; and its number."""
        reach = BEYOND * REACH * float(self.spacing.max())
        return _nearest(layers.place, layers.part, self.middle, self.part, self.period, reach)


def _nearest(
    place: Array, part: Array, others: Array, part_of_others: Array, period: Period, reach: float = np.inf
) -> tuple[Array, Array]:
    """Distance (P,) from places (P, d) to the nearest of ``others`` (Q, d) on the same part [m], and its number (P,).

    Where there is none on that part, or in 3-D within ``reach``, the distance is 1e15 m or infinite, and the number 0.
    """
    distance, number = np.empty(len(place)), np.empty(len(place), dtype=np.int32)
    if place.shape[1] == 2:  # walls of few points
        parts = (numbers.astype(np.int32, copy=False) for numbers in (part, part_of_others))
        launch(find_nearest, place, next(parts), others, next(parts), period.array, distance, number)
        return distance, number
    distance[:], number[:] = np.inf, 0
    for k in np.unique(part):
        mine, there = np.flatnonzero(part == k), np.flatnonzero(part_of_others == k)
        if len(there):
            # Asked once only: what takes longer to build does not pay.
            tree = cKDTree(others[there], balanced_tree=False, compact_nodes=False, boxsize=period.tree_box)
            distance[mine], found = tree.query(place[mine], distance_upper_bound=reach)
            number[mine] = np.append(there, 0)[found]
    return distance, number


def begin(layers: Layers, faces: LayerFaces) -> Layers:
    """The layers at the start of a run, from the velocities there; ``layers``: none yet, see `Layers.on`."""
    if not len(faces.middle):
        return layers
    distance, face = faces.nearest(layers)
    u, v, h = faces.velocity[face], faces.slip[face], faces.spacing[face]
    square = (u * u).sum(axis=1)
    part = 1 - np.divide((u * v).sum(axis=1), square, out=np.ones_like(square), where=square > 0)
    thickness = 0.5 * h * np.clip(part, 0.0, 1.0)
    wet = distance < REACH * h
    history = np.where(wet, thickness**2 * np.sqrt(square), 0.0)[:, None] * u
    return replace(layers, fluid=np.where(wet, faces.fluid[face], DRY).astype(layers.fluid.dtype), history=history)


def advance(layers: Layers, faces: LayerFaces, dt: float) -> tuple[Layers, Array, Array]:
    """Advance the layers by a step.

    Returns the layers at its end, the mean slip length in the step at each face (F,) [m], and a mask (F,) of the faces
    at which the layer is resolved.
    """
    if not len(faces.middle):
        dry = replace(layers, fluid=np.full_like(layers.fluid, DRY), history=np.zeros_like(layers.history))
        return dry, np.zeros(0), np.zeros(0, dtype=bool)
    distance, face = faces.nearest(layers)
    # Where several fluids meet, a face takes the nearest point of its own.
    _, point = _nearest(faces.middle, faces.part, layers.place, layers.part, faces.period)
    count, d = layers.place.shape
    here, history, flux = owned(count, np.int32), owned((count, d)), owned(count)
    length, resolved = np.empty(len(point)), np.empty(len(point), dtype=np.int8)
    before, fluid, part = (v.astype(np.int32, copy=False) for v in (layers.fluid, faces.fluid, faces.part))
    launch(
        advance_layers,
        LayerPoints(distance, face, before, layers.history),
        LayerFaceArrays(np.ascontiguousarray(fluid), faces.velocity, faces.viscosity, faces.spacing, part, point),
        dt,
        REACH,
        FLOWS,
        RESOLVED,
        AdvancedLayers(here, history, flux, length, resolved),
        d,
    )
    return replace(layers, fluid=here, history=history), length, resolved.astype(bool)

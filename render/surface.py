"""Surfaces of fluids in three dimensions: the faces of their cells, smoothed, with the drops beside them."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array

from .arrays import Array
from .faces import SIDES, negative, outer_faces
from .outlines import GROW, SHRINK, SPRAY_RADIUS
from .volume import Volume

ROUNDS = 6  # of Taubin's filter
_ON = 1e-6  # distance from a wall on which a point stays [spacings]


class Surface(NamedTuple):
    """A closed surface of triangles."""

    points: Array  # (P, 3) [m]
    faces: Array  # (F, 3) anticlockwise from outside
    normals: Array  # (P, 3) outwards; of faces along walls see ``flat``
    flat: Array  # (F,) mask of the faces along walls, which are plane


def fluid_surface(volume: Volume, fluid: int) -> Surface:
    """The smoothed surface of a fluid, with its drops as balls.

    Taubin's filter moves points off the walls, and those on one wall within it.
    """
    position, cells, points, wall = volume.position, volume.cells, volume.position, volume.wall
    if len(volume.fluid_names) == 1:
        faces = outer_faces(cells, position)
    elif volume.cell_fluid is not None:
        faces = outer_faces(cells[volume.cell_fluid == fluid], position)
    else:
        points, faces, wall = _shared(position, cells, volume.fluid == fluid, volume.wall)
    used = np.zeros(len(points), bool)
    used[faces] = True
    points, faces, wall = points[used], (np.cumsum(used) - 1)[faces], wall[used]
    held = _held(points, wall, position[volume.wall], volume.spacing)
    flat = np.any(held[faces].all(axis=1), axis=1)
    points = _smoothed(points, faces[~flat], held)
    normals = _normals(points, faces[~flat])
    balls = _balls(position[volume.loose & (volume.fluid == fluid)], SPRAY_RADIUS * volume.spacing)
    return Surface(
        np.concatenate([points, balls.points]),
        np.concatenate([faces, balls.faces + len(points)]),
        np.concatenate([normals, balls.normals]),
        np.concatenate([flat, balls.flat]),
    )


def enclosed(surface: Surface) -> float:
    """Volume within a closed surface [m^3]."""
    corners = surface.points[surface.faces] - surface.points.mean(axis=0)
    return float(np.linalg.det(corners).sum() / 6)


def _shared(position: Array, cells: Array, own: Array, wall: Array) -> tuple[Array, Array, Array]:
    """Surface of the cells' part nearer to particles of their ``own`` (N,), cut at the mid-points of edges.

    Points (P, 3), faces (F, 3), and the mask (P,) of the points on walls.
    """
    count, mine = len(position), own[cells]
    found = []  # corners of faces as pairs of particles, whose middle they are
    outer = outer_faces(cells, position)
    many = own[outer].sum(axis=1)
    found.append(np.stack([outer[many == 3]] * 2, axis=2))
    for share in (1, 2):
        face = outer[many == share]
        alone = (own[face] == (share == 1)).argmax(axis=1)
        a, b, c = np.take_along_axis(face, (alone[:, None] + np.arange(3)) % 3, axis=1).T
        if share == 1:
            found.append(_corners((a, a), (a, b), (a, c)))
        else:
            found += [_corners((a, b), (b, b), (c, c)), _corners((a, b), (c, c), (a, c))]
    mixed = np.any(mine != mine[:, :1], axis=1)
    cells = cells[mixed]
    cells = np.where(negative(position, cells)[:, None], cells[:, [0, 1, 3, 2]], cells)
    number = own[cells].sum(axis=1)
    for share in (1, 3):  # one corner is alone
        cell = cells[number == share]
        alone = (own[cell] == (share == 1)).argmax(axis=1)
        a = np.take_along_axis(cell, alone[:, None], axis=1)[:, 0]
        b, c, d = np.take_along_axis(cell, SIDES[alone], axis=1).T
        found.append(_corners((a, b), (a, c), (a, d)) if share == 1 else _corners((a, b), (a, d), (a, c)))
    cell = cells[number == 2]
    order = np.argsort(~own[cell], axis=1, kind="stable")
    a, b, c, d = np.take_along_axis(cell, order, axis=1).T
    # An odd order of the corners turns the faces round.
    odd = np.linalg.det(np.eye(4)[order]) < 0 if len(order) else np.zeros(0, bool)
    c, d = np.where(odd, d, c), np.where(odd, c, d)
    found += [_corners((a, c), (a, d), (b, d)), _corners((a, c), (b, d), (b, c))]
    pairs = np.sort(np.concatenate(found).reshape(-1, 2), axis=1).astype(np.int64)
    keys, faces = np.unique(pairs[:, 0] * count + pairs[:, 1], return_inverse=True)
    one, other = keys // count, keys % count
    return (position[one] + position[other]) / 2, faces.reshape(-1, 3), wall[one] & wall[other]


def _corners(*pairs: tuple[Array, Array]) -> Array:
    """Faces (F, 3, 2) of corners that are pairs of particles (F,)."""
    return np.stack([np.stack(pair, axis=1) for pair in pairs], axis=1)


def _held(points: Array, wall: Array, walls: Array, spacing: float) -> Array:
    """Mask (P, 6) of the sides of the walls' box that points on walls are on; all six where the walls are no box."""
    held = np.zeros((len(points), 6), bool)
    if not len(walls):
        return held
    sides = np.concatenate([walls.min(axis=0), walls.max(axis=0)])

    def near(places: Array) -> Array:
        return np.asarray(np.abs(np.concatenate([places, places], axis=1) - sides) < _ON * spacing)

    box = near(walls).any(axis=1).all()
    held[wall] = near(points[wall]) if box else True
    return held


def _smoothed(points: Array, faces: Array, held: Array) -> Array:
    """Points (P, 3) after Taubin's filter over the faces; those held move along their walls alone."""
    count = len(points)
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    sides = np.concatenate([sides, sides[:, ::-1]])
    near = coo_array((np.ones(len(sides)), tuple(sides.T)), (count, count)).tocsr()
    near.data[:] = 1.0
    number = np.asarray(near.sum(axis=1)).reshape(-1, 1)
    free = ~(held[:, :3] | held[:, 3:]) & (number > 0)
    # A point on a wall has the neighbours of one side: along the waterline they are at rest on average.
    points = points.copy()
    for _ in range(ROUNDS):
        for share in (SHRINK, GROW):
            points += np.where(free, share * (near @ points / np.maximum(number, 1) - points), 0.0)
    return points


def _normals(points: Array, faces: Array) -> Array:
    """Unit normals (P, 3) outwards, means of the faces by their areas."""
    a, b, c = np.moveaxis(points[faces], 1, 0)
    own, total = np.cross(b - a, c - a), np.zeros_like(points)
    for corner in faces.T:
        for axis in range(3):
            total[:, axis] += np.bincount(corner, own[:, axis], len(points))
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300))


def _balls(centres: Array, radius: float) -> Surface:
    """Balls of twenty faces each."""
    golden = (1 + 5**0.5) / 2
    corners = np.array([[0, s, t * golden] for s in (-1, 1) for t in (-1, 1)], float)
    corners = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    apart = np.linalg.norm(corners[:, None] - corners, axis=2)
    near = (apart > 0) & (apart < 1.2)
    faces = np.array(
        [(a, b, c) for a in range(12) for b in range(a) for c in range(b) if near[[a, b, c], [b, c, a]].all()]
    )
    turned = np.linalg.det(corners[faces]) < 0
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    points = (centres[:, None] + radius * corners).reshape(-1, 3)
    every = (faces + 12 * np.arange(len(centres))[:, None, None]).reshape(-1, 3)
    return Surface(points, every, np.tile(corners, (len(centres), 1)), np.zeros(len(every), bool))

"""tipfem/geometry/lattice.py: particles that stand on the faces of a tank's parts."""

import numpy as np
import pytest

import tipfem as tp
from tipfem.geometry.lattice import heaviest_beside, snap_to_faces

SIZE, LINES = np.array([1.0, 1.0]), 21
WATER, AIR = tp.Fluid("water", 998.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)


def lattice() -> np.ndarray:
    """Points of a unit square, 21 along each axis."""
    line = np.linspace(0, 1, LINES)
    return np.stack([a.ravel() for a in np.meshgrid(line, line, indexing="ij")], axis=1)


def at_walls(x):
    """Coordinates of points of the unit square that are those of its walls."""
    return (x == 0) | (x == 1)


def half_plane(normal, offset):
    """1 on the side that the normal points to, and the signed distance from the face."""
    normal = np.array(normal) / np.linalg.norm(normal)
    return lambda x: ((x @ normal - offset) > 0).astype(int), lambda x: x @ normal - offset


def disc(centre, radius):
    """1 inside, and the signed distance."""
    distance = lambda x: radius - np.linalg.norm(x - centre, axis=1)  # noqa: E731
    return lambda x: (distance(x) > 0).astype(int), distance


FACES = {
    "flat, between lines": half_plane((0, 1), 0.512),
    "flat, on a line": half_plane((0, 1), 0.5),
    "upright": half_plane((1, 0), 0.3333),
    "diagonal": half_plane((1, 1), 0.7071),
    "slanted": half_plane((0.3, 1), 0.61),
    "steep": half_plane((1, -0.2), 0.31),
    "disc": disc((0.5, 0.45), 0.27),
    "half a disc": disc((1.0, 0.5), 0.3),
    "a quarter": disc((0.0, 0.0), 0.43),
}


def edges() -> np.ndarray:
    """The lattice's edges (K, 2), diagonals included."""
    index = np.arange(LINES * LINES).reshape(LINES, LINES)
    pairs = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:])]
    pairs += [(index[:-1, :-1], index[1:, 1:]), (index[:-1, 1:], index[1:, :-1])]
    return np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])


@pytest.mark.parametrize("face", FACES)
def test_no_edge_crosses_a_face_but_at_its_ends(face):
    part, distance = FACES[face]
    before = lattice()
    after, on_face = snap_to_faces(before, (LINES, LINES), SIZE, at_walls(before), part)
    assert on_face.sum() >= LINES // 3
    np.testing.assert_allclose(distance(after[on_face]), 0.0, atol=1e-12)
    np.testing.assert_array_equal(after[~on_face], before[~on_face])
    # Half an edge, a diagonal at most.
    assert np.linalg.norm(after - before, axis=1).max() <= 0.5 * np.sqrt(2) / (LINES - 1) + 1e-12
    # Walls: corners stay, the others stay on their wall, to the last bit.
    np.testing.assert_array_equal((before == 0) & (after != 0), False)
    np.testing.assert_array_equal((before == 1) & (after != 1), False)
    side = np.where(on_face, 0.0, np.sign(distance(after)))
    one, other = edges().T
    crossing = side[one] * side[other] < 0
    wall = ((before == 0) | (before == 1)).any(axis=1)
    assert (wall[one] | wall[other])[crossing].all()
    assert crossing.sum() <= 4  # where the face meets a wall


def test_what_stands_on_a_face_already_stays_there():
    part, distance = FACES["flat, on a line"]
    after, on_face = snap_to_faces(lattice(), (LINES, LINES), SIZE, at_walls(lattice()), part)
    np.testing.assert_array_equal(after, lattice())
    np.testing.assert_array_equal(on_face, np.abs(distance(after)) < 1e-12)


def test_three_parts_meet_and_none_is_crossed():
    def part(x):
        return np.where(x[:, 1] < 0.43, np.where(x[:, 0] < 0.62, 0, 1), 2)

    after, on_face = snap_to_faces(lattice(), (LINES, LINES), SIZE, at_walls(lattice()), part)
    x, y = after[on_face].T
    off = np.minimum(np.abs(y - 0.43), np.where(y < 0.43 + 1e-12, np.abs(x - 0.62), 1.0))
    np.testing.assert_allclose(off, 0.0, atol=1e-12)


def test_without_faces_nothing_moves():
    after, on_face = snap_to_faces(
        lattice(), (LINES, LINES), SIZE, at_walls(lattice()), lambda x: np.zeros(len(x), dtype=int)
    )
    np.testing.assert_array_equal(after, lattice())
    assert not on_face.any()


def test_the_heaviest_beside_a_face_is_found_on_either_side_and_at_walls():
    density = np.array([1.0, 5.0, 3.0])

    def fluid(x):  # 2 | 0 above, 1 below in the middle of the right half
        return np.where(x[:, 0] < 0.5, 2, np.where(x[:, 1] < 0.5, 1, 0))

    points = np.array([[0.5, 0.7], [0.5, 0.2], [0.8, 0.5], [0.5, 0.5], [0.2, 0.9], [0.8, 0.9], [1.0, 0.5], [0.5, 1.0]])
    found = heaviest_beside(points, np.stack([0 * SIZE, SIZE]), 0.05, fluid, density)
    assert found.tolist() == [2, 1, 1, 1, 2, 0, 1, 2]


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("heavy_inside", [True, False])
def test_a_fitted_tank_has_its_particles_on_the_face_where_jitter_leaves_them(jitter, heavy_inside):
    inner, outer = (WATER, AIR) if heavy_inside else (AIR, WATER)
    centre, radius = np.array([0.5, 0.45]), 0.27
    fluids = [WATER, AIR]
    p = tp.tank((1, 1), 0.05, jitter=jitter).fill(outer).fill(inner, disc=(centre, radius)).sample(fluids, fitted=True)
    off = np.linalg.norm(p.position - centre, axis=1) - radius
    on = np.abs(off) < 1e-12
    assert on.sum() > 2 * np.pi * radius / 0.05 * 0.7
    assert (p.fluid[on] == 0).all()
    np.testing.assert_array_equal(p.fluid[~on & ~p.wall] == fluids.index(inner), off[~on & ~p.wall] < 0)
    on_lattice = (np.abs(p.position / 0.05 - np.round(p.position / 0.05)) < 1e-9).all(axis=1)
    assert on_lattice[p.wall].all()
    assert on_lattice[~on & ~p.wall].any() == (jitter == 0)


def test_faces_of_boxes_are_lines_of_particles():
    tank = tp.tank((1, 1), 0.07, jitter=0.2).fill(AIR).fill(WATER, box=((0, 0), (0.37, 0.53)))
    p = tank.sample([WATER, AIR], fitted=True)
    top = (np.abs(p.position[:, 1] - 0.53) < 1e-12) & (p.position[:, 0] <= 0.37 + 1e-12)
    side = (np.abs(p.position[:, 0] - 0.37) < 1e-12) & (p.position[:, 1] <= 0.53 + 1e-12)
    assert top.sum() == round(0.37 / 0.07) + 1
    assert side.sum() == round(0.53 / 0.07) + 1
    assert (top & side).sum() == 1
    assert (p.fluid[top | side] == 0).all()


def test_two_diagonals_that_meet_a_face_in_one_place_move_one_point():
    """The lowest point of a disc in the middle of a lattice square: no two points stand there."""
    grid = np.linspace(0, 1, 26)
    lattice = np.stack([x.ravel() for x in np.meshgrid(grid, grid, indexing="ij")], axis=1)
    inside = lambda x: ((x - [0.5, 0.7]) ** 2).sum(axis=1) < 0.12**2  # noqa: E731
    position, on_face = snap_to_faces(lattice, (26, 26), np.ones(2), (lattice == 0) | (lattice == 1), inside)
    assert on_face.sum() > 10
    assert len(np.unique(position.round(9), axis=0)) == 26 * 26

"""Outer faces of tetrahedra."""

import numpy as np
from render_volumes import volume
from tipfem.render.faces import outer_faces


def test_outer_faces_are_those_of_one_cell_and_look_outwards():
    tank = volume(level=0.5)
    random = np.random.default_rng(3)
    cells = random.permuted(random.permutation(tank.cells)[: len(tank.cells) * 2 // 3], axis=1)  # with holes
    found = outer_faces(cells, tank.position)
    sides = [(tuple(np.delete(cell, k)), cell[k]) for cell in cells.tolist() for k in range(4)]
    alone = {}
    for corners, opposite in sides:
        alone.setdefault(tuple(sorted(corners)), []).append(opposite)
    alone = {corners: own[0] for corners, own in alone.items() if len(own) == 1}
    assert sorted(map(tuple, np.sort(found, axis=1).tolist())) == sorted(alone)
    a, b, c = np.moveaxis(tank.position[found], 1, 0)
    within = tank.position[[alone[tuple(sorted(face))] for face in found.tolist()]]
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), within - a) < 0).all()


def test_no_cells_have_no_faces():
    assert outer_faces(np.zeros((0, 4), int), np.zeros((5, 3))).shape == (0, 3)

"""Damaged mesh files, 500 of them: each is refused in one sentence, or is a mesh that covers what its walls enclose."""

import random

import pytest
from mutations import mutated

import tipfem as tp

MUTATIONS, GROUPS = 500, 10
NODES = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (2, 2)]
LINES = [(1, 2), (2, 3), (3, 6), (6, 9), (9, 8), (8, 7), (7, 4), (4, 1)]
TRIANGLES = [(1, 2, 5), (1, 5, 4), (2, 3, 5), (3, 6, 5), (4, 5, 7), (5, 8, 7), (5, 6, 9), (5, 9, 8)]


def square():
    """Water below air in a square, as Gmsh writes it (version 2.2)."""
    cells = [f"1 2 {1 if k < 2 else 2} {k} {a} {b}" for k, (a, b) in enumerate(LINES)]
    cells += [f"2 2 {3 if k < 4 else 4} {k} {a} {b} {c}" for k, (a, b, c) in enumerate(TRIANGLES)]
    return "\n".join(
        [
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat",
            '$PhysicalNames\n4\n1 1 "floor"\n1 2 "rest"\n2 3 "water"\n2 4 "air"\n$EndPhysicalNames',
            f"$Nodes\n{len(NODES)}",
            *(f"{k + 1} {0.5 * x} {0.5 * y} 0" for k, (x, y) in enumerate(NODES)),
            f"$EndNodes\n$Elements\n{len(cells)}",
            *(f"{k + 1} {line}" for k, line in enumerate(cells)),
            "$EndElements\n",
        ]
    )


@pytest.mark.parametrize("group", range(GROUPS))
def test_a_damaged_mesh_is_refused_or_covers_what_its_walls_enclose(group, tmp_path, water, air):
    path = tmp_path / "tank.msh"
    path.write_text(square())
    assert set(tp.read_mesh(path, 0.5).sides) == {"floor", "rest"}
    accepted = 0
    for number in range(group, MUTATIONS, GROUPS):
        rng = random.Random(number)
        path.write_text(mutated(rng, square()), encoding="utf-8")
        try:
            tank = tp.read_mesh(path, 0.5)  # any other error fails the test
            case = tp.Case(tank, [water, air], (0, -9.81))
            mesh = tp.Simulation(case).mesh
        except ValueError as error:
            said = str(error)
        else:
            said, accepted = "", accepted + 1
        assert "object at 0x" not in said
        assert len(said) < 600
        if said:
            continue
        assert mesh.measure.min() > 0, path.read_text()
        assert mesh.measure.sum() == pytest.approx(case.domain.area, rel=1e-9), path.read_text()
    assert accepted > 0  # what a reader skips, and names

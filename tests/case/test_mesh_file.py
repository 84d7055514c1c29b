"""tipfem.read_mesh: tanks from files that Gmsh wrote, and what is missing in them."""

from __future__ import annotations

import multiprocessing

import meshio
import numpy as np
import pytest

import tipfem as tp


def write_by_gmsh(path: str, version: float, names: dict[str, str], binary: bool) -> None:
    """A box of 1 x 1, water to half its height and air above, with a round hole in the water."""
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.1)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", int(binary))
        occ = gmsh.model.occ
        lower, upper = occ.addRectangle(0, 0, 0, 1, 0.5), occ.addRectangle(0, 0.5, 0, 1, 0.5)
        occ.cut([(2, lower)], [(2, occ.addDisk(0.5, 0.22, 0, 0.12, 0.12))])
        occ.fragment([(2, lower)], [(2, upper)])
        occ.synchronize()
        sides: dict[str, list[int]] = {"hole": [], "floor": [], "rest": []}
        for _, tag in gmsh.model.getBoundary(gmsh.model.getEntities(2), combined=True, oriented=False):
            x, y, _ = occ.getCenterOfMass(1, tag)
            sides["hole" if 0.3 < x < 0.7 and 0.1 < y < 0.4 else "floor" if y < 1e-9 else "rest"].append(tag)
        for _, tag in gmsh.model.getEntities(2):
            name = names["water" if occ.getCenterOfMass(2, tag)[1] < 0.5 else "air"]
            if name:
                gmsh.model.addPhysicalGroup(2, [tag], name=name)
        for side, tags in sides.items():
            if names.get(side, side):
                gmsh.model.addPhysicalGroup(1, tags, name=names.get(side, side))
        gmsh.model.mesh.generate(2)
        gmsh.write(path)
    finally:
        gmsh.finalize()


def written(path, version=4.1, binary=False, **names):
    """In a process of its own, because Gmsh handles signals itself."""
    pytest.importorskip("gmsh")
    given = {"water": "water", "air": "air", **names}
    process = multiprocessing.get_context("spawn").Process(
        target=write_by_gmsh, args=(str(path), version, given, binary)
    )
    process.start()
    process.join()
    assert process.exitcode == 0
    return path


@pytest.mark.parametrize(("version", "binary"), [(4.1, False), (2.2, False), (4.1, True)])
def test_a_file_of_gmsh_is_a_tank_with_its_fluids_and_walls(tmp_path, water, air, version, binary):
    tank = tp.read_mesh(written(tmp_path / "tank.msh", version, binary)).wall("hole", slip=True)
    case = tp.Case(tank, [water, air], (0, -9.81))
    assert set(tank.sides) == {"rest", "floor", "hole"}
    hole = np.linalg.norm(case.particles.position - (0.5, 0.22), axis=1) < 0.12 + 1e-9
    assert case.particles.wall[hole].all()
    assert hole.sum() > 5
    simulation = tp.Simulation(case)
    raw = meshio.read(tmp_path / "tank.msh")
    assert len(simulation.mesh.cells) == sum(len(block.data) for block in raw.cells if block.type == "triangle")
    assert simulation.volume("air") == pytest.approx(0.5, rel=1e-12)
    for _ in range(3):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9  # at rest, with an interface along the file's own edges
    assert simulation.mesh.measure.sum() == pytest.approx(case.domain.area, rel=1e-12)


def test_a_case_file_says_that_it_cannot_keep_a_mesh(tmp_path, water):
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 0]], dtype=float)
    lines = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    cells = [("triangle", np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])), ("line", lines)]
    meshio.Mesh(x, cells, cell_data={"medit:ref": [np.full(4, 7), np.full(4, 1)]}).write(tmp_path / "tank.mesh")
    tank = tp.read_mesh(tmp_path / "tank.mesh", 0.5, fluids={7: "water"}, walls={1: "rim"})
    described = tp.describe(tp.Case(tank, [water], (0, -9.81)), 1.0)
    assert described.missing == ("tank: read from a mesh file",)


def test_groups_that_are_missing_are_named(tmp_path, water, air):
    path = written(tmp_path / "tank.msh", air="gas")
    with pytest.raises(ValueError, match="surface 'gas' is not named after a fluid; the case has water, air"):
        tp.Case(tp.read_mesh(path), [water, air], (0, -9.81))
    with pytest.raises(ValueError, match="no surface is in a physical group 'oil'"):
        tp.Case(tp.read_mesh(path), [water, tp.Fluid("gas", 1.0, 1e-5), tp.Fluid("oil", 900.0, 0.1)], (0, -9.81))
    with pytest.raises(ValueError, match="'lid' is no wall of this tank; it has"):
        tp.read_mesh(path).wall("lid", slip=True)


def test_boundaries_and_surfaces_without_a_group_are_refused(tmp_path):
    with pytest.raises(ValueError, match="no curve of a named physical group; all of the boundary must be walls"):
        tp.read_mesh(written(tmp_path / "open.msh", floor=""))


def test_formats_without_names_take_numbers(tmp_path, water):
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 0]], dtype=float)
    cells = [
        ("triangle", np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])),
        ("line", np.array([[0, 1], [1, 2], [2, 3], [3, 0]])),
    ]
    mesh = meshio.Mesh(x, cells, cell_data={"medit:ref": [np.full(4, 7), np.array([1, 1, 2, 2])]})
    mesh.write(tmp_path / "tank.mesh")
    with pytest.raises(ValueError, match="a surface is in no named physical group \\(its number is 7\\)"):
        tp.read_mesh(tmp_path / "tank.mesh")
    tank = tp.read_mesh(tmp_path / "tank.mesh", 0.5, fluids={7: "water"}, walls={1: "a", 2: "b"})
    assert set(tank.sides) == {"a", "b"}
    assert tank.sample([water]).wall.tolist() == [True] * 4 + [False]


def square(tmp_path, *more):
    """A unit square of four triangles, with walls all around, and further blocks of cells: kind, cells, group."""
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 0]], dtype=float)
    triangles, lines = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], [[0, 1], [1, 2], [2, 3], [3, 0]]
    blocks = [("triangle", triangles, 7), ("line", lines, 1), *more]
    cells = [(kind, np.array(cells)) for kind, cells, _ in blocks]
    tags = [np.full(len(cells), tag) for _, cells, tag in blocks]
    meshio.Mesh(x, cells, cell_data={"medit:ref": tags}).write(tmp_path / "tank.mesh")
    return tmp_path / "tank.mesh"


def test_quadrilaterals_and_curves_inside_the_fluids_are_refused(tmp_path):
    names = {"fluids": {7: "water"}, "walls": {1: "rim", 2: "baffle"}}
    with pytest.raises(ValueError, match="cells beside triangles with three corners, 1 of type 'quad'"):
        tp.read_mesh(square(tmp_path, ("quad", [[0, 1, 2, 3]], 7)), 0.5, **names)
    with pytest.raises(ValueError, match=r"the curve 'baffle' is inside the fluids, at \[0.25, 0.25\]"):
        tp.read_mesh(square(tmp_path, ("line", [[0, 4]], 2)), 0.5, **names)
    assert tp.read_mesh(square(tmp_path), 0.5, **names).sides == ("rim",)


def test_files_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(ValueError, match="there is no such file"):
        tp.read_mesh(tmp_path / "nothing.msh")
    (tmp_path / "bad.msh").write_text("nonsense")
    with pytest.raises(ValueError, match="meshio cannot read it"):
        tp.read_mesh(tmp_path / "bad.msh")
    with pytest.raises(ValueError, match="spacing is -1 m"):
        tp.read_mesh(tmp_path / "bad.msh", -1)

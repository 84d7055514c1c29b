"""tipfem.read_mesh: tanks from files that Gmsh wrote, and what is missing in them."""

from __future__ import annotations

import multiprocessing

import meshio
import numpy as np
import pytest

import tipfem as tp
from tipfem.app.commands import main
from tipfem.casefile.hints import hints


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_groups_that_are_missing_are_named(tmp_path, water, air):
    path = written(tmp_path / "tank.msh", air="gas")
    with pytest.raises(ValueError, match="surface 'gas' is not named after a fluid; the case has water, air"):
        tp.Case(tp.read_mesh(path), [water, air], (0, -9.81))
    with pytest.raises(ValueError, match="no surface is in a physical group 'oil'"):
        tp.Case(tp.read_mesh(path), [water, tp.Fluid("gas", 1.0, 1e-5), tp.Fluid("oil", 900.0, 0.1)], (0, -9.81))
    with pytest.raises(ValueError, match="'lid' is no wall of this tank; it has"):
        tp.read_mesh(path).wall("lid", slip=True)


@pytest.mark.slow
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


GMSH = """$MeshFormat
{version} 0 8
$EndMeshFormat
$PhysicalNames
{count}
1 1 "floor"
1 2 "rest"
2 3 "water"
{names}$EndPhysicalNames
$Nodes
5
1 0 0 0
2 {size} 0 0
3 {size} {size} 0
4 0 {size} 0
5 {half} {half} 0
{nodes}$EndNodes
$Elements
{elements}
{lines}
$EndElements
"""
SQUARE = ["1 2 1 1 1 2", "1 2 2 2 2 3", "1 2 2 3 3 4", "1 2 2 4 4 1"]
SQUARE += ["2 2 3 1 1 2 5", "2 2 3 1 2 3 5", "2 2 3 1 3 4 5", "2 2 3 1 4 1 5"]


def gmsh_file(path, *more, names=(), nodes=(), size=1.0, version="2.2", left_out=()):
    """A square as Gmsh writes it, of four triangles, with further elements, groups and nodes."""
    lines = [line for k, line in enumerate(SQUARE) if k not in left_out] + list(more)
    text = GMSH.format(
        version=version,
        count=3 + len(names),
        names="".join(f"{name}\n" for name in names),
        nodes="".join(f"{node}\n" for node in nodes),
        size=size,
        half=size / 2,
        elements=len(lines),
        lines="\n".join(f"{k + 1} {line}" for k, line in enumerate(lines)),
    )
    path.write_text(text.replace("$Nodes\n5", f"$Nodes\n{5 + len(nodes)}"))
    return path


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"version": "4"}, "it has Gmsh's format 4.0, which is not read; save it as 4.1 or 2.2"),
        ({"version": "4.0"}, "it has Gmsh's format 4.0, which is not read"),
        ({"version": "3"}, "it has Gmsh's format 3.0, which is not read"),
        (
            {"more": ["1 2 1 5 2 6"], "nodes": ["6 2 0 0"]},
            r"curve 'floor' goes on beyond the triangles \(from \[1, 0\] m\)",
        ),
        (
            {"more": ["1 2 1 5 6 7"], "nodes": ["6 2 0 0", "7 3 0 0"]},
            r"curve 'floor' goes on beyond the triangles \(at \[2.5, 0\] m\)",
        ),
        ({"more": ["1 2 2 1 2 1"]}, r"the edge at \[0.5, 0\] m is on two curves, 'floor' and 'rest'"),
        ({"more": ["1 2 2 1 1 5"]}, r"the curve 'rest' is inside the fluids, at \[0.25, 0.25\]"),
        ({"more": ["2 2 4 1 1 2 5"], "names": ['2 4 "air"']}, "triangles are in the physical groups water and air"),
        ({"left_out": [1]}, r"the edge of the boundary at \[1.0, 0.5\] is on no curve"),
    ],
)
def test_faults_are_told_by_their_places_in_the_file(content, message, tmp_path, water, air):
    content = dict(content)
    path = gmsh_file(tmp_path / "tank.msh", *content.pop("more", ()), **content)
    with pytest.raises(ValueError, match=message):
        tp.Case(tp.read_mesh(path, 0.5), [water, air], (0, -9.81))


def test_the_first_format_of_gmsh_is_named(tmp_path):
    (tmp_path / "old.msh").write_text("$NOD\n1\n1 0 0 0\n$ENDNOD\n")
    with pytest.raises(ValueError, match=r"it has Gmsh's format 1\.0, which is not read"):
        tp.read_mesh(tmp_path / "old.msh")


def test_triangles_may_be_in_further_groups(tmp_path, water):
    again = [line.replace("2 2 3 1", "2 2 4 1") for line in SQUARE[4:]]
    path = gmsh_file(tmp_path / "tank.msh", *again, names=['2 4 "all"'])
    case = tp.Case(tp.read_mesh(path, 0.5), [water], (0, -9.81))
    assert len(tp.Simulation(case).mesh.cells) == 4
    assert tp.Simulation(case).volume("water") == pytest.approx(1.0, rel=1e-12)


def test_a_scale_makes_metres_of_other_units(tmp_path, water):
    path = gmsh_file(tmp_path / "tank.msh", size=1000)
    tank = tp.read_mesh(path, 0.5, scale=1e-3)
    assert tank.size == pytest.approx([1, 1])
    assert tp.Simulation(tp.Case(tank, [water], (0, -9.81))).volume("water") == pytest.approx(1.0, rel=1e-12)
    for scale in (0, -1, "mm", float("nan")):
        with pytest.raises(ValueError, match=r"scale is .*; it must be a number > 0"):
            tp.read_mesh(path, scale=scale)
    (note,) = [
        line for line in hints(tp.Case(tp.read_mesh(path, 500.0), [water], (0, -9.81)), 1.0, None) if "mm" in line
    ]
    assert note == "the tank is 1000 m wide or high; are its lengths in m? A mesh in mm takes scale = 1e-3"


@pytest.mark.parametrize(("width", "spacing"), [(0.2, 0.1), (0.7, 0.35), (1 / 3, 1 / 6)])
def test_a_spacing_of_half_an_edge_is_taken(width, spacing, water):
    tp.Case(tp.tank((width, 1.0), spacing * (1 + 1e-13)).fill(water), [water], (0, -9.81))
    with pytest.raises(ValueError, match="too large for a tank"):
        tp.tank((width, 1.0), spacing * 1.001)


CASE = """gravity = [0, -9.81]
fluids.water = { density = 1000, viscosity = 1e-3 }
tank = { mesh = "meshes/square.msh", scale = 1e-3, spacing = 0.5 }
walls.floor.slip = true
time.end = 0.01
"""


def test_a_case_file_has_a_mesh_that_its_results_keep(tmp_path):
    (tmp_path / "meshes").mkdir()
    gmsh_file(tmp_path / "meshes" / "square.msh", size=1000)
    (tmp_path / "case.toml").write_text(CASE)
    file = tp.load_case(tmp_path / "case.toml")
    case = file.case()
    assert [wall.name for wall in case.walls if wall.slip] == ["floor"]
    assert case.particles.position.max() == pytest.approx(1.0)
    assert main(["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "out"), "--no-progress"]) == 0
    (tmp_path / "meshes" / "square.msh").unlink()
    kept = tp.load_case(tmp_path / "out" / "case.toml")
    assert kept.table.tank.mesh == "case.msh"
    np.testing.assert_array_equal(kept.case().particles.position, case.particles.position)
    assert main(["resume", str(tmp_path / "out"), "--until", "0.02", "--no-progress"]) == 0
    assert "case.msh" in (tmp_path / "out" / ".tipfem").read_text()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("square.msh", "other.msh", "case.toml:3: tank.mesh: read_mesh .*there is no such file"),
        ("scale = 1e-3", "scale = 0", "tank.scale is 0"),
        ("scale = 1e-3", "jitter = 0.1", "tank.jitter is given with a mesh"),
        ("scale = 1e-3", "size = [1, 1]", "tank has both size and mesh"),
        ('mesh = "meshes/square.msh", ', "size = [1, 1], ", "tank.scale is given without a mesh"),
        ("walls.floor", "walls.flor", "flor"),  # codespell:ignore
        ("time.end", 'fill = [{ fluid = "water" }]\ntime.end', "fill is given with a mesh"),
        ("fluids.water", "fluids.oil", "its surface 'water' is not named after a fluid; the case has oil"),
    ],
)
def test_mistakes_beside_a_mesh_are_told(old, new, message, tmp_path):
    (tmp_path / "meshes").mkdir()
    gmsh_file(tmp_path / "meshes" / "square.msh", size=1000)
    assert old in CASE
    (tmp_path / "case.toml").write_text(CASE.replace(old, new))
    with pytest.raises(tp.CaseFileError, match=message):
        tp.load_case(tmp_path / "case.toml").case()

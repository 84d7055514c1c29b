"""tipfem/case/tank.py and tipfem/geometry: tanks of any shape, their particles and first meshes."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tipfem as tp
from tipfem.geometry.plane.domain import domain_of
from tipfem.mesh.delaunay import triangulate

BLOCK = [(0, 0), (0.292, 0), (0.292, 0.048), (0.316, 0.048), (0.316, 0), (0.584, 0), (0.584, 0.584), (0, 0.584)]
BOWL = tp.shapes.polygon([(-1, 0), tp.shapes.arc((0, 0)), (1, 0), (1, 0.5), (-1, 0.5)], names=["bowl", "r", "t", "l"])
RING = tp.shapes.circle((0, 0), 1.0, name="outer", holes=[tp.shapes.circle((0, 0), 0.5, name="inner")])
RIM = [(np.cos(t), np.sin(t)) for t in 2 * np.pi * np.arange(2000) / 2000]
SHAPES = {
    "block": (BLOCK, 0.0125),
    "bowl": (BOWL, 0.08),
    "ring": (RING, 0.07),
    "acute": ([(0, 0), (1, 0), (1 + 0.5, math.sqrt(3) / 2)], 0.06),
    "inclined": ([(0, 0.3), (0.7, 0.05), (1, 0.1), (1, 0.8), (0, 0.8)], 0.05),
    "gap": ([(0, 0), (1, 0), (1, 0.3), (0.65, 0.3), (0.65, 1), (0.5, 1), (0.5, 0.3), (0, 0.3)], 0.05),
    "far": ([(1000, 50), (1001, 50), (1001, 51), (1000.5, 50.5), (1000, 51)], 0.05),
}


def sampled(name: str, water: tp.Fluid, **options):
    shape, h = SHAPES[name]
    tank = tp.tank(shape=shape, spacing=h).fill(water)
    particles = tank.sample([water], **options)
    mesh = triangulate(
        particles.position, particles.wall, h, tank.domain.edges_of(particles.position, particles.wall, h)
    )
    return tank, particles, mesh


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("fitted", [False, True])
def test_the_first_mesh_has_every_edge_of_the_boundary_and_fills_the_domain(name, fitted, water):
    tank, particles, mesh = sampled(name, water, fitted=fitted)
    h = tank.spacing
    assert mesh.measure.sum() == pytest.approx(tank.domain.area, rel=1e-12)
    assert mesh.used.all()
    cell, i = np.nonzero(mesh.neighbours < 0)
    found = {*zip(mesh.cells[cell, (i + 1) % 3].tolist(), mesh.cells[cell, (i + 2) % 3].tolist(), strict=True)}
    assert found == {*map(tuple, tank.domain.edges_of(particles.position, particles.wall, h).tolist())}
    # Good triangles: no angle below 15 degrees, and no edge much longer than the spacing.
    side = mesh.position[mesh.cells] - np.roll(mesh.position[mesh.cells], 1, axis=1)
    length = np.linalg.norm(side, axis=2)
    cosine = -(side * np.roll(side, -1, axis=1)).sum(axis=2) / length / np.roll(length, -1, axis=1)
    assert np.degrees(np.arccos(cosine)).min() > 15
    assert length.max() < 2.2 * h
    assert length.min() > 0.4 * h


@pytest.mark.parametrize("name", ["block", "bowl", "ring", "inclined", "far"])
def test_a_grading_thins_out_the_first_mesh_inside_and_along_straight_walls(name, water):
    shape, h = SHAPES[name]
    shape, h = tp.shapes.Shape.of(shape), 0.4 * h
    middle, width = shape.box.mean(axis=0), np.ptp(shape.box, axis=0).max()

    def where(x):
        return h + 0.15 * np.maximum(np.linalg.norm(x - middle, axis=1) - 0.15 * width, 0.0)

    tank = tp.tank(shape=shape, spacing=h).fill(water)
    every = tank.sample([water], fitted=True)
    particles = tank.sample([water], fitted=True, grading=tp.Grading(where=where))
    assert len(particles) < 0.7 * len(every)
    mesh = triangulate(
        particles.position, particles.wall, h, tank.domain.edges_of(particles.position, particles.wall, h)
    )
    assert mesh.measure.sum() == pytest.approx(tank.domain.area, rel=1e-12)
    assert mesh.used.all()
    side = mesh.position[mesh.cells] - np.roll(mesh.position[mesh.cells], 1, axis=1)
    length = np.linalg.norm(side, axis=2)
    cosine = -(side * np.roll(side, -1, axis=1)).sum(axis=2) / length / np.roll(length, -1, axis=1)
    assert np.degrees(np.arccos(cosine)).min() > 12
    assert (length.max(axis=1) < 2.2 * where(mesh.position[mesh.cells].mean(axis=1))).all()
    # Fewer on walls, but none of the corners on arcs is left out.
    assert particles.wall.sum() <= every.wall.sum()
    assert (particles.wall.sum() < 0.8 * every.wall.sum()) == (name != "ring")


def test_layers_at_rest_in_a_graded_tank_with_a_hole_stay_at_rest(water, air):
    hole = tp.shapes.circle((0.5, 0.27), 0.15, name="hole")
    tank = tp.tank(shape=tp.shapes.rectangle((0, 0), (1, 1), holes=[hole]), spacing=0.025)
    tank.fill(air).fill(water, box=((0, 0), (1, 0.5)))
    case = tp.Case(tank, [water, air], (0, -9.81), grading=tp.Grading({"water": 0.1, "air": 0.1}))
    assert len(case.particles) < 900  # 1600 without
    assert (case.particles.position[:, 1] == 0.5).sum() >= 28  # the interface is at the spacing
    simulation = tp.Simulation(case)
    for _ in range(5):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9


def test_a_circle_becomes_a_polygon_with_its_corners_on_it():
    domain = domain_of(RING, 0.05)
    radius = np.linalg.norm(domain.start, axis=1)
    np.testing.assert_allclose(radius[domain.loop == 0], 1.0, rtol=1e-14)
    np.testing.assert_allclose(radius[domain.loop == 1], 0.5, rtol=1e-14)
    assert domain.sides == ["outer", "inner"]
    assert domain.length.max() < 1.1 * 0.05
    assert RING.area == pytest.approx(0.75 * math.pi, rel=1e-12)
    assert domain.area == pytest.approx(RING.area, rel=2e-3)
    # The fluid is on the left: normals point away from the outer circle's rim, and out of the inner one.
    middle = 0.5 * (domain.start + domain.end)
    outwards = (domain.normal * middle).sum(axis=1)
    assert (outwards[domain.loop == 0] < 0).all()
    assert (outwards[domain.loop == 1] > 0).all()


def test_points_inside_a_shape_with_arcs():
    x = np.random.default_rng(1).uniform(-1.2, 1.2, (20000, 2))
    radius = np.linalg.norm(x, axis=1)
    np.testing.assert_array_equal(RING.contains(x), (radius < 1) & (radius > 0.5))
    bowl = (np.abs(x[:, 0]) < 1) & (x[:, 1] < 0.5) & ((x[:, 1] > 0) | (radius < 1))
    np.testing.assert_array_equal(BOWL.contains(x), bowl)
    np.testing.assert_allclose(BOWL.box, [[-1, -1], [1, 0.5]], atol=1e-15)
    assert BOWL.area == pytest.approx(1 + math.pi / 2, rel=1e-12)


def test_a_shape_may_be_given_clockwise_and_keeps_the_names_of_its_edges():
    names = ["bottom", "right", "top", "left"]
    corners = [(0, 0), (2, 0), (2, 1), (0, 1)]
    for given, own in ((corners, names), (corners[::-1], ["top", "right", "bottom", "left"])):
        shape = tp.shapes.polygon(given, names=own)
        assert shape.area == pytest.approx(2.0)
        where = {piece.name: 0.5 * (piece.start + piece.end) for piece in shape.pieces}
        np.testing.assert_allclose(where["bottom"], (1, 0))
        np.testing.assert_allclose(where["right"], (2, 0.5))
        np.testing.assert_allclose(where["left"], (0, 0.5))


def test_sides_are_numbered_through_the_holes():
    shape = tp.shapes.polygon([(0, 0), (4, 0), (4, 3)], holes=[[(2.5, 0.5), (3, 0.5), (3, 1)]])
    assert sorted(shape.sides) == ["side0", "side1", "side2", "side3", "side4", "side5"]
    where = {piece.name: 0.5 * (piece.start + piece.end) for piece in shape.pieces}
    np.testing.assert_allclose(where["side3"], (2.75, 0.5))
    np.testing.assert_allclose(where["side4"], (3, 0.75))


def test_a_polygon_of_shapely_is_taken_with_its_holes():
    shapely = pytest.importorskip("shapely")
    given = shapely.box(0, 0, 2, 1).difference(shapely.box(0.5, 0.3, 0.8, 0.6))
    shape = tp.shapes.Shape.of(given)
    assert len(shape.loops) == 2
    assert shape.area == pytest.approx(2 - 0.09)
    parts = shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(2, 0, 3, 1)])
    with pytest.raises(ValueError, match="2 parts; it must be one polygon"):
        tp.tank(shape=parts, spacing=0.1)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ([(0, 0), (1, 0)], "2 corners; it needs 3 or more"),
        ([(0, 0), (1, 0), (1, 0), (1, 1)], r"the corner \[1.0, 0.0\] occurs twice"),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "crosses or touches"),
        ([(0, 0), (1, 0), (math.cos(0.4), math.sin(0.4))], "an angle of 22.9 degrees"),
        ([(0, 0), (1, 0), (1, 0.3), (0.6, 0.3), (0.6, 1), (0.5, 1), (0.5, 0.3), (0, 0.3)], r"0.1 m wide, 2 spacings"),
        ([(0, 0), (1, 0), float("nan")], "corner 2 is nan"),
        (RIM, r"most of its 2000 corners are closer to the next than 0.2 spacings.*join them by arcs"),
        (
            tp.shapes.circle((0, 0), 1.0, holes=[tp.shapes.circle((0.4, 0), 0.5, name="inner")]),
            r"at \[.*\] is 0.1 m wide, 2 spacings",
        ),
    ],
)
def test_bad_shapes_are_refused_with_their_place(shape, message):
    with pytest.raises(ValueError, match=message):
        tp.tank(shape=shape, spacing=0.05)


def test_holes_and_arcs_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"the hole at \[3.0, 0.0\] is not inside"):
        tp.shapes.polygon([(0, 0), (1, 0), (1, 1)], holes=[[(3, 0), (4, 0), (4, 1)]])
    with pytest.raises(ValueError, match=r"the hole at \[1.5, 1.5\] is inside another hole"):
        tp.shapes.rectangle((0, 0), (4, 4), holes=[[(1, 1), (3, 1), (3, 3), (1, 3)], [(1.5, 1.5), (2, 1.5), (2, 2)]])
    with pytest.raises(ValueError, match=r"1e\+14 m from the origin .* too few digits"):
        tp.shapes.rectangle((1e14, 0), (1e14 + 1, 1))
    with pytest.raises(ValueError, match="crosses or touches"):
        tp.shapes.circle((0, 0), 1.0, holes=[[(0.5, 0), (4, 0), (4, 1)]])
    with pytest.raises(ValueError, match="1 m from the one and 2 m from the other"):
        tp.shapes.polygon([(-1, 0), tp.shapes.arc((0, 0)), (2, 0), (2, 1)])
    with pytest.raises(ValueError, match="an arc must stand between two corners"):
        tp.shapes.polygon([tp.shapes.arc((0, 0)), (2, 0), (2, 1)])
    with pytest.raises(ValueError, match="either its size, for a box, or its shape"):
        tp.tank((1, 1), 0.1, shape=BLOCK)
    with pytest.raises(ValueError, match="spacing is None; it must be a number > 0 in m"):
        tp.tank(shape=BLOCK)


@pytest.mark.parametrize("tank", ["box", "polygon", "circle"])
def test_a_shape_that_touches_walls_fills_all_of_what_it_encloses(tank, water, air):
    """The outline runs along walls, at round-off, and through the tank; the volume is that of the shape."""
    if tank == "box":
        tank, shape, area = tp.tank((1, 1), 0.05), [(0, 0), (0.5, 0), (0.5, 0.6), (0, 0.6)], 0.3
    elif tank == "polygon":
        outline = [(0, 0.3), (0.7, 0.1), (1, 0.1), (1, 0.8), (0, 0.8)]
        tank, shape, area = tp.tank(shape=outline, spacing=0.05), [*outline[:3], (1, 0.5), (0, 0.5)], 0.33
    else:
        half = tp.shapes.polygon([(-1, 0), tp.shapes.arc((0, 0)), (1, 0)])
        tank, shape, area = tp.tank(shape=tp.shapes.circle((0, 0), 1.0), spacing=0.06), half, None
    case = tp.Case(tank.fill(air).fill(water, shape=shape), [water, air], (0, -9.81))
    simulation = tp.Simulation(case)
    if area is None:  # the halves of a polygon with an odd number of corners differ a little
        assert simulation.volume("water") == pytest.approx(0.5 * case.domain.area, rel=1e-4)
    else:
        assert simulation.volume("water") == pytest.approx(area, rel=1e-9)


@pytest.mark.parametrize("level", [-0.13, 0.21, 0.5])
def test_interfaces_across_inclined_and_curved_walls_are_exact(level, water, air):
    shape = tp.shapes.circle((0, 0), 1.0, holes=[[(-0.3, -0.4), (0.4, -0.2), (0.1, 0.4)]])
    tank = tp.tank(shape=shape, spacing=0.06).fill(air).fill(water, box=((-1, -1), (1, level)))
    case = tp.Case(tank, [water, air], (0, -9.81))
    mesh = tp.Simulation(case).mesh
    assert (mesh.position[mesh.cells[mesh.fluid == 0], 1] <= level + 1e-11).all()
    assert (mesh.position[mesh.cells[mesh.fluid == 1], 1] >= level - 1e-11).all()


def test_own_particles_take_the_shape_that_their_walls_enclose(water):
    """The dam break's block: the same mesh as the tank's; without the shape, and with too small a one, refused."""
    tank = tp.tank(shape=BLOCK, spacing=0.0125).fill(water)
    particles = tank.sample([water], fitted=True)
    simulation = tp.Simulation(tp.Case(particles, [water], (0, -9.81), shape=BLOCK))
    expected = tp.Simulation(tp.Case(tank, [water], (0, -9.81)))
    np.testing.assert_array_equal(simulation.mesh.cells, expected.mesh.cells)
    with pytest.raises(ValueError, match="gives what the walls enclose"):
        tp.Case(particles, [water], (0, -9.81))
    with pytest.raises(ValueError, match="is not on the boundary of the domain"):
        tp.Case(particles, [water], (0, -9.81), shape=[(0, 0), (0.584, 0), (0.584, 0.584), (0, 0.584)])
    with pytest.raises(ValueError, match="a tank has its own"):
        tp.Case(tank, [water], (0, -9.81), shape=BLOCK)

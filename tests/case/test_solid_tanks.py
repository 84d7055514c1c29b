"""Convex tanks in 3-D with sloping walls: points, rest, forces, flows, case files and what is refused."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from resumed_runs import require_same_when_resumed
from scipy.spatial import ConvexHull, HalfspaceIntersection

import tipfem as tp
from tipfem.geometry.solid_points import SolidPoints

WATER, OIL = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("oil", 900.0, 1e-2)
DOWN = (0.0, 0.0, -9.81)
BEACH = [(0, 0), (0.6, 0), (1.2, 0.3), (1.2, 0.6), (0, 0.6)]
CHAMFERED = [(0.2, 0), (0.8, 0), (1, 0.2), (1, 0.5), (0.8, 0.7), (0.2, 0.7), (0, 0.5), (0, 0.2)]
HOPPER = [(x, y, z) for (a, b), z in (((0.2, 0.4), 0.0), ((0.0, 0.6), 0.5)) for x in (a, b) for y in (a, b)]
OUTSIDE = tp.PointProbe(name="p", at=(1.1, 0.1, 0.1))
SOLIDS = {
    "beach": tp.solids.prism(BEACH, 0.36, along="y"),
    "chamfered": tp.solids.prism(CHAMFERED, 0.4, along="y"),
    "hopper": tp.solids.hull(HOPPER),
    # Askew: no wall along an axis, two of them at 80 degrees.
    "askew": tp.solids.hull([(0, 0, 0.1), (0.7, 0.1, 0), (0.1, 0.6, 0), (0.1, 0.1, 0.6), (0.6, 0.6, 0.5)]),
}


def below(solid, level):
    """The volume [m^3] of a solid below a level [m]."""
    planes = np.concatenate([np.column_stack([-solid.normal, solid.offset]), [[0, 0, 1, -level]]])
    middle, lowest = solid.corners.mean(axis=0), solid.corners[solid.corners[:, 2].argmin()]
    inside = lowest + min(1.0, 0.9 * (level - lowest[2]) / (middle[2] - lowest[2])) * (middle - lowest)
    return ConvexHull(HalfspaceIntersection(planes, inside).intersections).volume


def tank(name, spacing, level, *, full=False):
    """A tank with water up to a level, oil above it if it is full."""
    made = tp.tank(shape=SOLIDS[name], spacing=spacing, jitter=0.1)
    if full:
        made.fill(OIL)
    return made.fill(WATER, box=(SOLIDS[name].box[0], (*SOLIDS[name].box[1][:2], level)))


def case(name, spacing, level, *, full=False, **more):
    """The case of such a tank, at rest."""
    fluids = [WATER, OIL] if full else [WATER]
    return tp.Case(tank(name, spacing, level, full=full), fluids, DOWN, free_surface=not full, **more)


def test_walls_are_named_by_the_side_that_they_are_on():
    assert set(SOLIDS["beach"].names) == {"left", "right", "bottom", "top", "back", "front", "slope"}
    assert SOLIDS["hopper"].names == ("slope1", "slope2", "back", "front", "slope3", "slope4")
    assert np.allclose(SOLIDS["hopper"].normal[0, 1], 0)  # that of low x
    assert SOLIDS["beach"].whole == pytest.approx(0.36 * (0.6 * 0.6 + 0.6 * 0.45), rel=1e-14)


@pytest.mark.parametrize("name", SOLIDS)
def test_points_are_on_walls_or_off_them_and_nowhere_too_close(name):
    solid, h = SOLIDS[name], 0.06
    points = SolidPoints.of(solid, h, [set(), set(), {0.25}])
    by = np.random.default_rng(0).uniform(-0.1, 0.1, (len(points.wall), 3)) * h
    points = points.fitted(lambda x: x[:, 2] < 0.25).shifted(by, along_walls=True)
    depth = points.position @ solid.normal.T - solid.offset
    assert depth.min() > -1e-12
    on = np.abs(depth).min(axis=1) < 1e-12
    assert (on == points.wall).all()
    assert depth[~points.wall].min() > 0.2 * h
    assert np.abs(points.position[points.on_face, 2] - 0.25).max() < 1e-12
    apart = np.linalg.norm(points.position[:, None] - points.position, axis=2)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() > 0.2 * h
    assert np.median(apart.min(axis=1)) > 0.6 * h
    # As many as the volume has room for, and a point at each corner.
    assert 0.7 < len(points.position) * h**3 / solid.whole < 2.5
    corners = np.linalg.norm(points.position[:, None] - solid.corners, axis=2).min(axis=0)
    assert corners.max() < 1e-12


@pytest.mark.slow(but=("hopper-0.31-False",))
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize(
    ("name", "level"), [("beach", 0.22), ("chamfered", 0.35), ("chamfered", 0.12), ("hopper", 0.31), ("askew", 0.3)]
)
def test_fluids_rest_and_have_their_volumes(name, level, full):
    simulation = tp.Simulation(case(name, 0.06, level, full=full), time_step=0.01)
    assert simulation.volume("water") == pytest.approx(below(SOLIDS[name], level), rel=1e-10)
    for _ in range(15):
        simulation.step()
    assert np.abs(simulation.particles.velocity).max() < 1e-9
    assert simulation.history[-1]["refused_steps"] == 0


def test_the_force_on_a_slope_is_hydrostatic_and_all_forces_are_the_weight():
    probes = [tp.WallForce(name=name, wall=name) for name in SOLIDS["beach"].names]
    simulation = tp.Simulation(case("beach", 0.06, 0.24), time_step=0.01, probes=probes)
    simulation.step()
    force = {
        name: [simulation.probes[name][f"pressure_force_{k}"][-1] for k in "xyz"] for name in SOLIDS["beach"].names
    }
    # Along the slope the water is 0.24 m deep at its foot, and 0 at x = 1.08.
    across = 1000 * 9.81 * 0.5 * 0.24**2 * 0.36
    assert force["slope"] == pytest.approx([across, 0, -across * 2], rel=1e-9, abs=1e-6)
    weight = 1000 * 9.81 * below(SOLIDS["beach"], 0.24)
    assert np.sum(list(force.values()), axis=0) == pytest.approx([0, 0, -weight], rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("walls", [("bottom",), ("top", "slope"), SOLIDS["beach"].names])
def test_water_rests_between_no_slip_walls_and_probes_know_them(walls):
    made = tank("beach", 0.1, 0.2)
    for name in walls:
        made.wall(name, law="no-slip")
    made = tp.Case(made, [WATER], DOWN, free_surface=True)
    simulation = tp.Simulation(made, time_step=0.01, probes=[tp.WallForce(name=name, wall=name) for name in walls])
    assert simulation.volume("water") == pytest.approx(below(SOLIDS["beach"], 0.2), rel=1e-10)
    for _ in range(5):
        simulation.step()
    assert np.abs(simulation.particles.velocity).max() < 1e-9


@pytest.mark.parametrize("level", [0.13, 0.25])
def test_a_level_at_no_line_of_the_lattice_rests(level):
    made = tp.tank(shape=SOLIDS["beach"], spacing=0.1, jitter=0.1).fill(WATER, where=lambda x: x[:, 2] < level)
    simulation = tp.Simulation(tp.Case(made, [WATER], DOWN, free_surface=True), time_step=0.01)
    assert simulation.volume("water") == pytest.approx(below(SOLIDS["beach"], level), rel=1e-10)
    for _ in range(5):
        simulation.step()
    assert np.abs(simulation.particles.velocity).max() < 1e-9


def test_files_that_are_no_surfaces_are_refused(tmp_path):
    (tmp_path / "text.stl").write_text("hello\n" * 40)
    with pytest.raises(FileNotFoundError, match="no such file"):
        tp.solids.read(tmp_path / "none.stl")
    with pytest.raises(ValueError, match=r"text\.stl: it cannot be read"):
        tp.solids.read(tmp_path / "text.stl")
    with pytest.raises(ValueError, match="scale is 0"):
        tp.solids.read(tmp_path / "text.stl", scale=0)


@pytest.mark.slow
def test_a_dam_break_runs_up_a_slope():
    made = tp.tank(shape=SOLIDS["beach"], spacing=0.06, jitter=0.1)
    made.fill(WATER, box=((0, 0, 0), (0.36, 0.36, 0.42)))
    simulation = tp.Simulation(tp.Case(made, [WATER], DOWN, free_surface=True))
    highest = 0.0
    while simulation.time < 0.6:
        simulation.step()
        x = simulation.particles.position
        depth = x @ SOLIDS["beach"].normal.T - SOLIDS["beach"].offset
        assert depth.min() > -1e-9
        wet = x[~simulation.particles.wall & (x[:, 0] > 0.9)]
        highest = max(highest, wet[:, 2].max(initial=0.0))
    assert highest > 0.25  # it reaches the upper half of the slope
    assert simulation.volume("water") == pytest.approx(0.36 * 0.36 * 0.42, rel=1e-10)


def test_a_run_goes_on_with_the_same_bits(tmp_path):
    require_same_when_resumed(case("chamfered", 0.1, 0.35), tmp_path)


def test_a_case_file_has_it_by_its_corners(tmp_path):
    described = tp.describe(case("hopper", 0.08, 0.3), 0.1)
    assert not described.missing
    file = tmp_path / "hopper.toml"
    file.write_text(described.text)
    again = tp.load_case(file).case()
    assert again.tank.solid.names == SOLIDS["hopper"].names
    np.testing.assert_array_equal(again.particles.position, case("hopper", 0.08, 0.3).particles.position)


def test_a_surface_of_triangles_is_read(tmp_path):
    corners = SOLIDS["chamfered"].corners
    hull = ConvexHull(corners)
    meshio.write(tmp_path / "tank.stl", meshio.Mesh(1000 * corners, [("triangle", hull.simplices)]))
    read = tp.solids.read(tmp_path / "tank.stl", scale=1e-3)
    assert read.whole == pytest.approx(SOLIDS["chamfered"].whole, rel=1e-6)
    assert read.names == SOLIDS["chamfered"].names
    (tmp_path / "case.toml").write_text(
        'interface = "sharp"\nfree_surface = true\ngravity = [0, 0, -9.81]\n[fluids.water]\ndensity = 1000\n'
        'viscosity = 1e-3\n[tank]\nsurface = "tank.stl"\nscale = 1e-3\nspacing = 0.1\njitter = 0.1\n[[fill]]\n'
        'fluid = "water"\nbox = [[0, 0, 0], [1, 0.4, 0.35]]\n[time]\nend = 0.1\nlargest_step = 0.01\n'
    )
    assert tp.load_case(tmp_path / "case.toml").case().tank.sides == read.names
    notched = np.concatenate([corners, [corners.mean(axis=0)]])
    # One facet is pushed in to the middle.
    a, b, c = hull.simplices[0]
    inner = [[a, b, len(corners)], [b, c, len(corners)], [c, a, len(corners)]]
    broken = np.concatenate([hull.simplices[1:], inner])
    meshio.write(tmp_path / "notched.stl", meshio.Mesh(notched, [("triangle", broken)]))
    with pytest.raises(ValueError, match="not closed or not convex"):
        tp.solids.read(tmp_path / "notched.stl")


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: tp.solids.hull([(0, 0, 0), (1, 0, 0), (0, 1, 0)]), "four corners"),
        (lambda: tp.solids.hull([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]), "in one plane"),
        (lambda: tp.solids.hull([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, np.nan, 1)]), "four corners"),
        (lambda: tp.solids.hull(np.random.default_rng(0).normal(size=(30, 3))), "13 at most"),
        (lambda: tp.solids.prism([(0, 0), (1, 0), (0.2, 0.2), (0, 1)], 1.0), "not convex"),
        (lambda: tp.solids.prism(BEACH, -1.0), "number > 0"),
        (lambda: tp.solids.prism(BEACH, "1"), "number > 0"),
        (lambda: tp.solids.prism([(0, 0), (0.6, 0), (1.2, 0.05), (1.2, 0.6), (0, 0.6)], 0.4), "8 degrees"),
        (lambda: case("beach", 0.1, 0.33), "beside the corner of a slope at 0.3 m"),
        (lambda: tp.solids.prism(BEACH, 1.0, along="w"), "'x', 'y' or 'z'"),
        (lambda: tp.tank(shape=SOLIDS["beach"], spacing=0.1, jitter=0.1).block("a", ((0, 0, 0), (1, 1, 1))), "shape"),
        (lambda: tp.tank(shape=SOLIDS["beach"], spacing=0.1, coordinates="axisymmetric"), "is in 3-D"),
        (lambda: tp.tank(shape=SOLIDS["beach"], spacing=0.3), "too large"),
        (lambda: case("beach", 0.1, 0.3, full=True, interface="interpolated"), "needs 'sharp'"),
        (lambda: tp.Simulation(case("beach", 0.1, 0.3), probes=[OUTSIDE]), "'slope'"),
    ],
)
def test_what_is_wrong_is_told_in_a_sentence(make, text):
    with pytest.raises(ValueError, match=text):
        make()

"""Bodies that float and touch in tanks that are full: what gaps take up depends on how they move."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend.arrays import download
from tipfem.mesh.mesh import simplex_measure
from tipfem.physics.bodies.motion import BodyStates
from tipfem.physics.bodies.term import CHANGES, FloatingBodies
from tipfem.physics.contact.gaps import owners
from tipfem.physics.contact.mouths import mouths
from tipfem.step import solve

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
OIL = tp.Fluid("oil", density=900.0, viscosity=1e-2)
H, G = 0.05, 9.81
SIZE = 0.8, 0.6


class _Stop(Exception):
    """Ends a step."""


def run_of(*boxes, fluids=(WATER,), level=0.3, size=SIZE, **options):
    """Boxes, by their low corners, of 0.3 m x 0.2 m in a tank full of water, or of it up to a level and oil above."""
    tank = tp.tank(size, H).fill(fluids[-1])
    if len(fluids) > 1:
        tank.fill(WATER, box=((0, 0), (size[0], level)))
    for number, (x, y, density) in enumerate(boxes):
        shape = tp.shapes.rectangle((x, y), (x + 0.3, y + 0.2))
        tank.add(tp.Body(shape, name=f"b{number}", density=density, gap="seep", friction=0.3, **options))
    return tp.Simulation(tp.Case(tank, list(fluids), (0.0, -G), free_surface=True))


def stepped(simulation, until, size=SIZE):
    """The history until a time; the fluids, the gaps and the bodies fill the tank after each step."""
    whole = size[0] * size[1] - 0.06 * len(simulation.case.bodies)
    while simulation.time < until:
        simulation.step(until)
        state = simulation.state
        gaps = np.abs(simplex_measure(state.mesh.position, state.mesh.surface.empty)).sum()
        assert state.volume.sum() + gaps == pytest.approx(whole, abs=1e-12)
        assert state.volume_error < 1e-10
        row = simulation.history[-1]
        energy = max(1.0, row["kinetic_energy"] + row["body_kinetic_energy"])
        assert abs(row["energy_residual"]) < 1e-11 * energy
    return simulation.history


def test_heavy_box_stands_on_the_floor():
    """With its weight less its buoyancy, whatever the level of the pressure is."""
    for row in stepped(run_of((0.25, 0.0, 2500.0)), 0.05):
        assert row["b0_contact_force_y"] == pytest.approx(1500.0 * 0.06 * G, rel=1e-6)
        assert abs(row["b0_velocity_y"]) < 1e-8
        assert row["b0_touches"] == 2


def test_two_fluids_in_a_full_tank_are_refused():
    with pytest.raises(ValueError, match="one fluid in a full tank"):
        run_of((0.25, 0.0, 2500.0), fluids=(WATER, OIL))


def test_heavy_box_stands_under_water_and_oil():
    """Below a free surface it has its weight less its buoyancy in both, and volumes stay."""
    tank = tp.tank(SIZE, H).fill(OIL, box=((0, 0), (0.8, 0.5))).fill(WATER, box=((0, 0), (0.8, 0.15)))
    body = tp.Body(tp.shapes.rectangle((0.25, 0.0), (0.55, 0.2)), name="b", density=2500.0, gap="seep")
    simulation = tp.Simulation(tp.Case(tank.add(body), [WATER, OIL], (0.0, -G), free_surface=True))
    before = simulation.volume("water"), simulation.volume("oil")
    buoyancy = (0.1475 * 1000.0 + 0.0525 * 900.0) * 0.3 * G  # the box is a skin above the floor
    for _ in range(5):
        simulation.step()
        assert simulation.history[-1]["b_contact_force_y"] == pytest.approx(2500.0 * 0.06 * G - buoyancy, rel=1e-5)
    assert (simulation.volume("water"), simulation.volume("oil")) == pytest.approx(before, rel=1e-10)


def test_stack_and_a_body_in_a_corner():
    """A gap between bodies, and one that has no second mouth."""
    size = 0.8, 0.8
    simulation = run_of((0.3, 0.0, 2500.0), (0.3, 0.2, 2000.0), size=size)
    row = stepped(simulation, 0.03, size)[-1]
    low, high = 1500.0 * 0.06 * G, 1000.0 * 0.06 * G
    assert row["b1_contact_force_y"] == pytest.approx(high, rel=1e-5)
    assert row["b0_contact_force_y"] == pytest.approx(low, rel=1e-5)
    row = stepped(run_of((0.0, 0.0, 2500.0)), 0.03)[-1]
    assert row["b0_contact_force_y"] == pytest.approx(low, rel=1e-5)


@pytest.mark.parametrize(("y", "density", "end"), [(0.16, 2500.0, 0.6), (0.24, 500.0, 0.8), (0.0, 500.0, 0.5)])
def test_box_that_moves(y, density, end):
    """It sinks to the floor, or rises to the lid, and rests there; or lifts off the floor."""
    simulation = run_of((0.25, y, density))
    rows = stepped(simulation, end)
    weight, gap = density * 0.06 * G, 0.05 * H
    row = rows[-1]
    if y == 0.0:
        assert row["b0_y"] > 0.1 + 1.2 * H
        assert rows[-1]["b0_velocity_y"] > 0.2
        return
    height = 0.1 + gap if density > 1000.0 else SIZE[1] - 0.1 - gap
    assert row["b0_y"] == pytest.approx(height, abs=1e-6)
    carried = np.mean([r["b0_contact_force_y"] for r in rows[-15:]])
    assert carried == pytest.approx(weight - 1000.0 * 0.06 * G, abs=0.15 * 1000.0 * 0.06 * G)


def test_volumes_are_adjoint_to_forces():
    """Slopes are those of what gaps take up, whose sources give it to the fluids, and take nothing else."""
    simulation = run_of((0.25, 0.0, 2500.0))
    state = simulation.state
    found = mouths(state.mesh, state.mesh.surface.empty)
    part = state.part(BodyStates)
    on, centre = owners(part.label, simulation.particles.wall) - 1, part.position[:, :2]
    x, generator = state.mesh.position, np.random.default_rng(3)
    assert found.share.sum(axis=0) == pytest.approx(1.0)
    assert found.part.sum(axis=1) == pytest.approx(1.0)
    for _ in range(3):
        q, ends = generator.normal(size=3) * 1e-7, []
        for sign in (-1, 1):
            end, c, s = x.copy(), np.cos(sign * q[2]), np.sin(sign * q[2])
            turned = (x[on == 0] - centre[0]) @ np.array([[c, s], [-s, c]])
            end[on == 0] = centre[0] + sign * q[:2] + turned
            ends.append(end)
        taken = found.share @ (found.taken(ends[1]) - found.taken(ends[0]))
        assert taken == pytest.approx(2 * found.slopes(x, on, centre) @ q, abs=1e-14)
        given = state.mesh.measure @ found.growth(ends[1])
        assert given == pytest.approx(-found.taken(ends[1]).sum(), abs=1e-18)


def test_jacobian_has_what_gaps_take_up(monkeypatch):
    """The product with the matrix is the difference of residuals along the body's unknowns; it turns, and slides."""
    simulation, checked = run_of((0.25, 0.0, 500.0), angular_velocity=0.2, velocity=(0.3, 0.05), law="no-slip"), []

    def examine(problem, x, **_options):
        problem.residual(x)
        problem.correct(x, 1e-3)
        problem.residual(x)
        problem.linearise()
        size, base = problem.size, download(x, problem.size).copy()
        term = next(each for each in problem.terms if isinstance(each, FloatingBodies))
        assert term._rows_of_mouths is not None
        term._changes = CHANGES  # no other forces of contacts
        v, out = np.zeros(size), problem.buffers.get("test.out", size)
        v[3 * problem.nodes + np.array([0, 1, 3])] = 1.0, -0.7, 0.4
        v[2 : 3 * problem.nodes : 3] = 1e4 * np.random.default_rng(0).standard_normal(problem.nodes)
        v[2 : 3 * problem.nodes : 3][problem.mesh.surface.pinned] = 0.0
        problem.product(problem.buffers.upload("test.v", v), out)
        product, sides = download(out, size).copy(), []
        for sign in (1.0, -1.0):
            problem.residual(problem.buffers.upload("test.x", base + sign * 1e-6 * v))
            sides.append(download(problem._r, size).copy())
        difference = (sides[0] - sides[1]) / 2e-6
        own = 3 * problem.nodes + np.array([0, 1, 3])  # the directions of forces are those of the iterate there
        np.testing.assert_allclose(product[own], difference[own], rtol=0.02)
        product[own] = difference[own]
        np.testing.assert_allclose(product, difference, atol=1e-5 * np.abs(product).max())
        checked.append(True)
        raise _Stop

    monkeypatch.setattr(solve, "newton", examine)
    with pytest.raises(_Stop):
        simulation.step()
    assert checked


def test_box_goes_on_from_a_checkpoint(tmp_path):
    """To the bit, while it lifts off."""
    case = run_of((0.25, 0.0, 500.0)).case
    whole = tp.Simulation(case, tmp_path / "run", time_step=4e-3)
    whole.run(0.02, progress=False)
    shutil.copytree(tmp_path / "run", tmp_path / "part")
    whole.run(0.04, progress=False)
    resumed = tp.Simulation.resume(tmp_path / "part", case)
    resumed.run(0.04, progress=False)
    np.testing.assert_array_equal(resumed.particles.position, whole.particles.position)
    np.testing.assert_array_equal(resumed.particles.velocity, whole.particles.velocity)

"""Simulations between periodic sides: the ends do not matter, momentum and volumes stay, runs go on to the bit."""

import meshio
import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh import measures

WATER = tp.Fluid("water", density=1000.0, viscosity=1.0)
OIL = tp.Fluid("oil", density=800.0, viscosity=2.0)
GRAVITY = (0.0, -9.81)


def stirred(*, interface="sharp", slip=True, fluids=(WATER, OIL), width=1.0, **options):
    """Two fluids in a periodic tank, in motion through its sides."""
    tank = tp.tank((width, 0.5), 0.05, periodic="x", jitter=0.2)

    def velocity(x):
        wave = np.sin(2 * np.pi * x[:, 0] / width)
        return np.stack([0.5 + 0.2 * np.cos(2 * np.pi * x[:, 1]) * wave, 0.1 * np.sin(2 * np.pi * x[:, 1]) * wave], 1)

    tank.fill(fluids[-1], velocity=velocity)
    if len(fluids) > 1:
        tank.fill(fluids[0], box=((0, 0), (width, 0.25)), velocity=velocity)
    if slip:
        tank.wall("bottom", slip=True).wall("top", slip=True)
    return tp.Case(tank, list(fluids), GRAVITY, interface=interface, **options)


@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
def test_momentum_along_the_sides_and_volumes_stay_to_round_off(interface):
    simulation = tp.Simulation(stirred(interface=interface), time_step=0.01)
    start, volume = simulation.state.mass @ simulation.particles.velocity[:, 0], simulation.state.volume
    for _ in range(60):
        simulation.step()
    assert simulation.time * 0.5 > 0.2  # particles have passed the sides
    np.testing.assert_allclose(simulation.state.mass @ simulation.particles.velocity[:, 0], start, rtol=1e-12)
    if interface == "sharp":
        np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-12)
    np.testing.assert_allclose(simulation.mesh.measure.sum(), 0.5, rtol=1e-12)
    x = simulation.particles.position[:, 0]
    assert ((x >= 0) & (x < 1.0)).all()
    assert np.mean([row["krylov_iterations"] for row in simulation.history]) < 20


@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
def test_it_does_not_matter_where_the_ends_are(interface):
    """The same flow with particles shifted by a third of the width, to round-off for some steps."""
    first = stirred(interface=interface)
    particles = first.tank.sample(list(first.fluids), fitted=interface == "sharp")
    runs = []
    for shift in (0.0, 1 / 3):
        moved = particles.copy(position=first.period.wrapped(particles.position + [shift, 0.0]))
        walls = [
            tp.Wall(name, particles=moved.wall & (moved.position[:, 1] == y), slip=True)
            for name, y in (("bottom", 0.0), ("top", 0.5))
        ]
        case = tp.Case(moved, [WATER, OIL], GRAVITY, interface=interface, walls=walls, period=(1.0, 0.0))
        simulation = tp.Simulation(case, time_step=0.005)
        for _ in range(3):
            simulation.step()
        runs.append(simulation.particles)
    shift = first.period.shortest(runs[1].position - runs[0].position - [1 / 3, 0.0])
    np.testing.assert_allclose(shift, 0.0, atol=1e-6)
    np.testing.assert_allclose(runs[1].velocity, runs[0].velocity, atol=1e-4)


def test_a_run_goes_on_from_a_checkpoint_to_the_bit(tmp_path):
    whole = tp.Simulation(stirred(), tmp_path / "whole", time_step=0.01)
    whole.run(0.1, progress=False)
    whole.run(0.2, progress=False)
    part = tp.Simulation(stirred(), tmp_path / "part", time_step=0.01, checkpoint_interval=0.1)
    part.run(0.1, progress=False)
    resumed = tp.Simulation.resume(tmp_path / "part")
    resumed.run(0.2, progress=False)
    for name in ("position", "velocity", "pressure"):
        np.testing.assert_array_equal(getattr(resumed.particles, name), getattr(whole.particles, name))


def test_fields_have_no_stretched_cells(tmp_path):
    simulation = tp.Simulation(stirred(), tmp_path, time_step=0.01)
    simulation.run(0.05, progress=False)
    path = sorted((tmp_path / "fields").glob("*.vtu"))[-1]
    mesh = meshio.read(path)
    cells = mesh.cells_dict["triangle"]
    assert len(cells) == len(simulation.mesh.cells)
    assert np.ptp(mesh.points[cells][:, :, 0], axis=1).max() < 0.2


def test_probes_see_across_the_ends():
    simulation = tp.Simulation(stirred(), time_step=0.01)
    for _ in range(5):
        simulation.step()
    for x in (0.0, 0.001, 0.5, 0.999, 1.0):
        depth = measures.depth(simulation.mesh, simulation.particles.fluid, 0, x)
        assert depth == pytest.approx(0.25, abs=0.05)
        height = measures.surface_height(simulation.mesh, simulation.particles.fluid, 0, x)
        assert height == pytest.approx(depth, abs=1e-9)
    assert measures.depth(simulation.mesh, simulation.particles.fluid, 0, 0.0) == pytest.approx(
        measures.depth(simulation.mesh, simulation.particles.fluid, 0, 1.0), abs=1e-6
    )


def test_gravity_along_the_channel_drives_it_and_does_work():
    """Poiseuille's flow between no-slip walls: the energy closes, with gravity's work as external."""
    tank = tp.tank((0.5, 1.0), 0.0625, periodic="x").fill(tp.Fluid("oil", density=1.0, viscosity=1.0))
    case = tp.Case(tank, [tank.regions[0].fluid], (12.0, 0.0))
    simulation = tp.Simulation(case, time_step=0.02)
    simulation.run(0.6, progress=False)
    x, v = simulation.particles.position, simulation.particles.velocity
    np.testing.assert_allclose(v[:, 0], 6 * x[:, 1] * (1 - x[:, 1]), atol=0.03)
    assert np.abs(v[:, 1]).max() < 0.01
    rows = simulation.history
    work, lost = sum(row["external_work"] for row in rows), sum(row["viscous_dissipation"] for row in rows)
    assert work > lost > 0
    assert abs(sum(row["energy_residual"] for row in rows)) < 1e-3 * work
    assert all(row["potential_energy"] == 0 for row in rows)


def test_a_case_file_has_the_periodic_sides(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(
        """
        gravity = [0.0, -9.81]
        [fluids.water]
        density = 1000.0
        viscosity = 1e-3
        [tank]
        size = [1.0, 0.5]
        spacing = 0.1
        periodic = "x"
        [[fill]]
        fluid = "water"
        [walls.top]
        slip = true
        [time]
        end = 0.1
        """
    )
    case = tp.load_case(path).case()
    assert case.period.width.tolist() == [1.0, 0.0]


@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
def test_no_drop_is_added_between_periodic_sides(interface):
    simulation = tp.Simulation(stirred(interface=interface), time_step=0.01)
    with pytest.raises(ValueError, match="a drop cannot be added to a tank with periodic sides"):
        simulation.remesher.with_drop(simulation.state, np.array([0.5, 0.4]), 0.1, 0, np.zeros(2))

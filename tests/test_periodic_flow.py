"""Simulations between periodic sides: the ends do not matter, momentum and volumes stay, runs go on to the bit."""

import meshio
import numpy as np
import pytest
from tipfem.render import Results, render_frame

import tipfem as tp
from tipfem.mesh import measures
from tipfem.physics.state import lumped

WATER = tp.Fluid("water", density=1000.0, viscosity=1.0)
OIL = tp.Fluid("oil", density=800.0, viscosity=2.0)
GRAVITY = (0.0, -9.81)


def without_walls(interface="sharp"):
    """A disc of water in oil in a box without walls, in motion through all of its sides."""
    tank = tp.tank((1.0, 0.5), 0.05, periodic="xy", jitter=0.2)

    def velocity(x):
        return np.stack([0.5 + 0.2 * np.sin(4 * np.pi * x[:, 1]), -0.4 + 0.1 * np.sin(2 * np.pi * x[:, 0])], 1)

    tank.fill(OIL, velocity=velocity).fill(WATER, disc=((0.5, 0.25), 0.15), velocity=velocity)
    return tp.Case(tank, [WATER, OIL], (0, 0), interface=interface)


@pytest.mark.slow(but=("sharp",))
@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
def test_without_walls_momentum_and_volumes_stay_to_round_off(interface):
    simulation = tp.Simulation(without_walls(interface), time_step=0.01)
    start, volume = simulation.state.mass @ simulation.particles.velocity, simulation.state.volume
    for _ in range(60):
        simulation.step()
    np.testing.assert_allclose(simulation.state.mass @ simulation.particles.velocity, start, rtol=1e-12)
    if interface == "sharp":
        np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-12)
    np.testing.assert_allclose(simulation.mesh.measure.sum(), 0.5, rtol=1e-12)
    x, p = simulation.particles.position, simulation.particles.pressure
    assert ((x >= 0) & (x < [1.0, 0.5])).all()
    assert abs(p.mean()) < 0.05 * np.ptp(p)
    rows = simulation.history
    assert np.mean([row["krylov_iterations"] for row in rows]) < (14 if interface == "sharp" else 10)
    assert abs(sum(row["energy_residual"] for row in rows)) < 1e-4 * simulation.energy().kinetic


def test_without_walls_the_pressure_has_the_mean_zero():
    simulation = tp.Simulation(without_walls(), time_step=0.01)
    solved = simulation.solve(simulation.state, 0.01)
    volume = lumped(simulation.mesh, np.ones(len(simulation.mesh.cells)))
    p = solved.particles.pressure
    assert abs(volume @ p) < 1e-12 * volume @ abs(p)


def test_without_walls_it_does_not_matter_where_the_ends_are():
    case, runs = without_walls(), []
    for shift in ([0.0, 0.0], [1 / 3, 0.2]):
        moved = case.particles.copy(position=case.period.wrapped(case.particles.position + shift))
        simulation = tp.Simulation(tp.Case(moved, [WATER, OIL], (0, 0), period=(1.0, 0.5)), time_step=0.005)
        for _ in range(3):
            simulation.step()
        runs.append(simulation.particles)
    apart = case.period.shortest(runs[1].position - runs[0].position - [1 / 3, 0.2])
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)
    np.testing.assert_allclose(runs[1].velocity, runs[0].velocity, atol=1e-4)


def test_without_walls_a_run_goes_on_from_a_checkpoint_to_the_bit_and_has_fields(tmp_path):
    whole = tp.Simulation(without_walls(), time_step=0.01)
    whole.run(0.1, progress=False)
    whole.run(0.2, progress=False)
    part = tp.Simulation(without_walls(), tmp_path, time_step=0.01, checkpoint_interval=0.1)
    part.run(0.1, progress=False)
    resumed = tp.Simulation.resume(tmp_path)
    resumed.run(0.2, progress=False)
    for name in ("position", "velocity", "pressure"):
        np.testing.assert_array_equal(getattr(resumed.particles, name), getattr(whole.particles, name))
    mesh = meshio.read(sorted((tmp_path / "fields").glob("*.vtu"))[-1])
    cells = mesh.cells_dict["triangle"]
    assert np.ptp(mesh.points[cells], axis=1).max() < 0.2
    results = Results(tmp_path)
    scene = results.scene(len(results.times) - 1)
    a, b, c = scene.position[scene.cells].transpose(1, 0, 2)
    area = abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert area.max() < 2 * 0.05**2  # no cell reaches across the picture
    assert area[: len(cells)].sum() == pytest.approx(0.5, rel=1e-6)
    assert (scene.position[scene.cells].min(axis=(0, 1)) <= 0).all()
    assert (scene.position[scene.cells].max(axis=(0, 1)) >= [1.0, 0.5]).all()
    assert render_frame(scene, size=(320, 240), backend="raster").shape == (240, 320, 3)


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


def total_momentum(simulation):
    """Along x, with that of liquids that slide along others."""
    state, velocity = simulation.state, simulation.particles.velocity
    slid = sum(part.total(velocity)[0] for part in state.own_inertia)
    return state.mass @ velocity[:, 0] + slid


@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
def test_momentum_along_the_sides_and_volumes_stay_to_round_off(interface):
    simulation = tp.Simulation(stirred(interface=interface), time_step=0.01)
    start, volume = total_momentum(simulation), simulation.state.volume
    for _ in range(60):
        simulation.step()
    assert simulation.time * 0.5 > 0.2  # particles have passed the sides
    # Where liquids slide, the first acceleration, which is solved for, leaves its tolerance.
    np.testing.assert_allclose(total_momentum(simulation), start, rtol=1e-12 if interface == "interpolated" else 1e-9)
    np.testing.assert_allclose(
        [row["momentum_x"] for row in simulation.history], total_momentum(simulation), rtol=1e-12
    )
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


@pytest.mark.slow
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
    text = path.read_text().replace('"x"', '"xy"').replace("0.1\n        periodic", "0.05\n        periodic")
    path.write_text(text)
    with pytest.raises(tp.CaseFileError, match=r"walls.top is no wall of the tank; it must be one of none"):
        tp.load_case(path).case()
    path.write_text(text.replace("[walls.top]\n        slip = true", ""))
    with pytest.raises(tp.CaseFileError, match=r"gravity is .* periodic in all directions"):
        tp.load_case(path).case()
    case = tp.load_case(path, ["gravity=[0.0, 0.0]"]).case()
    assert case.period.width.tolist() == [1.0, 0.5]


@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
def test_no_drop_is_added_between_periodic_sides(interface):
    simulation = tp.Simulation(stirred(interface=interface), time_step=0.01)
    with pytest.raises(ValueError, match="a drop cannot be added to a tank with periodic sides"):
        simulation.remesher.with_drop(simulation.state, np.array([0.5, 0.4]), 0.1, 0, np.zeros(2))

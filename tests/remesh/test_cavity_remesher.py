"""Two fluids with a sharp interface in three dimensions: first meshes, rest, waves, walls, and what repairs keep."""

import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.cavity.balance import keep_momentum
from tipfem.remesh.cavity.cavities import Cavities
from tipfem.remesh.cavity.following import qualities

WATER, OIL = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("oil", 800.0, 1e-3)
AIR, LIGHT = tp.Fluid("air", 1.2, 1e-3), tp.Fluid("light", 300.0, 1e-3)
GRAVITY = (0, -9.81, 0)
SIDES = ("left", "right", "bottom", "top", "front", "back")


def simulate(size, spacing, upper, lower, law="no-slip", **fill):
    """A tank of one fluid, with a part of it filled with another."""
    tank = tp.tank(size, spacing, jitter=0.15).fill(upper).fill(lower, **fill)
    for side in SIDES:
        tank.wall(side, **({"slip": True} if law == "slip" else {"law": law}))
    return tp.Simulation(tp.Case(tank, [lower, upper], GRAVITY))


def whole(simulation, size):
    """Check that the mesh of a tank is whole: its cells fill the box, and walls are where the wall particles are."""
    state = simulation.state
    mesh, x = state.mesh, state.particles.position
    np.testing.assert_array_equal(mesh.neighbours, Mesh(x, mesh.cells).neighbours)
    assert mesh.measure.min() > 0
    assert mesh.measure.sum() == pytest.approx(np.prod(size), rel=1e-12)
    on = (np.abs(x) < 1e-9) | (np.abs(x - size) < 1e-9)
    np.testing.assert_array_equal(on.any(axis=1), state.particles.wall)
    cell, i = np.nonzero(mesh.neighbours < 0)
    corner = x[np.stack([mesh.cells[cell, (i + k) % 4] for k in (1, 2, 3)])]
    area = 0.5 * np.linalg.norm(np.cross(corner[1] - corner[0], corner[2] - corner[0]), axis=1).sum()
    a, b, c = size
    assert area == pytest.approx(2 * (a * b + b * c + c * a), rel=1e-12)


def height(simulation, shape):
    """Amplitude of an interface of that shape around y = 0.5."""
    mesh = simulation.state.mesh
    x = mesh.position[np.flatnonzero(mesh.components.mark & 1)]
    f = shape(x)
    return ((x[:, 1] - 0.5) * f).sum() / (f * f).sum()


def centre(mesh):
    """Centre of the first fluid."""
    weight = mesh.measure * (mesh.fluid == 0)
    return weight @ mesh.centres() / weight.sum()


def test_the_first_mesh_has_what_is_filled_in():
    """Layers exactly, a wave to the square of the spacing, a ball as a polyhedron with its corners on the sphere."""
    layers = simulate((1, 1, 1), 0.2, OIL, WATER, box=((0, 0, 0), (1, 0.4, 1)))
    np.testing.assert_allclose(layers.state.volume, [0.4, 0.6], rtol=1e-14)
    whole(layers, (1, 1, 1))
    wave = simulate((1, 1, 0.5), 0.1, OIL, WATER, where=lambda x: x[:, 1] < 0.5 + 0.05 * np.cos(np.pi * x[:, 0]))
    assert wave.state.volume[0] == pytest.approx(0.25, rel=1e-4)
    ball = simulate((1, 1, 1), 0.1, WATER, LIGHT, disc=((0.5, 0.5, 0.5), 0.3))
    mesh = ball.state.mesh
    on = mesh.position[np.flatnonzero(mesh.components.mark & 1)]
    np.testing.assert_allclose(np.linalg.norm(on - 0.5, axis=1), 0.3, atol=1e-6)
    assert ball.state.volume[0] == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.06)
    assert len(mesh.components) == 2
    whole(ball, (1, 1, 1))


@pytest.mark.parametrize("law", ["no-slip", "slip", "layer"])
def test_layers_stay_at_rest(law):
    simulation = simulate((1, 1, 1), 1 / 6, OIL, WATER, law, box=((0, 0, 0), (1, 0.5, 1)))
    simulation.step()
    cells = simulation.mesh.cells.copy()
    simulation.run(until=0.3)
    assert simulation.particles.max_speed < 1e-9
    np.testing.assert_array_equal(simulation.mesh.cells, cells)
    np.testing.assert_allclose(simulation.state.volume, 0.5, rtol=1e-12)
    depth = 1 - simulation.particles.position[:, 1]
    wanted = 9.81 * np.where(depth < 0.5, 800 * depth, 400 + 1000 * (depth - 0.5))
    np.testing.assert_allclose(np.ptp(simulation.particles.pressure - wanted), 0, atol=1e-6)


@pytest.mark.slow
def test_a_wave_under_air_has_its_period_and_its_walls():
    """The first quarter of the period within 2 %, the mode of the tank's length; volumes and the box stay."""
    size, k = (1, 1, 0.5), np.pi
    shape = lambda x: np.cos(k * x[:, 0])  # noqa: E731
    simulation = simulate(size, 0.1, AIR, WATER, "slip", where=lambda x: x[:, 1] < 0.5 + 0.03 * shape(x))
    volume = simulation.state.volume.copy()
    quarter = 0.5 * np.pi / np.sqrt(9.81 * k * np.tanh(0.5 * k) * (1000 - 1.2) / (1000 + 1.2))
    old = height(simulation, shape)
    assert old == pytest.approx(0.03, rel=0.01)
    while True:
        before = simulation.time
        simulation.step()
        whole(simulation, size)
        new = height(simulation, shape)
        if new < 0:
            break
        old = new
    found = before + (simulation.time - before) * old / (old - new)
    assert found == pytest.approx(quarter, rel=0.02)
    np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-12)
    lost = sum(row["numerical_dissipation"] for row in simulation.history)
    assert abs(lost) < 0.01 * simulation.history[-1]["kinetic_energy"]


@pytest.mark.slow
def test_a_light_ball_rises_and_its_volume_stays():
    """Repairs of a ball that is deformed: the shape of cells, volumes, where it goes, how many particles there are."""
    simulation = simulate((1, 1.5, 1), 0.125, WATER, LIGHT, disc=((0.5, 0.5, 0.5), 0.25))
    volume, number = simulation.state.volume.copy(), len(simulation.particles)
    start = centre(simulation.mesh)
    simulation.run(until=0.5)
    whole(simulation, (1, 1.5, 1))
    np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-12)
    moved = centre(simulation.mesh) - start
    assert 0.15 < moved[1] < 0.5 * 9.81 * 0.5**2
    assert np.abs(moved[[0, 2]]).max() < 0.03
    assert qualities(simulation.mesh).min() > 0.05
    assert abs(len(simulation.particles) - number) < 0.1 * number
    assert sum(row["relocated"] for row in simulation.history) > 20
    assert abs(simulation.history[-1]["energy_residual"]) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("law", ["no-slip", "layer"])
def test_a_dam_break_meets_the_far_wall(law):
    """Air is driven off the floor, and what comes down on it wets it, no-slip or not; nothing stops the run."""
    size = (0.8, 0.6, 0.3)
    simulation = simulate(size, 0.1, AIR, WATER, law, box=((0, 0, 0), (0.3, 0.4, 0.3)))
    volume = simulation.state.volume.copy()
    np.testing.assert_allclose(volume, [0.036, 0.108], rtol=5e-3)
    simulation.run(until=0.45)
    whole(simulation, size)
    wet = np.unique(simulation.mesh.cells[simulation.mesh.fluid == 0])
    assert simulation.particles.position[wet, 0].max() == pytest.approx(0.8)
    np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-10)


@pytest.mark.slow
def test_dam_breaks_of_five_starts_end_alike():
    """Layers on walls: what numerics take before the front meets the far wall, and after it has run up there."""
    before, after = [], []
    for seed in range(1, 6):
        tank = tp.tank((1.5, 0.8, 0.4), 0.1, jitter=0.15, seed=seed).fill(AIR)
        tank.fill(WATER, box=((0, 0, 0), (0.5, 0.5, 0.4)))
        simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], GRAVITY))
        volume = simulation.state.volume.copy()
        np.testing.assert_allclose(volume, [0.1, 0.38], rtol=5e-3)
        simulation.run(until=1.0, progress=False)
        whole(simulation, (1.5, 0.8, 0.4))
        first = [row for row in simulation.history if row["time"] < 0.35]
        taken = sum(row["numerical_dissipation"] for row in first)
        before.append(taken / first[-1]["kinetic_energy"])
        after.append(sum(row["numerical_dissipation"] for row in simulation.history))
        np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-9)
    assert np.mean(before) < 0.035
    assert 40 < np.mean(after) < 75
    assert np.std(after) < 12


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"numerics": tp.Numerics(fitting=tp.FittedRule(too_close=0.5))}, "fitting is given in 3-D"),
    ],
)
def test_what_is_for_the_plane_alone_is_refused(options, words):
    tank = tp.tank((1, 1, 1), 0.25, jitter=0.15).fill(AIR).fill(WATER, box=((0, 0, 0), (1, 0.5, 1)))
    with pytest.raises(ValueError, match=words):
        tp.Case(tank, [WATER, AIR], GRAVITY, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"numerics": tp.Numerics(budget="detailed", mass="consistent")},
        {"numerics": tp.Numerics(pressure="continuous")},
        {"tank_motion": tp.Motion(translation=lambda t: (0.05 * t**3, 0, 0))},
    ],
)
def test_it_goes_together_with(options):
    """Options of the method, motions of the tank, a lid that slides, three fluids."""
    tank = tp.tank((1, 1, 0.5), 0.125, jitter=0.15).fill(AIR).fill(OIL, box=((0, 0, 0), (0.5, 0.75, 0.5)))
    tank.fill(WATER, box=((0, 0, 0), (0.5, 0.5, 0.5)))
    if "tank_motion" not in options:
        tank.wall("top", velocity=(0.5, 0, 0)).wall("bottom", slip=True)
    simulation = tp.Simulation(tp.Case(tank, [WATER, OIL, AIR], GRAVITY, **options))
    volume = simulation.state.volume.copy()
    simulation.run(until=0.06, progress=False)
    np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-11)
    assert abs(simulation.history[-1]["energy_residual"]) < 1e-9


def test_repairs_keep_momentum():
    """Of two labels of any densities, after motion, repairs and restored volumes; what is held takes nothing up."""
    simulation = simulate((1, 1, 1), 0.125, WATER, LIGHT, disc=((0.5, 0.5, 0.5), 0.3))
    mesh, wall, rng = simulation.mesh, simulation.particles.wall, np.random.default_rng(3)
    move = rng.normal(size=mesh.position.shape) * ~wall[:, None] * 0.03
    while (mesh.moved(mesh.position + move).measure <= 0.02 * mesh.measure).any():
        move *= 0.8
    mesh = Mesh(mesh.position + move, mesh.cells, mesh.fluid).with_(neighbours=mesh.neighbours)
    fields, density = rng.normal(size=(len(mesh.position), 7)) * ~wall[:, None], np.array([300.0, 1000.0])

    def momentum(cells, fluid, volume, values):
        return ((density[fluid] * volume)[:, None] * values[cells].mean(axis=1)).sum(axis=0)

    before = momentum(mesh.cells, mesh.fluid, mesh.measure, fields)
    cavities = Cavities(mesh, wall, 0.125, fields)
    cavities.repair(0.3)
    repaired = cavities.x.copy()
    wanted = cavities.volumes(cavities.label, 2) + [1e-3, -1e-3]
    cavities.restore_volumes(wanted, cavities.label)
    assert (cavities.x != repaired).any()
    assert cavities.is_new.any()
    keep_momentum(cavities, repaired, mesh, fields, density)
    after = cavities.mesh()
    now = momentum(after.cells, after.fluid, after.measure, cavities.fields)
    np.testing.assert_allclose(now[:6], before[:6], atol=1e-10 * np.abs(before[:6]).max())


def test_a_small_piece_that_is_restored_keeps_its_speed():
    """A cell beside a blob, with which it shares a particle, has grown in the repair; both move at one speed."""
    simulation = simulate((1, 1, 1), 0.125, WATER, LIGHT, disc=((0.5, 0.5, 0.5), 0.3))
    mesh, wall, density = simulation.mesh, simulation.particles.wall, np.array([0.0, 1000.0])
    middle = np.linalg.norm(mesh.centres() - 0.5, axis=1)
    blob = middle < 0.25
    inner = np.zeros(len(wall), dtype=bool)
    inner[mesh.cells[blob]] = True
    touches = inner[mesh.cells].sum(axis=1)
    one = np.flatnonzero((touches == 1) & ~wall[mesh.cells].any(axis=1))[0]
    label = blob.astype(np.int32)
    label[one] = 1
    mesh = Mesh(mesh.position, mesh.cells, label).with_(neighbours=mesh.neighbours)
    fields = np.zeros((len(wall), 6))
    fields[np.unique(mesh.cells[label == 1]), 0] = 2.0
    cavities = Cavities(mesh, wall, 0.125, fields)
    start, tip = cavities.x.copy(), mesh.cells[one][~inner[mesh.cells[one]]][0]
    centre = np.flatnonzero(inner & (np.bincount(mesh.cells[~blob].ravel(), minlength=len(wall)) == 0))[0]
    root = mesh.cells[one][inner[mesh.cells[one]]][0]
    cavities.x[tip] += 1.5 * (cavities.x[tip] - cavities.x[root])
    cavities.x[centre] += 0.01
    repaired = cavities.x.copy()
    cavities.x[tip] = start[tip]
    keep_momentum(cavities, repaired, mesh, fields, density)
    moving = np.unique(mesh.cells[label == 1])
    np.testing.assert_allclose(cavities.fields[moving, 0], 2.0, rtol=1e-12)


def test_a_run_goes_on_to_the_bit(tmp_path):
    tank = tp.tank((1, 1, 0.5), 0.125, jitter=0.15).fill(AIR).fill(WATER, box=((0, 0, 0), (0.5, 0.5, 0.5)))
    case = tp.Case(tank, [WATER, AIR], GRAVITY)
    whole = tp.Simulation(case, tmp_path, output_interval=0.03, checkpoint_interval=0.03)
    whole.run(until=0.03, progress=False)
    resumed = tp.Simulation.resume(tmp_path)
    for simulation in (whole, resumed):
        for _ in range(4):
            simulation.step()
    for name in ("position", "velocity", "acceleration", "pressure", "fluid"):
        assert getattr(resumed.particles, name).tobytes() == getattr(whole.particles, name).tobytes(), name
    assert resumed.mesh.cells.tobytes() == whole.mesh.cells.tobytes()


def test_a_drop_is_put_into_a_fluid():
    simulation = simulate((1, 1, 1), 0.1, WATER, OIL, box=((0, 0.8, 0), (1, 1, 1)))
    simulation.step()
    before = simulation.state.volume.copy()
    simulation.steer(tp.Drop((0.5, 0.4, 0.5), 0.2, "oil"))
    simulation.step()
    gained = simulation.state.volume - before
    assert gained[0] == pytest.approx(4 / 3 * np.pi * 0.2**3, rel=0.12)
    assert gained.sum() == pytest.approx(0, abs=1e-12)
    whole(simulation, (1, 1, 1))

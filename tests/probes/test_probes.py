"""tipfem/probes/: fluids at rest exactly, linear fields exactly, and what does not fit refused in one message."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import tipfem as tp
from tipfem import probes as tpp
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.mesh.measures import surface_height
from tipfem.probes.walls import wall_line
from tipfem.results.output import ResultsFolder

G = 9.81


def two_layers(water, air, interface):
    """Water 0.2 m deep under 0.2 m of air, at rest after a step; the sharp interface is in exact balance."""
    tank = tp.tank((0.4, 0.4), 0.02).fill(air).fill(water, box=((0, 0), (0.4, 0.2)))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -G), interface=interface), time_step=1e-3)
    simulation.step()
    return simulation


@pytest.fixture
def balanced(water, air):
    """The layers with the sharp interface."""
    return two_layers(water, air, "sharp")


@pytest.fixture(params=["sharp", "interpolated"])
def layers(request, water, air):
    """The layers with each interface rule."""
    return two_layers(water, air, request.param)


def test_velocities_beside_an_interface_are_those_of_the_fluid_there(water):
    """Oil slides over water, each with its own velocity up to the interface, at which particles are the water's."""
    oil = tp.Fluid("oil", 850.0, 1e-3)
    tank = tp.tank((0.4, 0.4), 0.02, periodic="x").fill(oil, velocity=(0.02, 0.0))
    tank.fill(water, box=((0, 0), (0.4, 0.2)), velocity=(-0.02, 0.0))
    simulation = tp.Simulation(tp.Case(tank, [water, oil], (0, -G)), time_step=1e-3)
    line = tpp.LineProbe(name="l", start=(0.2, 0.197), end=(0.2, 0.203), count=2, quantities=("velocity_x",))
    for _ in range(2):
        below, above = values(line, simulation).values()
        assert [below, above] == pytest.approx([-0.02, 0.02], abs=1e-4)
        simulation.step()


def values(probe, simulation):
    return dict(zip([name for name, _ in probe.columns(simulation.case)], probe.sample(simulation), strict=True))


def test_forces_of_fluids_at_rest_are_hydrostatic(balanced, water, air):
    top = air.density * G * 0.2  # at the interface, above zero at the lid
    by_water = top * 0.2 + water.density * G * 0.2**2 / 2
    by_air = air.density * G * 0.2**2 / 2
    left = values(tpp.WallForce(name="f", wall="left"), balanced)
    assert left["pressure_force_x"] == pytest.approx(-(by_water + by_air), rel=1e-9)
    assert abs(left["pressure_force_y"]) < 1e-9
    right = values(tpp.WallForce(name="f", wall="right", fluid="water"), balanced)
    assert right["pressure_force_x"] == pytest.approx(by_water, rel=1e-9)
    # Of a pressure that is linear down to the floor: moment about the bottom, of water and of air apart.
    arm_water = top * 0.2**2 / 2 + water.density * G * 0.2**3 / 6
    arm_air = by_air * (0.2 + 0.2 / 3)
    assert left["moment"] == pytest.approx(arm_water + arm_air, rel=1e-9)
    bottom = values(tpp.WallForce(name="f", wall="bottom", about=(0.2, 0.0)), balanced)
    assert bottom["pressure_force_y"] == pytest.approx(-(top + water.density * G * 0.2) * 0.4, rel=1e-9)
    assert abs(bottom["moment"]) < 1e-6
    fluids = [values(tpp.WallForce(name="f", wall="left", fluid=name), balanced) for name in ("water", "air")]
    for key, total in left.items():
        assert sum(part[key] for part in fluids) == pytest.approx(total, rel=1e-12, abs=1e-12)


def test_parts_by_fluid_add_up_where_the_interface_cuts_cells(layers):
    whole = values(tpp.WallForce(name="f", wall="left"), layers)
    parts = [values(tpp.WallForce(name="f", wall="left", fluid=name), layers) for name in ("water", "air")]
    for key, total in whole.items():
        assert sum(part[key] for part in parts) == pytest.approx(total, rel=1e-12, abs=1e-12)


def test_pressures_between_particles_are_hydrostatic(balanced, water, air):

    def exact(y):
        return air.density * G * min(0.4 - y, 0.2) + water.density * G * max(0.2 - y, 0.0)

    for y in (0.0, 0.0331, 0.197, 0.2, 0.2043, 0.39):
        wall = values(tpp.WallPressure(name="w", wall="right", at=(0.4, y)), balanced)["pressure"]
        point = values(tpp.PointProbe(name="p", at=(0.1234, y)), balanced)["pressure"]
        assert wall == pytest.approx(exact(y), abs=1e-9 * exact(0.0))
        assert point == pytest.approx(exact(y), abs=1e-9 * exact(0.0))
    line = tpp.LineProbe(name="l", start=(0.1, 0.0), end=(0.1, 0.4), count=9, quantities=("pressure", "density"))
    row = np.array(line.sample(balanced)).reshape(9, 2)
    np.testing.assert_allclose(row[:, 0], [exact(y) for y in np.linspace(0, 0.4, 9)], atol=1e-9 * exact(0.0))
    assert row[1, 1] == water.density
    assert row[7, 1] == air.density


def test_a_linear_velocity_is_found_between_particles(layers):
    particles = layers.particles
    particles.velocity[:] = particles.position @ np.array([[1.0, 2.0], [3.0, -1.0]])
    at = np.array([0.111, 0.307])
    found = values(tpp.PointProbe(name="p", at=at, quantities=("velocity_x", "velocity_y")), layers)
    expected = at @ np.array([[1.0, 2.0], [3.0, -1.0]])
    np.testing.assert_allclose(list(found.values()), expected, rtol=1e-10)


def test_heights_fronts_volumes_and_energies(layers, water, air):
    gauge = values(tpp.WaveGauge(name="g", x=0.13, fluid="water"), layers)
    sharp = layers.case.interface == "sharp"
    assert gauge["height"] == pytest.approx(0.2, abs=1e-9 if sharp else 0.02)
    assert gauge["depth"] == pytest.approx(gauge["height"], abs=1e-9)
    front = values(tpp.FrontProbe(name="f", fluid="water", axis=1), layers)["front"]
    assert front == pytest.approx(0.2, abs=1e-9 if sharp else 0.02)
    assert values(tpp.VolumeProbe(name="v", fluid="air"), layers)["volume"] == layers.volume("air")
    assert values(tpp.EnergyProbe(name="e"), layers)["potential_energy"] == layers.energy().potential


def test_fronts_have_two_ends_and_a_wide_gauge_the_mean_level(water, air):
    tank = tp.tank((0.4, 0.4), 0.02).fill(air).fill(water, box=((0, 0), (0.4, 0.1)))
    tank.fill(water, box=((0, 0), (0.1, 0.2)))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -G)))
    assert values(tpp.FrontProbe(name="f", fluid="air", axis=1, end="lower"), simulation)["front"] == pytest.approx(0.1)
    assert values(tpp.FrontProbe(name="f", fluid="water", end="lower"), simulation)["front"] == 0.0
    # Half of the strip is in the tank, and a quarter of that is beyond the step.
    wide = values(tpp.WaveGauge(name="g", x=0.0, fluid="water", width=0.24), simulation)
    corner = simulation.volume("water") - 0.05  # the mesh cuts corners of the step
    assert corner == pytest.approx(0.0, abs=4e-4)
    assert wide["depth"] == pytest.approx((0.1 * 0.2 + 0.02 * 0.1) / 0.12, abs=4e-4 / 0.12)
    assert wide["depth"] == pytest.approx(
        values(tpp.VolumeProbe(name="v", fluid="water", box=((0, 0), (0.12, 0.4))), simulation)["volume"] / 0.12
    )


@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
def test_boxes_share_the_volume_of_a_fluid(water, air, interface):
    tank = tp.tank((0.4, 0.4), 0.02, jitter=0.2).fill(air).fill(water, box=((0, 0), (0.23, 0.17)))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -G), interface=interface))
    x, y = [0.0, 0.071, 0.2, 0.233, 0.4], [0.0, 0.05, 0.163, 0.4]
    parts = [
        values(tpp.VolumeProbe(name="v", fluid="water", box=((x[i], y[j]), (x[i + 1], y[j + 1]))), simulation)["volume"]
        for i in range(4)
        for j in range(3)
    ]
    assert sum(parts) == pytest.approx(simulation.volume("water"), rel=1e-12)
    assert parts[0] == pytest.approx(0.071 * 0.05, rel=1e-12)
    outside = tpp.VolumeProbe(name="v", fluid="water", box=((1.0, 1.0), (2.0, 2.0)))
    assert values(outside, simulation)["volume"] == 0.0


@pytest.mark.parametrize("periodic", [None, "x"])
def test_the_amplitudes_of_waves_are_those_of_their_theory(water, air, periodic):
    length = 0.4
    k = (2 if periodic else 1) * 3 * math.pi / length

    def surface(x):
        return 0.2 + 0.01 * np.cos(k * x) + (0.02 * np.sin(k * x) if periodic else 0.0)

    tank = tp.tank((length, 0.4), 0.01, periodic=periodic).fill(air).fill(water, box=((0, 0), (length, 0.2)))
    case = tp.Case(tank, [water, air], (0, -G))
    simulation = tp.Simulation(case)
    position = simulation.particles.position
    lifted = surface(position[:, 0]) - 0.2
    height = position[:, 1]
    position[:, 1] += lifted * np.where(height < 0.2, height / 0.2, (0.4 - height) / 0.2)
    moved = simulation.mesh.moved(position)
    simulation.state = dataclasses.replace(simulation.state, mesh=moved)
    for fluid, sign in (("water", 1), ("air", -1)):
        found = values(tpp.WaveProbe(name="w", fluid=fluid, number=3), simulation)
        expected = sign * np.array([0.01, 0.02] if periodic else [0.01])
        np.testing.assert_allclose(list(found.values()), expected, rtol=0.02)
        none = values(tpp.WaveProbe(name="w", fluid=fluid, number=2), simulation)
        np.testing.assert_allclose(list(none.values()), 0.0, atol=1e-5)


def test_the_height_is_that_of_the_highest_piece_and_the_depth_counts_only_fluid(water, air):
    tank = tp.tank((0.4, 0.4), 0.02).fill(air).fill(water, box=((0, 0), (0.4, 0.1)))
    tank.fill(water, box=((0.1, 0.2), (0.3, 0.3)))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -G)))
    gauge = values(tpp.WaveGauge(name="g", x=0.2, fluid="water"), simulation)
    assert gauge["height"] == pytest.approx(0.3, abs=1e-9)
    assert gauge["depth"] == pytest.approx(0.2, abs=1e-9)
    beside = values(tpp.WaveGauge(name="g", x=0.05, fluid="water"), simulation)
    assert beside["height"] == pytest.approx(0.1, abs=1e-9)
    with pytest.raises(ValueError, match="does not cross"):
        surface_height(simulation.mesh, simulation.particles.fluid, 0, 0.5)


def test_above_a_free_surface_there_is_nothing_to_measure(water):
    tank = tp.tank((0.4, 0.4), 0.02).fill(water, box=((0, 0), (0.4, 0.2)))
    simulation = tp.Simulation(tp.Case(tank, [water], (0, -G), free_surface=True), time_step=1e-3)
    simulation.step()
    assert math.isnan(values(tpp.PointProbe(name="p", at=(0.2, 0.3)), simulation)["pressure"])
    assert values(tpp.WallPressure(name="w", wall="left", at=(0.0, 0.3)), simulation)["pressure"] == 0.0
    force = values(tpp.WallForce(name="f", wall="left"), simulation)["pressure_force_x"]
    assert force == pytest.approx(-water.density * G * 0.2**2 / 2, rel=1e-9)


def test_a_place_of_the_tank_moves_with_it(water, air):
    tank = tp.tank((0.4, 0.4), 0.02).fill(air).fill(water, box=((0, 0), (0.4, 0.2)))
    motion = tp.Motion(translation=lambda t: (2.0 * t**2, 0.0), angle=lambda t: t**2, pivot=(0.2, 0.0))
    case = tp.Case(tank, [water, air], (0, -G), tank_motion=motion)
    corner = tpp.PointProbe(name="p", at=(0.0, 0.0), frame="tank")
    wall = tpp.WallPressure(name="w", wall="left", at=(0.0, 0.0))
    force = tpp.WallForce(name="f", wall="bottom")
    simulation = tp.Simulation(case, time_step=2e-3)
    for _ in range(20):
        simulation.step()
    pose = motion.pose(simulation.time, 1e-3, 2)
    nearest = np.argmin(((simulation.particles.position - pose.place(np.zeros((1, 2)))) ** 2).sum(axis=1))
    expected = simulation.particles.pressure[nearest]
    assert corner.sample(simulation)[0] == pytest.approx(expected, rel=1e-6)
    assert wall.sample(simulation)[0] == pytest.approx(expected, rel=1e-6)
    assert len(wall_line(force, case, "bottom").faces(case, simulation)[0]) == 20


def test_a_wave_gauge_on_a_wall_of_a_tank_that_moves(water, air):
    """Heights along the wall are those of the highest water particle on it, although the wall sways and rolls."""
    tank = tp.tank((0.4, 0.4), 0.02).fill(air).fill(water, box=((0, 0), (0.4, 0.2)))
    motion = tp.Motion(translation=lambda t: (2.0 * t**2, 0.0), angle=lambda t: t**2, pivot=(0.2, 0.0))
    for wall in ("left", "right"):
        tank.wall(wall, slip=True)
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -G), tank_motion=motion), time_step=5e-3)
    for _ in range(30):
        simulation.step()
    mesh, pose = simulation.mesh, motion.pose(simulation.time, 1e-3, 2)
    own = pose.origin(simulation.particles.position)
    wet = np.zeros(len(own), bool)
    wet[mesh.cells[mesh.fluid == 0]] = True
    for x, change in ((0.0, 0.01), (0.4, -0.01)):
        found = values(tp.WaveGauge(name="g", x=x, fluid="water", frame="tank"), simulation)
        on_wall = wet & (abs(own[:, 0] - x) < 1e-9)
        assert found["height"] == pytest.approx(own[on_wall, 1].max(), abs=1e-8)
        assert found["depth"] == pytest.approx(found["height"], abs=1e-8)
        assert (found["height"] - 0.2) * np.sign(change) > abs(change)
    still = values(tp.WaveGauge(name="g", x=0.0, fluid="water"), simulation)
    assert math.isnan(still["height"])  # the tank has left this place


def test_named_walls_and_those_that_move(water, air):
    tank = tp.tank((0.4, 0.4), 0.02).fill(air).fill(water, box=((0, 0), (0.4, 0.2)))
    tank.wall("left", motion=lambda t: 0.5 * t**2, slip=True).wall("right", motion=lambda t: -0.5 * t**2, slip=True)
    tank.wall("bottom", slip=True).wall("top", slip=True)
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -G)), time_step=2e-3)
    for _ in range(30):
        simulation.step()
    force = tpp.WallForce(name="f", wall="left")
    a, b, _ = wall_line(force, simulation.case, "left").faces(simulation.case, simulation)
    assert np.abs(simulation.mesh.sides(a, b)).sum() == pytest.approx(0.4, rel=1e-6)  # the whole wall, where it is now
    assert simulation.particles.position[a, 0] == pytest.approx(0.5 * simulation.time**2, abs=1e-9)
    assert force.sample(simulation)[0] < 0
    assert len(b)


def layers_in_a_shape(water, air, *, slip=False):
    """The layers over an inclined side and around a square hole, with a round side on the right, at rest."""
    corners = [(0, 0), (0.2, 0.05), (0.5, 0.05), tp.shapes.arc((0.5, 0.25)), (0.5, 0.45), (0, 0.45)]
    hole = tp.shapes.rectangle((0.2, 0.17), (0.3, 0.33), names=["under", "east", "above", "west"])
    shape = tp.shapes.polygon(corners, names=["slope", "floor", "round", "lid", "west wall"], holes=[hole])
    tank = tp.tank(shape=shape, spacing=0.02).fill(air).fill(water, box=((-1, -1), (1, 0.25)))
    tank.wall("round", slip=slip)
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -G)), time_step=1e-3)
    simulation.step()
    return simulation


def test_sides_of_shapes_and_of_holes_bear_hydrostatic_forces(water, air):
    simulation = layers_in_a_shape(water, air)

    def force(side):
        found = values(tpp.WallForce(name="f", wall=side), simulation)
        return np.array([found["pressure_force_x"], found["pressure_force_y"]])

    middle = air.density * G * 0.2  # pressure at the interface
    deep = middle + water.density * G * 0.2
    # Linear along each side: length times the normal out of the fluid times the mean.
    exact = {
        "slope": 0.5 * (deep + middle + water.density * G * 0.25) * np.array([0.05, -0.2]),
        "floor": deep * np.array([0.0, -0.3]),
        "under": (middle + water.density * G * 0.08) * np.array([0.0, 0.1]),
        "above": air.density * G * 0.12 * np.array([0.0, -0.1]),
        "lid": np.zeros(2),
    }
    for side, expected in exact.items():
        np.testing.assert_allclose(force(side), expected, rtol=1e-9, atol=1e-9 * deep)
    # The four sides of the hole: the weight of what it displaces.
    lift = sum(force(side) for side in ("under", "east", "above", "west"))
    np.testing.assert_allclose(lift, [0, G * 0.1 * 0.08 * (water.density + air.density)], rtol=1e-9, atol=1e-7)
    # All walls together: the weight of the fluids.
    volumes = simulation.volume("water") * water.density + simulation.volume("air") * air.density
    total = lift + sum(force(side) for side in ("slope", "floor", "round", "lid", "west wall"))
    np.testing.assert_allclose(total, [0, -G * volumes], rtol=1e-9, atol=1e-7)


def test_pressures_at_places_of_sides_are_hydrostatic(water, air):
    simulation = layers_in_a_shape(water, air, slip=True)

    def exact(y):
        return air.density * G * min(0.45 - y, 0.2) + water.density * G * max(0.25 - y, 0.0)

    for side, at in (("slope", (0.1, 0.025)), ("west", (0.2, 0.193)), ("above", (0.271, 0.33)), ("slope", (0.2, 0.05))):
        found = values(tpp.WallPressure(name="w", wall=side, at=at), simulation)["pressure"]
        assert found == pytest.approx(exact(at[1]), abs=1e-9 * exact(0.0))
    # On an arc the fluid ends at the chords between its particles, a distance of h^2 / (8 R) off.
    at = 0.5 + 0.2 * math.cos(0.7), 0.25 - 0.2 * math.sin(0.7)
    found = values(tpp.WallPressure(name="w", wall="round", at=at), simulation)["pressure"]
    assert found == pytest.approx(exact(at[1]), abs=water.density * G * 0.02**2 / (8 * 0.2))


def test_walls_that_a_shape_does_not_have_are_refused(water, air):
    case = layers_in_a_shape(water, air).case
    with pytest.raises(ValueError, match=r"there is no wall 'left' in this case; it has \['slope', .*'under'\]"):
        tpp.WallForce(name="f", wall="left").columns(case)
    with pytest.raises(ValueError, match=r"at is \[0.1, 0.1\] m, which is not on the wall 'slope', from"):
        tpp.WallPressure(name="f", wall="slope", at=(0.1, 0.1)).columns(case)
    tank = tp.tank(shape=[(0, 0), (0.4, 0), (0.4, 0.4), (0, 0.4)], spacing=0.02).fill(water)
    tank.add(tp.Body(tp.shapes.circle((0.2, 0.2), 0.08), name="disc"))
    with pytest.raises(ValueError, match="'disc' is a body; the force of the fluids on it is in the history"):
        tpp.WallForce(name="f", wall="disc").columns(tp.Case(tank, [water], (0, -G)))


def test_the_recorder_samples_at_the_interval_and_writes_what_it_keeps(layers, tmp_path):
    every = tpp.VolumeProbe(name="all", fluid="water")
    some = tpp.PointProbe(name="some", at=(0.1, 0.1), interval=0.25)
    recorder = tpp.ProbeRecorder([every, some], layers.case)
    recorder.write_to(ResultsFolder(tmp_path))
    for time in (0.0, 0.1, 0.2, 0.25, 0.3, 0.6, 0.7, 0.75):
        layers.state = dataclasses.replace(layers.state, time=time)
        recorder.after_step(layers, GeneralizedAlpha(0.0, 0.1))
    assert recorder["all"]["time"].tolist() == [0.0, 0.1, 0.2, 0.25, 0.3, 0.6, 0.7, 0.75]
    assert recorder["some"]["time"].tolist() == [0.0, 0.25, 0.6, 0.75]
    lines = (tmp_path / "probes" / "some.csv").read_text().splitlines()
    assert lines[0] == "time [s],pressure [Pa]"
    assert [float(line.split(",")[1]) for line in lines[1:]] == recorder["some"]["pressure"].tolist()
    with pytest.raises(KeyError, match="there is no probe 'none'"):
        recorder["none"]


@pytest.mark.parametrize(
    ("probe", "message"),
    [
        (lambda: tpp.PointProbe(name="p", at=(0.5, 0.1)), r"at is \[0.5, 0.1\] m, which lies outside of the tank"),
        (lambda: tpp.PointProbe(name="p", at=(0.5,)), "at is .* it must be a list of 2 or 3 numbers in m"),
        (lambda: tpp.PointProbe(name="p", at=(0.1, 0.1, 0.1)), "it must be 2 coordinates"),
        (lambda: tpp.PointProbe(name="p", at="corner"), "at is 'corner'"),
        (lambda: tpp.PointProbe(name="p", at=(0.1, math.nan)), "it must be a list of 2 or 3 numbers"),
        (lambda: tpp.PointProbe(name="p", at=(0.1, 0.1), quantities=("pressur",)), "some of .*pressure"),
        (lambda: tpp.PointProbe(name="p", at=(0.1, 0.1), quantities="pressure"), "it must be a list"),
        (lambda: tpp.PointProbe(name="p", at=(0.1, 0.1), quantities=("velocity_z",)), "velocity_z"),
        (lambda: tpp.PointProbe(name="p", at=(0.1, 0.1), frame="moon"), "frame is 'moon'"),
        (lambda: tpp.LineProbe(name="p", start=(0, 0), end=(0.1, 0.1), count=1), "count is 1"),
        (lambda: tpp.LineProbe(name="p", start=(0, 0), end=(9, 0.1), count=3), "outside of the tank"),
        (lambda: tpp.WaveGauge(name="p", x=0.7, fluid="water"), "x is 0.7 m; it must lie between 0 and 0.4"),
        (lambda: tpp.WaveGauge(name="p", x=0.1, fluid="water", frame="moon"), "frame is 'moon'"),
        (lambda: tpp.WaveGauge(name="p", x=0.1, fluid="oil"), "there is no fluid 'oil'"),
        (lambda: tpp.FrontProbe(name="p", fluid="water", axis=2), "axis is 2"),
        (lambda: tpp.FrontProbe(name="p", fluid="water", end="left"), "end is 'left'"),
        (lambda: tpp.VolumeProbe(name="p", fluid="oil"), "there is no fluid 'oil'"),
        (lambda: tpp.VolumeProbe(name="p", fluid="water", box=((0.2, 0.2), (0.1, 0.3))), "to the lower left"),
        (lambda: tpp.VolumeProbe(name="p", fluid="water", box=((0, 0, 0), (1, 1, 1))), "it must be 2 coordinates"),
        (lambda: tpp.WaveProbe(name="p", fluid="water", number=0), "number is 0"),
        (lambda: tpp.WaveGauge(name="p", x=0.1, fluid="water", width=-1), "width is -1"),
        (lambda: tpp.WallPressure(name="p", wall="door", at=(0, 0)), "there is no wall 'door'.*'left'"),
        (lambda: tpp.WallPressure(name="p", wall="left", at=(0.1, 0.1)), "is not on the wall 'left', from"),
        (lambda: tpp.WallForce(name="p", wall="left", fluid="oil"), "there is no fluid 'oil'"),
        (lambda: tpp.WallForce(name="p", wall="left", about=(1,)), "about is"),
    ],
)
def test_what_does_not_fit_the_case_is_refused(balanced, probe, message):
    with pytest.raises(ValueError, match=message):
        tpp.ProbeRecorder([probe()], balanced.case)


def test_what_fits_no_case_is_refused(layers):
    for name in ("", "a/b", ".hidden", 3):
        with pytest.raises(ValueError, match="it names a file"):
            tpp.EnergyProbe(name=name)
    for interval in (0, -1.0, "1", math.nan):
        with pytest.raises(ValueError, match="interval"):
            tpp.EnergyProbe(name="e", interval=interval)
    probe = tpp.EnergyProbe(name="e")
    with pytest.raises(ValueError, match="a name of its own"):
        tpp.ProbeRecorder([probe, dataclasses.replace(probe, interval=1.0)], layers.case)
    with pytest.raises(ValueError, match="list of probes"):
        tpp.ProbeRecorder(["pressure"], layers.case)
    with pytest.raises(ValueError, match="FrontProbe 'front'; it must be a list of probes"):
        tpp.ProbeRecorder(tpp.FrontProbe(name="front", fluid="water"), layers.case)

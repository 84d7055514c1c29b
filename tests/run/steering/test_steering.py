"""tipfem/run/steering: what commands do to the flow and its budgets, and that a steered run is repeated to the bit."""

from __future__ import annotations

import json
import math
import shutil

import numpy as np
import pytest

import tipfem as tp
from tipfem.run.steering import FILE, Advance, Go, Pause, RunControl, Stop, command_from, read_records

GRAVITY = (0.0, -9.81)


def layers(kind, spacing=0.05, height=0.3):
    """Oil on water in a unit tank; with a free surface water alone, below empty space."""
    water = tp.Fluid("water", density=1000.0, viscosity=1.0)
    oil = tp.Fluid("oil", density=800.0, viscosity=2.0)
    if kind == "free surface":
        tank = tp.tank((1.0, 1.0), spacing).fill(water, box=((0, 0), (1.0, height)))
        return tp.Case(tank, [water], GRAVITY, free_surface=True)
    tank = tp.tank((1.0, 1.0), spacing).fill(oil).fill(water, box=((0, 0), (1.0, height)))
    return tp.Case(tank, [water, oil], GRAVITY, interface=kind)


def same_histories(one, other):
    """Whether two histories are equal to the bit, except for wall-clock times."""
    return [{**row, "wall_seconds": 0} for row in one] == [{**row, "wall_seconds": 0} for row in other]


def steered(simulation, until=0.3):
    """Run with a tilt, a poke and a drop at some steps."""
    fluid = simulation.case.fluids[0].name
    while simulation.time < until:
        number = simulation.step_number
        if number == 0:
            simulation.steer(tp.Gravity((2.0, -9.6)))
        if number == 4:
            simulation.steer(tp.Poke((0.5, 0.2), (30.0, 40.0), 0.2, duration=0.05))
        if number == 8:
            simulation.steer(tp.Drop((0.5, 0.7), 0.12, fluid))
        if number == 12:
            simulation.steer(tp.Poke((0.3, 0.2), (-20.0, 0.0), 0.2))
        if number == 14:
            simulation.steer(tp.Viscosity(fluid, 5.0))
        if number == 16:
            simulation.steer(tp.Release())
        simulation.step(until)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sharp", "interpolated", "free surface"])
def test_a_steered_run_is_repeated_to_the_bit(tmp_path, kind):
    first = tp.Simulation(layers(kind), tmp_path / "first", time_step=0.01)
    steered(first)
    first.results.close()
    file = tmp_path / "first" / FILE
    assert [json.loads(line)["step"] for line in file.read_text().splitlines()] == [0, 4, 8, 12, 14, 16]
    # Neither the results folder nor the time of its first fields makes a difference.
    again = tp.Simulation(layers(kind), time_step=0.01, steering=file)
    assert len(again.steering.pending) == 6
    while again.time < 0.3:
        again.step(0.3)
    assert not again.steering.pending
    assert same_histories(first.history, again.history)
    assert again.particles.position.tobytes() == first.particles.position.tobytes()
    # and the commands do make one.
    free = tp.Simulation(layers(kind), time_step=0.01)
    while free.time < 0.3:
        free.step(0.3)
    assert not same_histories(first.history, free.history)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sharp", "free surface"])
def test_a_steered_run_goes_on_from_a_checkpoint_to_the_bit(tmp_path, kind):
    """Gravity and the poke that acts are in the checkpoint; commands after it are repeated from the file."""

    def commands(simulation):
        given = {
            3: tp.Gravity((2.0, -9.6)),
            6: tp.Poke((0.5, 0.2), (30.0, 40.0), 0.2, duration=0.2),
            9: tp.Drop((0.5, 0.7), 0.12, "water"),
            18: tp.Gravity((-2.0, -9.6)),
        }
        return given.get(simulation.step_number)

    whole = tp.Simulation(layers(kind), tmp_path / "whole", time_step=0.01)
    for _ in range(25):
        if command := commands(whole):
            whole.steer(command)
        whole.step()
    whole.results.close()
    part = tp.Simulation(layers(kind), tmp_path / "part", time_step=0.01)
    for _ in range(20):  # killed after step 20, with a checkpoint of step 12
        if command := commands(part):
            part.steer(command)
        part.step()
        if part.step_number == 12:
            part.write_checkpoint(1.0)
    part.results.close()
    rest = tp.Simulation.resume(tmp_path / "part", layers(kind))
    assert (rest.step_number, rest.forces.gravity) == (12, (2.0, -9.6))
    assert rest.forces.pokes(rest.time)
    while rest.step_number < 25:
        rest.step()
    rest.results.close()
    assert same_histories(whole.history, rest.history)
    lines = [(tmp_path / name / FILE).read_text() for name in ("whole", "part")]
    assert lines[0] == lines[1]


@pytest.mark.parametrize("kind", ["sharp", "interpolated", "free surface"])
def test_the_work_of_a_poke_closes_the_balance_of_energy(kind):
    simulation = tp.Simulation(layers(kind), time_step=0.01)
    for _ in range(3):
        simulation.step()
    simulation.steer(tp.Poke((0.5, 0.15), (40.0, 0.0), 0.25, duration=0.1))
    free, end = len(simulation.history), simulation.time + 0.1
    while simulation.time < end + 0.03:
        simulation.step()
    rows = simulation.history[free:]
    work = [row["external_work"] for row in rows]
    assert sum(work) > 1.0  # J/m; a force of 40 m/s^2 on some 100 kg/m over millimetres
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-4 * sum(work)
    late = [row["external_work"] for row in rows if row["time"] - row["time_step"] > end - 1e-9]
    assert late
    # Nothing after its time, but for what Newton's tolerance leaves of the friction at walls of the law "layer".
    assert max(map(abs, late)) < 1e-6 * sum(work)


def test_a_poke_is_the_body_force_that_it_says():
    """A case with the same body force gives the same steps."""
    poke = tp.Poke((0.5, 0.15), (4.0, 3.0), 0.25)
    simulation = tp.Simulation(layers("sharp"), time_step=0.01)
    case = layers("sharp")

    def force(x, t):
        s = ((x - np.array(poke.at)) ** 2).sum(axis=1) / poke.radius**2
        return np.where(s < 1, (1 - s) ** 2, 0.0)[:, None] * np.array(poke.acceleration)

    case.body_force = force
    twin = tp.Simulation(case, time_step=0.01)
    simulation.step()
    simulation.steer(poke)
    twin.state, twin.control = simulation.state, simulation.control
    simulation.step()
    twin.control = type(twin.control)(0.01, **case.step_control)
    twin.step()
    np.testing.assert_allclose(twin.particles.velocity, simulation.particles.velocity, atol=1e-12)


@pytest.mark.slow
def test_a_tilted_tank_comes_to_rest_with_a_tilted_surface():
    """tan of the surface's slope is that of gravity: viscous fluids at rest after a while."""
    water = tp.Fluid("water", density=1000.0, viscosity=20.0)
    oil = tp.Fluid("oil", density=800.0, viscosity=20.0)
    tank = tp.tank((1.0, 1.0), 0.07).fill(oil).fill(water, box=((0, 0), (1.0, 0.5)))
    for name in ("left", "right", "bottom", "top"):
        tank.wall(name, slip=True)
    simulation = tp.Simulation(tp.Case(tank, [water, oil], GRAVITY), time_step=0.05)
    simulation.steer(tp.Gravity((9.81 * math.sin(0.2), -9.81 * math.cos(0.2))))
    while simulation.time < 12.0:
        simulation.step(12.0)
    x, fluid, cells = simulation.particles.position, simulation.mesh.fluid, simulation.mesh.cells
    on = np.intersect1d(cells[fluid == 0], cells[fluid == 1])
    slope = np.polyfit(*x[on].T, 1)[0]
    assert slope == pytest.approx(math.tan(0.2), rel=0.1)
    assert simulation.volume("water") == pytest.approx(0.5, rel=1e-6)


@pytest.mark.slow(but=("interpolated",))
@pytest.mark.parametrize("kind", ["sharp", "interpolated"])
def test_a_drop_takes_its_volume_from_the_fluid_around_it(kind):
    simulation = tp.Simulation(layers(kind), time_step=0.01)
    for _ in range(3):
        simulation.step()
    before = simulation.volume("water"), simulation.volume("oil")
    simulation.steer(tp.Drop((0.5, 0.7), 0.15, "water"))
    got = simulation.volume("water") - before[0]
    # Interpolated, the drop is three spacings and what the rule gives it of the mixed elements around it.
    assert got == pytest.approx(math.pi * 0.15**2, rel=0.03 if kind == "sharp" else 0.15)
    assert simulation.volume("oil") - before[1] == pytest.approx(-got, rel=1e-9)
    effect = simulation.steering.applied[0].effect
    assert effect["volume_water"] == pytest.approx(got)
    rise = 200 * got * 9.81 * 0.7  # 200 kg/m^3 more at the height of 0.7 m
    assert effect["potential_energy"] == pytest.approx(rise, rel=0.03)
    for _ in range(30):
        simulation.step()
    assert simulation.volume("water") == pytest.approx(before[0] + got, rel=2e-3)
    assert max(abs(row["energy_residual"]) for row in simulation.history) < 1e-3
    heavy = simulation.particles.fluid == 0
    drop = heavy & ~simulation.particles.wall & (simulation.particles.position[:, 1] > 0.45)
    assert drop.sum() > 10
    assert simulation.particles.velocity[drop, 1].mean() < -0.05  # it sinks


def test_the_outline_of_a_drop_is_on_its_circle():
    simulation = tp.Simulation(layers("sharp", spacing=0.04))
    simulation.steer(tp.Drop((0.5, 0.65), 0.2, "water"))
    mesh = simulation.mesh
    middle = mesh.position[mesh.cells].mean(axis=1)
    inside = (mesh.fluid == 0) & (middle[:, 1] > 0.4)
    outline = np.intersect1d(mesh.cells[inside], mesh.cells[mesh.fluid == 1])
    distance = np.linalg.norm(mesh.position[outline] - (0.5, 0.65), axis=1)
    assert np.abs(distance - 0.2).max() < 0.25 * 0.04
    assert np.mean(np.abs(distance - 0.2) < 1e-9) > 0.9
    assert mesh.measure.min() > 0


@pytest.mark.slow
def test_a_drop_in_empty_space_falls_freely_until_it_lands():
    simulation = tp.Simulation(layers("free surface"), time_step=0.005)
    for _ in range(3):
        simulation.step()
    before, start, count = simulation.volume("water"), simulation.time, len(simulation.particles)
    simulation.steer(tp.Drop((0.5, 0.75), 0.12, "water"))
    got = simulation.volume("water") - before
    assert got == pytest.approx(math.pi * 0.12**2, rel=0.06)
    added = np.arange(count, len(simulation.particles))
    height = simulation.particles.position[added, 1].mean()
    simulation.step()
    while simulation.time - start < 0.2:
        simulation.step(start + 0.2)
    fallen = height - simulation.particles.position[added, 1].mean()
    assert fallen == pytest.approx(0.5 * 9.81 * 0.2**2, rel=0.05)
    while simulation.time < 0.8:
        simulation.step(0.8)
    height = simulation.particles.position[~simulation.particles.wall, 1]
    assert (height > 0.7).sum() <= 3  # landed, but for splashes
    assert simulation.volume("water") == pytest.approx(before + got, rel=0.03)
    assert abs(simulation.numerical_error()["volume_water"]) < 0.03


@pytest.mark.parametrize(
    ("kind", "at", "fluid", "message"),
    [
        ("sharp", (0.5, 0.9), "water", "too close to a wall"),
        ("sharp", (0.5, 0.3), "water", "there is water nearby already"),
        ("sharp", (0.5, 0.7), "oil", "inside the same fluid"),
        ("interpolated", (0.5, 0.35), "oil", "there is oil nearby already"),
        ("free surface", (0.5, 0.35), "water", "too close to the fluids"),
        ("free surface", (0.9, 0.7), "water", "too close to a wall"),
        ("free surface", (0.5, 0.2), "water", "free surface"),
        ("sharp", (0.5, 1.2), "water", "must lie between"),
        ("sharp", (0.5, 0.7, 0.1), "water", "must be 2 numbers"),
        ("sharp", (0.5, 0.7), "milk", "one of"),
    ],
)
def test_a_drop_without_room_is_refused_and_changes_nothing(tmp_path, kind, at, fluid, message):
    simulation = tp.Simulation(layers(kind), tmp_path)
    simulation.make_consistent()
    state = simulation.state
    with pytest.raises(ValueError, match=message):
        simulation.steer(tp.Drop(at, 0.12, fluid))
    assert simulation.state is state
    assert not (tmp_path / FILE).exists()
    assert not simulation.steering.applied


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("gravity", {"value": [0, -99]}, "at most 98"),
        ("gravity", {"value": [0, float("nan")]}, "2 or 3 numbers"),
        ("gravity", {}, "value is missing"),
        ("gravity", {"value": "down"}, "2 or 3 numbers"),
        ("poke", {"at": [0, 0], "acceleration": [1, 1], "radius": 0}, "radius is 0"),
        ("poke", {"at": [0, 0], "acceleration": [1, 1], "radius": 0.1, "duration": -1}, "duration is -1"),
        ("poke", {"at": [0, 0], "acceleration": [100, 0], "radius": 0.1}, "of magnitude 100"),
        ("poke", {"at": [0, 0], "force": [1, 0]}, "there is no 'force'"),
        ("drop", {"at": [0, 0], "radius": 1, "fluid": 3}, "fluid is 3; it must be a non-empty string"),
        ("step", {"count": 0}, "whole number"),
        ("explode", {}, "one of gravity"),
    ],
)
def test_commands_with_impossible_values_are_refused(name, values, message):
    with pytest.raises(ValueError, match=message):
        command_from(name, values)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"step": 3, "command": "gravity", "value": [0, -1]}\nnonsense\n', "line 2: 'nonsense' is not JSON"),
        ('{"step": -1, "command": "gravity", "value": [0, -1]}\n', "line 1: step is -1"),
        ('{"step": 3, "command": "pause"}\n', "does not change the physics"),
        ('{"step": 3, "command": "poke", "at": null}\n{"step": 2, "command": "poke", "at": null}\n', "before the 3"),
    ],
)
def test_mistakes_in_a_steering_file_are_named_by_their_line(tmp_path, text, message):
    file = tmp_path / "steering.jsonl"
    file.write_text(text)
    with pytest.raises(ValueError, match=message):
        tp.Simulation(layers("sharp"), tmp_path / "out", steering=file)
    assert not (tmp_path / "out").exists()


def test_a_line_that_a_killed_run_left_unfinished_is_left_out(tmp_path):
    file = tmp_path / "steering.jsonl"
    file.write_text('{"step": 3, "command": "gravity", "value": [0, -1]}\n{"step": 5, "comm')
    assert [record.step for record in read_records(file)] == [3]


def test_a_run_pauses_takes_single_steps_goes_on_and_stops_with_a_checkpoint(tmp_path):
    simulation = tp.Simulation(layers("sharp"), tmp_path, time_step=0.01)
    script = iter([[Pause()], [Advance(2)], [], [], [tp.Gravity((1.0, -9.0))], [Go()], [], [], [Stop()]])
    seen = []

    def receive(wait):
        seen.append((simulation.step_number, wait > 0))
        return next(script)

    simulation.run(1.0, progress=False, control=RunControl(receive))
    # Nothing is computed while paused, two steps when told, and three more until the end.
    assert seen == [
        (0, False),
        (0, True),
        (1, False),
        (2, True),
        (2, True),
        (2, True),
        (3, False),
        (4, False),
        (5, False),
    ]
    assert simulation.step_number == 5
    assert json.loads((tmp_path / "summary.json").read_text())["status"] == "stopped by a command"
    rest = tp.Simulation.resume(tmp_path, layers("sharp"))
    assert (rest.step_number, rest.until, rest.forces.gravity) == (5, 1.0, (1.0, -9.0))


def test_a_refused_command_is_reported_and_the_run_goes_on():
    simulation, said = tp.Simulation(layers("sharp"), time_step=0.01), []
    script = iter([[tp.Drop((0.5, 0.95), 0.12, "water")], [], [Stop()]])
    simulation.run(1.0, progress=False, control=RunControl(lambda _: next(script), report=said.append))
    assert simulation.step_number == 2
    assert len(said) == 1
    assert "too close to a wall" in said[0]


def test_space_that_a_wall_divides_from_the_fluids_takes_no_drop():
    """A chamber of wall particles in the empty part of a tank."""
    case = layers("free surface")
    angle = np.arange(0, 2 * math.pi, 0.045 / 0.25)
    ring = np.array([0.5, 0.65]) + 0.25 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    before = case.particles
    particles = tp.Particles(
        np.concatenate([before.position, ring]),
        np.concatenate([before.fluid, np.full(len(ring), -1)]),
        np.concatenate([before.wall, np.ones(len(ring), dtype=bool)]),
        spacing=before.spacing,
    )
    simulation = tp.Simulation(tp.Case(particles, case.fluids, GRAVITY, free_surface=True))
    with pytest.raises(ValueError, match="outside the walls"):
        simulation.steer(tp.Drop((0.5, 0.65), 0.1, "water"))


@pytest.mark.parametrize("kind", ["sharp", "interpolated"])
def test_a_viscosity_holds_from_then_on_and_is_taken_back(kind):
    """In the present elements and in those of later meshes; a fluid a hundred times as viscous is slower."""
    speeds = []
    for value in (1.0, 100.0):
        simulation = tp.Simulation(layers(kind), time_step=0.01)
        simulation.steer(tp.Gravity((5.0, -8.4)))
        before = simulation.kept()
        simulation.steer(tp.Viscosity("water", value))
        simulation.run(0.15, progress=False)
        assert simulation.state.material.viscosity.max() == max(value, 2.0)
        speeds.append(simulation.energy().kinetic)
        simulation.go_back(before)
        simulation.step()
        assert simulation.state.material.viscosity.max() == 2.0
    assert speeds[1] < 0.5 * speeds[0]


def test_a_viscosity_is_refused_where_it_would_not_hold():
    simulation = tp.Simulation(layers("sharp"), time_step=0.01)
    with pytest.raises(ValueError, match="fluid is 'mercury'; it must be one of"):
        simulation.steer(tp.Viscosity("mercury", 1.0))
    with pytest.raises(ValueError, match="viscosity: value"):
        tp.Viscosity("water", -1.0)
    case = layers("sharp")
    held = tp.Case(case.tank, case.fluids, GRAVITY, surface_tension={("water", "oil"): 0.05})
    with pytest.raises(ValueError, match="slide along each other by the viscosities of the case"):
        tp.Simulation(held, time_step=1e-3).steer(tp.Viscosity("water", 2.0))


def walled(law="slides"):
    """Layers between walls of which one moves: the floor along itself, or a piston under a free surface."""
    water, oil = tp.Fluid("water", density=1000.0, viscosity=20.0), tp.Fluid("oil", density=800.0, viscosity=20.0)
    tank = tp.tank((1.0, 0.7), spacing=0.1 if law == "slides" else 0.05)
    if law == "slides":
        tank.fill(oil).wall("bottom", velocity=0.0)
    else:
        tank.wall("left", motion=lambda t: 0.0)
    tank.fill(water, box=((0.0, 0.0), (1.0, 0.3)))
    return tp.Case(tank, [water, oil] if law == "slides" else [water], GRAVITY, free_surface=law != "slides")


@pytest.mark.slow
@pytest.mark.parametrize(("law", "wall", "value"), [("slides", "bottom", 0.5), ("pushes", "left", 0.15)])
def test_a_wall_that_moves_takes_the_fluid_along_and_goes_on_from_a_checkpoint(tmp_path, law, wall, value):
    """Its place or speed is reached at the end of the ramp; its work is in the budget; a resumed run is the same."""
    simulation = tp.Simulation(walled(law), tmp_path / "run", time_step=0.01)
    simulation.run(0.05, progress=False)
    simulation.steer(tp.MoveWall(wall, value, ramp=0.2))
    simulation.run(0.15, progress=False)
    shutil.copytree(tmp_path / "run", tmp_path / "part")
    simulation.run(0.3, progress=False)
    moved = next(each for each in simulation.state.boundary.walls if each.name == wall)
    there = moved.speed(0.3) if law == "slides" else moved.displacement(0.3)
    assert there == pytest.approx(value, rel=1e-12)
    if law == "pushes":
        p = simulation.particles
        assert p.position[p.wall][:, 0].min() == pytest.approx(value, abs=1e-9)
    assert simulation.volume("water") == pytest.approx(0.3, rel=1e-9)
    given = sum(row["external_work"] for row in simulation.history)
    assert given > 0.1
    assert max(abs(row["energy_residual"]) for row in simulation.history) < 1e-6 * given
    resumed = tp.Simulation.resume(tmp_path / "part", case=walled(law))
    resumed.run(0.3, progress=False)
    np.testing.assert_array_equal(resumed.particles.position, simulation.particles.position)
    again = tp.Simulation(walled(law), time_step=0.01, steering=tmp_path / "run" / "steering.jsonl")
    again.run(0.3, progress=False)
    np.testing.assert_allclose(again.particles.position, simulation.particles.position, atol=1e-9)


def test_walls_that_do_not_move_are_not_moved():
    with pytest.raises(ValueError, match="wall is 'left'; it must be one that moves: bottom"):
        tp.Simulation(walled()).steer(tp.MoveWall("left", 0.5))
    with pytest.raises(ValueError, match="a wall needs a velocity, which may be 0, or a motion in the case"):
        tp.Simulation(layers("sharp")).steer(tp.MoveWall("left", 0.5))
    with pytest.raises(ValueError, match="wall: ramp is 0"):
        tp.MoveWall("left", 0.5, ramp=0.0)


@pytest.mark.parametrize("given", ["pause", None, {"name": "gravity"}, Pause()])
def test_what_is_no_command_to_the_physics_is_refused(given):
    simulation = tp.Simulation(layers("sharp", 0.1))
    with pytest.raises(ValueError, match=r"it must be one such as tp\.Gravity|is no command to the physics"):
        simulation.steer(given)


def test_a_line_that_is_nested_too_deeply_is_refused(tmp_path):
    (tmp_path / FILE).write_text("[" * 100_000 + "\n\n")
    with pytest.raises(ValueError, match=r"line 1: .* is not JSON"):
        read_records(tmp_path / FILE)

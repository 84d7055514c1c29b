"""Times of a run that differ by round-off: no step is solved between them, whoever asks for them."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-3)
AIR = tp.Fluid("air", 1.2, 1.8e-5)
END = 0.06


def filling():
    """Water that an inlet with a ramp lets in below air, with coarse particles."""
    tank = tp.tank((0.4, 0.4), 0.05).fill(AIR).fill(WATER, box=((0, 0), (0.4, 0.15)))
    openings = [
        tp.Inlet(wall="bottom", between=((0.1, 0), (0.3, 0)), fluid=WATER, velocity=0.05, ramp=0.01, name="in"),
        tp.Vent(wall="top", between=((0.1, 0.4), (0.3, 0.4))),
    ]
    return tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings)


def entered(time):
    """What the inlet has let in [m^2]."""
    return 0.05 * 0.2 * (time - 0.005)


@pytest.mark.slow(but=("None-0.007",))
@pytest.mark.parametrize("every", [0.0025, 0.01 / 3, 0.007])
@pytest.mark.parametrize("output", [None, 0.02, 0.01 / 3])
def test_a_loop_of_one_s_own_takes_no_sliver_of_a_step(tmp_path, every, output):
    """With outputs and probes at multiples that its times miss by round-off."""
    probe = tp.OpeningProbe(name="in", opening="in", fluid="water", interval=0.005)
    simulation = tp.Simulation(
        filling(), tmp_path, output_interval=output, checkpoint_interval=0.01, probes=[probe], time_step=4e-3
    )
    while simulation.time < END:
        simulation.run(until=simulation.time + every, progress=False)
    steps = [row["time_step"] for row in simulation.history]
    assert min(steps) > 2e-4  # 0.007 s is so far from the next third of 0.02 s
    assert math.fsum(steps) == pytest.approx(simulation.time, rel=1e-12)
    assert sum(row["through_in_water"] for row in simulation.history) == pytest.approx(entered(simulation.time))
    assert simulation.probes["in"]["volume"][-1] == pytest.approx(entered(simulation.probes["in"]["time"][-1]))
    times = np.asarray(tp.read_results(tmp_path).times)
    if output is not None:
        for k in range(math.floor(END / output + 1e-9) + 1):
            assert np.abs(times - k * output).min() < 1e-9


@pytest.mark.slow
def test_a_time_within_round_off_is_reached_without_a_step(tmp_path):
    simulation = tp.Simulation(filling(), tmp_path / "run", time_step=4e-3)
    simulation.run(until=0.02, progress=False)
    place, number = simulation.particles.position.copy(), simulation.step_number
    for method in (lambda to: simulation.run(to, progress=False), simulation.step, lambda to: [*simulation.steps(to)]):
        later = math.nextafter(simulation.time, 1)
        method(later)
        assert (simulation.time, simulation.step_number) == (later, number)
        np.testing.assert_array_equal(simulation.particles.position, place)
    later = simulation.time + 0.9 * simulation.instant
    simulation.run(later, progress=False)
    assert (simulation.time, simulation.step_number) == (later, number)
    # A run goes on from there, and so does one from its checkpoint, to the bit.
    shutil.copytree(tmp_path / "run", tmp_path / "part")
    simulation.run(0.04, progress=False)
    resumed = tp.Simulation.resume(tmp_path / "part")
    assert resumed.time == later
    resumed.run(0.04, progress=False)
    np.testing.assert_array_equal(resumed.particles.position, simulation.particles.position)
    assert simulation.particles.max_speed < 0.2
    assert len(tp.read_results(tmp_path / "run").history["time"]) == simulation.step_number


def test_commands_and_a_first_instant_need_no_step(tmp_path):
    """A command at such a time acts from the next step on and is repeated there; a run that ends at once has none."""
    simulation = tp.Simulation(filling(), tmp_path, time_step=4e-3)
    simulation.run(until=1e-12, progress=False)
    assert (simulation.time, simulation.history) == (1e-12, [])
    simulation.run(until=0.02, progress=False)
    simulation.steer(tp.Discharge("in", 0.02))
    simulation.run(until=math.nextafter(simulation.time, 1), progress=False)
    simulation.run(until=0.04, progress=False)
    again = tp.Simulation(filling(), time_step=4e-3, steering=tmp_path / "steering.jsonl")
    for until in (1e-12, 0.02, 0.04):
        again.run(until=until, progress=False)
    np.testing.assert_allclose(again.particles.position, simulation.particles.position, atol=1e-12)
    assert simulation.history[-1]["through_in_water"] == pytest.approx(0.02 * simulation.history[-1]["time_step"])


def test_a_wall_that_moves_is_as_smooth_after_such_a_time():
    tank = tp.tank((0.4, 0.2), 0.05).fill(WATER, box=((0, 0), (0.4, 0.1)))
    for side in ("right", "top", "bottom"):
        tank.wall(side, slip=True)
    tank.wall("left", slip=True, motion=lambda t: 0.01 * (1 - math.cos(20 * t)))
    case = tp.Case(tank, [WATER], (0, -9.81), free_surface=True)
    speeds = []
    for times in ((0.02, 0.04), (0.02, math.nextafter(0.02, 1), 0.02 + 1e-9, 0.04)):
        simulation = tp.Simulation(case, time_step=4e-3)
        for until in times:
            simulation.run(until, progress=False)
        speeds.append(simulation.particles.max_speed)
    assert speeds[1] == pytest.approx(speeds[0], rel=1e-6)

"""Beaches: how fast they damp, their energy, momentum and checkpoints, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-3)
AIR = tp.Fluid("air", 1.2, 1.8e-5)


def standing(side=0.2, across=10, **options):
    """A standing wave of water under air, half a cosine across a tank."""
    tank = tp.tank((side, side), side / across).fill(AIR)
    tank.fill(WATER, where=lambda x: x[:, 1] < side / 2 + 0.005 * np.cos(math.pi * x[:, 0] / side))
    for wall in tank.sides:
        tank.wall(wall, slip=True)
    numerics = tp.Numerics(newton_tolerance=1e-10)
    return tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), numerics=numerics, **options), time_step=5e-3)


@pytest.mark.slow
def test_the_same_damping_everywhere_lets_waves_decay_as_theory_says():
    """With c everywhere the amplitude of a wave falls as exp(-c t / 2)."""
    c, ends = 1.5, []
    period = 2 * math.pi / math.sqrt(9.81 * math.pi / 0.2 * math.tanh(math.pi / 2))
    for damped in (False, True):
        # So far from its wall's end that the rate is the same in all of the tank.
        beaches = [tp.Beach(wall="right", length=1e4, period=2 * math.pi, strength=c)] if damped else []
        simulation = standing(beaches=beaches)
        start = simulation.energy()
        while simulation.time < period:
            simulation.step(period)
        ends.append(simulation.energy().potential - start.potential + 0.25 * 998.8 * 9.81 * 0.2 * 0.005**2)
        rows = simulation.history
        largest = max(row["kinetic_energy"] for row in rows)
        assert max(abs(row["energy_residual"]) for row in rows) < 1e-8 * largest
        assert max(row["newton_iterations"] for row in rows) <= 5
        assert all(("beach_dissipation" in row) is damped for row in rows)
    taken = sum(row["beach_dissipation"] for row in rows)
    assert ends[1] / ends[0] == pytest.approx(math.exp(-c * period), rel=0.03)
    assert taken > 0.5 * (ends[0] - ends[1])
    assert min(row["beach_dissipation"] for row in rows) >= 0


def wave_tank(*bodies, air=True):
    """A piston and a beach in water of 0.12 m, and a vent in the air above."""
    tank = tp.tank((0.8, 0.24), 0.02)
    tank = (tank.fill(AIR) if air else tank).fill(WATER, box=((0, 0), (0.8, 0.12)))
    for body in bodies:
        tank.add(body)
    for side in ("right", "top", "bottom"):
        tank.wall(side, slip=True)
    tank.wall("left", slip=True, motion=tp.WavePiston(height=0.02, period=0.6, depth=0.12, ramp=0.5))
    vent = tp.Vent(wall="top", between=((0.3, 0.24), (0.44, 0.24)))
    beach = tp.Beach(wall="right", length=0.4, period=0.6)
    numerics = tp.Numerics(newton_tolerance=1e-9)
    if not air:
        return tp.Case(tank, [WATER], (0, -9.81), beaches=[beach], free_surface=True, numerics=numerics)
    return tp.Case(tank, [WATER, AIR], (0, -9.81), openings=[vent], beaches=[beach], numerics=numerics)


@pytest.mark.slow
@pytest.mark.parametrize("air", [True, False], ids=["under air", "free surface"])
def test_a_wave_tank_with_a_float_and_a_beach_closes_its_accounts(air):
    box = tp.Body([(0.3, 0.08), (0.4, 0.08), (0.4, 0.14), (0.3, 0.14)], name="float", density=600.0)
    simulation = tp.Simulation(wave_tank(box, air=air), time_step=5e-3)
    while simulation.time < 0.5:
        simulation.step(0.5)
    rows = simulation.history
    work = sum(abs(row["external_work"]) for row in rows)
    assert sum(abs(row["energy_residual"]) for row in rows) < 1e-9 * work
    assert max(abs(row["momentum_residual_y"]) for row in rows) < 1e-8  # along x the piston's is prescribed
    assert sum(row["beach_dissipation"] for row in rows) > 0
    assert simulation.state.volume_error < 1e-12
    assert np.ptp([row["float_y"] for row in rows]) > 1e-4
    assert sum(row["refused_steps"] for row in rows) == 0


def test_a_wave_tank_goes_on_from_its_own_record_to_the_bit(tmp_path):
    whole = tp.Simulation(wave_tank(), time_step=5e-3)
    for _ in range(20):
        whole.step()
    parted = tp.Simulation(wave_tank(), tmp_path, time_step=5e-3)
    for _ in range(12):
        parted.step()
    parted.write_checkpoint(1.0)
    resumed = tp.Simulation.resume(tmp_path)
    for _ in range(8):
        resumed.step()
    for name in ("position", "velocity", "pressure"):
        assert np.array_equal(getattr(whole.particles, name), getattr(resumed.particles, name)), name
    assert whole.history[-1]["beach_dissipation"] == resumed.history[-1]["beach_dissipation"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"beaches": [tp.Beach(wall="front", length=0.1, period=1.0)]}, "wall is 'front'; the tank has left, right"),
        ({"beaches": "right"}, "beaches is 'right'; it must be a list of Beach"),
        (
            {"beaches": [tp.Beach(wall="left", length=1, period=1)], "tank_motion": tp.Motion(angle=lambda t: 0 * t)},
            "tank_motion is given; beaches are for tanks in 2-D that stand still",
        ),
        ({"beaches": 2 * [tp.Beach(wall="left", length=0.1, period=1.0)]}, "wall is 'left', which has a beach already"),
    ],
)
def test_a_case_refuses(options, message):
    with pytest.raises(ValueError, match=message):
        standing(**options)


def test_a_beach_refuses():
    with pytest.raises(ValueError, match="length is 0 m; it must be a number > 0 in m"):
        tp.Beach(wall="right", length=0, period=1.0)

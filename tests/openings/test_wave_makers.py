"""Waves by height and period, and pistons in tanks with a vent."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-3)
AIR = tp.Fluid("air", 1.2, 1.8e-5)


def test_a_piston_has_the_stroke_of_shallow_and_of_deep_water():
    shallow = tp.WavePiston(height=1e-4, period=20.0, depth=0.1)
    assert shallow.length == pytest.approx(20.0 * math.sqrt(9.81 * 0.1), rel=1e-3)
    assert shallow.height / shallow.stroke == pytest.approx(shallow.number * 0.1, rel=1e-3)
    deep = tp.WavePiston(height=0.01, period=0.5, depth=2.0)
    assert deep.length == pytest.approx(9.81 * 0.25 / (2 * math.pi), rel=1e-6)
    assert deep.height / deep.stroke == pytest.approx(2.0, rel=1e-4)


def test_a_piston_begins_smoothly_and_is_of_its_period():
    piston = tp.WavePiston(height=0.03, period=1.0, depth=0.2)
    assert piston(0.0) == 0.0
    assert abs(piston(0.01)) < 1e-5
    assert piston(2.7) == pytest.approx(piston(3.7), rel=1e-9)
    first = tp.WavePiston(height=0.03, period=1.0, depth=0.2, order=1)
    assert first(2.25) == pytest.approx(0.5 * first.stroke)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"height": 0.3}, "waves of that period and depth break above"),
        ({"height": -1.0}, "height is -1.0 m; it must be a number > 0 in m"),
        ({"order": 3}, "order is 3; it must be a whole number from 1 to 2"),
    ],
)
def test_impossible_waves_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        tp.WavePiston(**{"height": 0.03, "period": 1.0, "depth": 0.2, **options})


@pytest.mark.parametrize(("spectrum", "peak"), [("jonswap", 3.3), ("pierson-moskowitz", 1.0)])
def test_irregular_waves_have_their_spectrum(spectrum, peak):
    waves = tp.IrregularWaves(height=0.03, period=1.2, depth=0.4, spectrum=spectrum, components=400)
    amplitude, omega, _ = waves.waves
    assert 4 * math.sqrt(0.5 * (amplitude**2).sum()) == pytest.approx(0.03)
    frequency = omega * 1.2 / (2 * math.pi)
    # The spectrum of Pierson and Moskowitz, f^-5 exp(-5/4 f^-4), times the enhancement at the peak.
    bare = frequency**-5 * np.exp(-1.25 * frequency**-4)
    ratio = amplitude**2 / bare
    assert ratio[np.abs(frequency - 1) < 0.005].max() / ratio[-1] == pytest.approx(peak, rel=0.02)
    again, other = (tp.IrregularWaves(height=0.03, period=1.2, depth=0.4, seed=seed) for seed in (1, 2))
    first = tp.IrregularWaves(height=0.03, period=1.2, depth=0.4)
    assert first(7.3) == again(7.3) != other(7.3)
    assert first(0.0) == 0.0
    # Each wave has the stroke of its own frequency.
    steady = np.array([waves.steady(t) for t in np.arange(0, 600, 0.11)])
    pistons = [
        tp.WavePiston(height=2 * a, period=2 * math.pi / w, depth=0.4) for a, w in zip(amplitude, omega, strict=True)
    ]
    expected = math.sqrt(0.5 * sum((0.5 * piston.stroke) ** 2 for piston in pistons))
    assert steady.std() == pytest.approx(expected, rel=0.05)


def test_a_piston_drives_air_out_of_a_vent():
    tank = tp.tank((0.6, 0.3), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.6, 0.16)))
    for side in ("right", "top", "bottom"):
        tank.wall(side, slip=True)
    piston = tp.WavePiston(height=0.02, period=0.6, depth=0.16, ramp=0.5)
    tank.wall("left", slip=True, motion=piston)
    vent = tp.Vent(wall="top", between=((0.3, 0.3), (0.44, 0.3)))
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), openings=[vent]), time_step=5e-3)
    while simulation.time < 0.3:
        simulation.step(0.3)
        out = -simulation.state.parts["openings"].total[0]
        assert out[0] == 0.0
        assert out[1] == pytest.approx(0.3 * piston(simulation.time), abs=1e-11)
        assert simulation.state.volume[0] == pytest.approx(0.6 * 0.16, rel=1e-11)
    assert max(-row["through_vent_top_air"] for row in simulation.history) > 1e-6

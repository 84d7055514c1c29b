"""Flows through openings against what is known of them, coarse."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import i1, iv, jv, k1
from tipfem.demos.validation.openings import channels, run, waves

import tipfem as tp


@pytest.mark.slow
def test_coarse_channels_are_near_theory():
    coarse, fine = (channels.poiseuille(across, end=0.5) for across in (8, 12))
    assert abs(fine["gradient"]) < 0.01
    assert math.log(coarse["velocity"] / fine["velocity"]) / math.log(12 / 8) > 1.9
    assert fine["refused"] == 0


@pytest.mark.slow
def test_the_command_leaves_figures_and_names_what_is_missed(tmp_path, capsys):
    assert run.main(flow=("uniform",), across=4, out=tmp_path) == 0
    figures = json.loads((tmp_path / "summary.json").read_text())["uniform"]
    assert figures["across"] == 4
    assert figures["velocity"] < 1e-9
    assert figures["refused"] == 0
    capsys.readouterr()


# Figures of the flows at coarse spacings, and what they may differ by: some are far from the references, which the demo
# asks for at finer ones. Those of water scatter by some percent with any change.
COARSE = [
    ("layers", 12, {"interface": (0.0, 0.02), "velocity": (0.0, 0.02)}, 0),
    ("vortex", 32, {"left": (0.0, 1e-4)}, 0),
    ("step", 6, {"reattachment": (2.922, 0.15)}, 0),
    ("cylinder", 10, {"drag": (5.58, 0.25)}, 0),
    ("overfall", 4, {"brink": (0.921, 0.03)}, 12),
    ("weir", 4, {"coefficient": (0.688, 0.03)}, 12),
    ("broad_weir", 4, {"coefficient": (0.838, 0.03)}, 15),
    ("bore", 4, {"depth": (0.95, 0.07)}, 30),
    ("waves", 5, {"height": (1.0, 0.03), "reflection": (0.0, 0.02)}, 3),
    ("plate", 4, {"transmission": (0.504, 0.03), "reflection": (0.88, 0.04)}, 3),
]


def behind_and_before(omega):
    """Linear theory of the plate in water of its depth: amplitudes at both gauges over that of waves that come to the
    plate, with the local waves beside it; the part that comes back; the wave number. Odd in x about the plate, the
    velocity below it is a series of Chebyshev polynomials with the root at its edge."""
    deep, gap, even = waves.DEEP, waves.DEEP - waves.DRAUGHT, 2 * np.arange(8)
    level = omega**2 / 9.81
    k = brentq(lambda k: k * math.tanh(k * deep) - level, 1e-6, level / math.tanh(level * deep) + 10)
    local = (np.arange(300) + 0.5) * math.pi / deep
    for length in math.pi / deep * 0.5 ** np.arange(2, 50):  # between the pole of the tangent and its zero
        local += length * (level + (local + length) * np.tan((local + length) * deep) < 0)
    moving, still = iv(even, k * gap), (-1.0) ** (even // 2)[:, None] * jv(even[:, None], local * gap)
    norm = 1 + math.sinh(2 * k * deep) / (2 * k * deep), 1 + np.sin(2 * local * deep) / (2 * local * deep)
    series = np.linalg.solve(
        (still / (local * norm[1])) @ still.T - np.outer(moving, moving) / (1j * k * norm[0]), -moving
    )
    back = 1 - series @ moving / (1j * k * norm[0])
    beside = waves.BESIDE[1] - waves.PLATE
    parts = (series @ still) / (local * norm[1]) * np.cos(local * deep) / math.cosh(k * deep) * np.exp(-local * beside)
    phase = np.exp(1j * k * beside)
    return (1 - back) * phase - parts.sum(), 1 / phase + back * phase + parts.sum(), back, k


def test_linear_theory_of_the_tank_with_a_plate_gives_what_ursell_does():
    """Its harmonics by spectra, of waves that the piston reflects, too: 0.7, 0.2 % off; in a tank of 0.4 wave lengths
    by 3.4 they were 0.60 and 0.71 for 0.54 and 0.84."""
    first = math.sqrt(9.81 * 2 * math.pi * math.tanh(2 * math.pi * waves.DEEP))
    period, count = 2 * math.pi / first, 1024
    time = np.arange(count) * period / 20
    moves = np.sin(first * time) * np.sin(np.pi * np.minimum(time / period / waves.GROUP, 1.0)) ** 2
    spectrum, omega = np.fft.rfft(moves), 2 * np.pi * np.fft.rfftfreq(count, period / 20)
    found = np.zeros((4, len(omega)), dtype=complex)
    for number in np.flatnonzero((omega > 0.2 * first) & (omega < 2.4 * first)):
        behind, before, back, k = behind_and_before(omega[number])
        depth, plate = 2 * k * waves.DEEP, np.exp(1j * k * waves.PLATE)
        comes = spectrum[number].conj() * 2 * (math.cosh(depth) - 1) / (math.sinh(depth) + depth)
        again = comes * plate * sum((back * plate**2) ** times for times in range(3))
        alone = [comes * np.exp(1j * k * x) for x in waves.BESIDE]
        found[:, number] = [again * before, again * behind, *alone]
    signals = np.fft.irfft(found.conj(), count)[:, time <= waves.RECORD * period]
    before, behind, comes, onwards = signals @ np.exp(1j * first * time[time <= waves.RECORD * period])
    kd = 2 * math.pi * waves.DRAUGHT
    both = math.hypot(math.pi * i1(kd), k1(kd))
    assert abs(behind / onwards) == pytest.approx(k1(kd) / both, rel=0.02)
    assert abs((before - comes) / comes) == pytest.approx(math.pi * i1(kd) / both, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "across", "expected", "refused"), COARSE, ids=[row[0] for row in COARSE])
def test_a_flow_stays_near_its_coarse_figures(name, across, expected, refused):
    found = run.STUDIES[name].run(across)
    for key, (value, within) in expected.items():
        assert found[key] == pytest.approx(value, abs=within), key
    assert found["refused"] <= refused


@pytest.mark.parametrize("name", run.STUDIES)
def test_the_check_of_a_flow_can_fail(name):
    good = {"expected": 0.65, "hager": 0.9, "passes": 0.54, "comes back": 0.84, "refused": 0.0}
    for key, compared in run.STUDIES[name].compared.items():
        good[key] = good[compared.value] if isinstance(compared.value, str) else compared.value
    assert run.check(name, good) == []
    for key in run.STUDIES[name].compared:
        assert len(run.check(name, {**good, key: math.nan})) == 1
        assert len(run.check(name, {**good, key: good[key] + 0.4})) == 1


def test_waves_that_come_back_are_told_from_those_that_go():
    number, omega = tp.WavePiston(height=1e-4, period=1.0, depth=waves.DEPTH).number, 2 * math.pi
    time, places = np.linspace(0, 4, 400, endpoint=False), np.array(waves.GAUGES)
    onwards = 0.01 * np.cos(omega * time[:, None] - number * places)
    back = 0.002 * np.cos(omega * time[:, None] + number * places + 0.7)
    found = waves.both_ways(time, onwards + back + 1e-3, waves.GAUGES, 1.0)
    assert found == pytest.approx((0.01, 0.002), rel=1e-9)

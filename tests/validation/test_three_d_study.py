"""The study of flows in three dimensions: its theory, and runs of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tipfem.demos.validation.three_d import run as study
from tipfem.demos.validation.three_d.theory import Wave, overturning

import tipfem as tp


@pytest.mark.parametrize("nu", [1e-6, 1e-2])
def test_the_modes_are_free_of_divergence_and_move_with_the_surface(nu):
    """By differences; on deep water with little viscosity the rate is Lamb's, -2 nu k^2."""
    wave, step = Wave((1.0, 0.8, 0.5), (1, 2), nu, 9.81), 1e-5
    x = np.random.default_rng(0).uniform(0.1, 0.4, (20, 3))
    slopes = []
    for k in range(3):
        way = step * np.eye(3)[k]
        slopes.append((wave.velocity(x + way, 1.0)[:, k] - wave.velocity(x - way, 1.0)[:, k]) / (2 * step))
    assert np.abs(np.sum(slopes, axis=0)).max() < 1e-6 * np.abs(slopes).max()
    top = np.column_stack([x[:, :2], np.full(20, 0.5)])
    np.testing.assert_allclose(wave.velocity(top, 1.0)[:, 2], -wave.rate().imag * wave.shape(top), rtol=1e-9)
    np.testing.assert_allclose(wave.velocity(x * [1, 1, 0], 1.0)[:, 2], 0.0, atol=1e-12)
    deep = Wave((1.0, 1.0, 5.0), (1, 1), 1e-6, 9.81)
    assert deep.rate().imag == pytest.approx(math.sqrt(9.81 * deep.k), rel=1e-6)
    assert -deep.rate().real == pytest.approx(2e-6 * deep.k**2, rel=0.01)


def test_without_viscosity_an_interface_overturns_by_its_densities():
    """n^2 = A g k; viscosity only takes from it."""
    rates = [overturning(3.0, 0.5, nu, 9.81) for nu in (1e-7, 1e-3, 1e-2, 1e-1)]
    assert rates[0] == pytest.approx(math.sqrt(0.5 * 9.81 * 3.0), rel=1e-3)
    assert rates == sorted(rates, reverse=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flow", "what"),
    [
        ("overturning", "10 across"),
        pytest.param("wave", "along both sides, 10 across", marks=pytest.mark.slow),
        pytest.param("wave", "viscous, along both, 10 across", marks=pytest.mark.slow),
        pytest.param("wave", "along one side, 20 across", marks=pytest.mark.slow),
        pytest.param("wave", "along both sides, 20 across", marks=pytest.mark.slow),
        pytest.param("wave", "viscous, along both, 20 across", marks=pytest.mark.slow),
        pytest.param("overturning", "20 across", marks=pytest.mark.slow),
        pytest.param("column", "8 across", marks=pytest.mark.slow),
        pytest.param("bubble", "16 across", marks=pytest.mark.slow),
        pytest.param("bubble", "without tension, 16 across", marks=pytest.mark.slow),
    ],
)
def test_it_agrees_with_what_is_known(flow, what):
    """Within the study's limits: at 20 across waves 1 %, damping 5 %, growth 3 %, fronts 2 %, bubbles 3 %."""
    tp.init()
    figures, (_, curves) = study.RUNS[flow][what]()
    assert not study.check(f"{flow}, {what}", figures)
    assert len(curves) > 1
    assert any(key in study.LARGEST for key in figures)

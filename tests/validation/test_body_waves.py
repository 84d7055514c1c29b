"""The linear theory that the study of bodies compares with: its limits, and wave makers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tipfem.demos.validation.bodies import waves


def test_the_force_on_a_heaving_cylinder_has_the_known_limits():
    # The added mass at high frequencies is that of the half cylinder's water; long waves have the height of the water
    # that the cylinder displaces: a damping of 8 / pi.
    assert waves.force_coefficient(10.0).real == pytest.approx(1.0, rel=0.01)
    assert abs(waves.force_coefficient(10.0).imag) < 1e-6
    assert waves.force_coefficient(0.02).imag == pytest.approx(8 / math.pi, rel=0.01)


def test_the_heave_starts_at_rest_with_the_acceleration_at_high_frequencies():
    time = np.linspace(0.0, 0.2, 5)
    # x'' = -2 rho g a x / (M + A), both pi / 2 rho a^2.
    np.testing.assert_allclose(waves.heave_response(time), 1 - time**2 / math.pi, atol=5e-4)
    assert abs(waves.heave_response(np.array([40.0]))[0]) < 5e-3


@pytest.mark.parametrize("kh", waves.WAVES)
def test_waves_in_the_tank_have_the_height_of_steady_ones_when_they_are_measured(kh):
    time = np.linspace(0.0, waves.wave_window(kh)[1], 1000)
    height = waves.wave_height(time, waves.tank_waves(kh, time), kh)
    assert height / waves.stroke(kh) == pytest.approx(waves.stroke_ratio(kh), rel=0.01)


def test_a_piston_in_shallow_water_makes_waves_of_its_own_flow():
    assert waves.stroke_ratio(0.01) == pytest.approx(0.01, rel=1e-4)  # H / S = k h
    assert waves.stroke_ratio(20.0) == pytest.approx(2.0, rel=1e-6)

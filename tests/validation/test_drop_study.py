"""The study of a free drop that is stretched."""

import numpy as np
import pytest
from tipfem.demos.validation.drop import run as study


@pytest.mark.parametrize("spin", [0.0, 0.5])
def test_the_ellipse_keeps_area_energy_and_angular_momentum(spin):
    """Of a disc in the coordinates X: kinetic energy to |F'|^2, angular momentum to F_1 x F'_1 + F_2 x F'_2."""

    def kept(time):
        f, rate, _ = study.ellipse(spin, time)
        return [np.linalg.det(f), (rate**2).sum(), (f[0] * rate[1] - f[1] * rate[0]).sum()]

    np.testing.assert_allclose(kept(1.0), kept(0.0), rtol=1e-9, atol=1e-9)
    assert study.ellipse(spin, 0.0)[2] == pytest.approx(1 - spin**2)


def test_the_stretching_ellipse_has_the_acceleration_of_its_pressure():
    """With w = 0, b = R^2 / a and a'' = 2 a'^2 b^2 / (a (a^2 + b^2))."""
    times = 0.5 + np.array([-1e-3, 0.0, 1e-3])
    a = np.array([study.ellipse(0.0, t)[0][0, 0] for t in times])
    rate = study.ellipse(0.0, 0.5)[1][0, 0]
    b = 1 / a[1]
    assert np.diff(a, 2)[0] / 1e-6 == pytest.approx(2 * rate**2 * b**2 / (a[1] * (a[1] ** 2 + b**2)), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("flow", list(study.TURNING))
def test_a_free_drop_becomes_the_ellipse(flow):
    """Its axes at second order; velocities, which turn rough as cells are stretched, at nearly the first."""
    results = {across: study.drop(across, study.TURNING[flow]) for across in (8, 16)}
    assert study.check(flow, results) == []
    assert abs(results[16]["axis"]) < 0.3 * abs(results[8]["axis"])
    assert results[16]["velocity"] < 0.65 * results[8]["velocity"]


def test_the_check_names_what_is_missed():
    good = dict.fromkeys(study.LARGEST, 0.0)
    assert study.check("turning", {8: {**good, "velocity": 0.1, "axis": 0.1}, 16: good}) == []
    assert "axis 2.0e-02" in study.check("turning", {16: {**good, "axis": -0.02}})[0]
    missed = study.check("turning", {8: {**good, "axis": 0.001}, 16: {**good, "axis": 0.002, "velocity": 0.0}})
    assert "axis at 16 not below that at 8" in missed[-1]

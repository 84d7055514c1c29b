"""The study of flows between periodic sides."""

import numpy as np
import pytest
from tipfem.demos.validation.periodic import run as study
from tipfem.demos.validation.periodic.stability import Shear, fastest


def test_the_stability_of_a_shear_layer_is_that_of_the_literature():
    """Without viscosity U tanh(y) grows fastest at k = 0.4449 with 0.1897 (Michalke 1964); Re = 1e5 is near to that."""
    tanh = np.tanh
    flow = Shear(8.0, (1.0, 1.0), 1e-5, tanh, lambda y: 1 - tanh(y) ** 2, lambda y: -2 * tanh(y) * (1 - tanh(y) ** 2))
    mode = fastest(flow, 0.4449)
    assert mode.growth == pytest.approx(0.1897, abs=1e-3)
    assert mode.speed.real == pytest.approx(0.0, abs=1e-6)


def test_the_check_names_what_is_missed():
    good = {"error": 0.02, "volume": 1e-15}
    assert study.check("shear", {3: good}) == []
    assert "growth is +9.0% off" in study.check("shear", {3: {**good, "error": 0.09}})[0]
    assert (
        "order 1.00"
        in study.check("taylor-green", {n: {"error": 1 / n, "momentum": 0.0, "volume": 0.0} for n in (10, 20)})[0]
    )
    assert "errors" in study.check("channel", {8: {"errors": [0.1, 0.0]}})[0]


@pytest.mark.slow
def test_two_fluids_roll_up_at_the_rate_of_viscous_theory():
    result = study.shear(3, 8.0)
    assert abs(result["error"]) < 0.05
    assert abs(result["speed"] / result["theory_speed"] - 1) < 0.05
    assert result["volume"] < 1e-12


@pytest.mark.slow
def test_a_vortex_that_passes_through_the_ends_is_of_second_order():
    results = {n: study.taylor_green(n) for n in study.RESOLUTIONS["taylor-green"]}
    assert study.check("taylor-green", results) == []

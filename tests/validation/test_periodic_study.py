"""The study of flows between periodic sides."""

import numpy as np
import pytest
from tipfem.demos.validation.periodic import box
from tipfem.demos.validation.periodic import run as study
from tipfem.demos.validation.periodic.stability import Shear, fastest


def test_the_stability_of_a_shear_layer_is_that_of_the_literature():
    """Without viscosity U tanh(y) grows fastest at k = 0.4449 with 0.1897 (Michalke 1964); Re = 1e5 is near to that."""
    tanh = np.tanh
    flow = Shear(8.0, (1.0, 1.0), 1e-5, tanh, lambda y: 1 - tanh(y) ** 2, lambda y: -2 * tanh(y) * (1 - tanh(y) ** 2))
    mode = fastest(flow, 0.4449)
    assert mode.growth == pytest.approx(0.1897, abs=1e-3)
    assert mode.speed.real == pytest.approx(0.0, abs=1e-6)


def test_gravity_and_tension_hold_an_interface():
    """Almost without viscosity, in a steady stream: a heavy fluid on a light one grows at the rate of theory."""
    along = lambda y: np.ones(len(y))  # noqa: E731
    none = lambda y: np.zeros(len(y))  # noqa: E731
    for gravity, tension in ((0.1, 0.0), (0.1, 0.1), (0.0, -0.1)):
        flow = Shear(3.0, (1.0, 3.0), 1e-4, along, none, none, gravity, tension)
        assert fastest(flow, 1.0).growth == pytest.approx(((2 * gravity - tension) / 4) ** 0.5, rel=0.02)


def test_the_check_names_what_is_missed():
    good = {"error": 0.02, "volume": 1e-15}
    assert study.check("shear", {3: good}) == []
    assert "growth is +9.0% off" in study.check("shear", {3: {**good, "error": 0.09}})[0]
    assert (
        "order 1.00"
        in study.check("taylor-green", {n: {"error": 1 / n, "momentum": 0.0, "volume": 0.0} for n in (10, 20)})[0]
    )
    assert "errors" in study.check("channel", {8: {"errors": [0.1, 0.0]}})[0]
    assert "errors" in study.check("channel", {8: {"errors": [0.0, float("nan")]}})[0]


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


@pytest.mark.slow
def test_the_spectral_solution_is_periodic_and_loses_energy():
    """Its values at points are periodic and those on the grid, and its energy falls."""
    x = np.random.default_rng(0).uniform(0, box.WIDTH, (20_000, 2))
    found, energy = box.spectral_layers()
    moved = box.at_points(found, x[:50] + [box.WIDTH, -2 * box.WIDTH])
    np.testing.assert_allclose(moved, box.at_points(found, x[:50]), atol=1e-9)
    grid = np.arange(box.MODES) * box.WIDTH / box.MODES
    points = np.stack([a.ravel() for a in np.meshgrid(grid[:8], grid[:8], indexing="ij")], axis=1)
    on_grid = np.fft.irfft2(found, (box.MODES, box.MODES))[:, :8, :8].reshape(2, -1).T
    np.testing.assert_allclose(box.at_points(found, points), on_grid, atol=1e-12)
    start = 0.5 * (box.layers(x) ** 2).sum(axis=1).mean() * box.WIDTH**2
    assert 0.7 * start < energy < start


@pytest.mark.slow
def test_vortices_in_a_box_without_walls_are_of_second_order():
    results = {n: box.vortex_box(n) for n in (16, 32)}
    assert results[16]["error"] / results[32]["error"] > 3.5
    assert abs(results[32]["decay"]) < 5e-3
    assert max(r["momentum"] for r in results.values()) < 1e-12


@pytest.mark.slow
def test_shear_layers_in_a_box_without_walls_are_of_second_order():
    results = {n: box.layer_box(n) for n in (32, 64, 96)}
    assert study.check("layer-box", results) == []

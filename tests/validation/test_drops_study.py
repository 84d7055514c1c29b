"""The study of flows with surface tension."""

import csv
import math

import numpy as np
import pytest
from tipfem.demos.validation.drops import at_rest, in_motion, theory
from tipfem.demos.validation.drops import run as study


@pytest.mark.slow
def test_sixteen_points_in_a_wavelength_give_a_capillary_wave_within_a_percent_of_its_first_amplitude():
    """0.7 %; Basilisk has 2.4 % at this resolution (its test capwave)."""
    assert study.check("wave", {"16 spacings": in_motion.wave(16)}) == []


@pytest.mark.slow
def test_a_heavy_fluid_stays_on_a_light_one_below_the_critical_wavelength():
    assert abs(in_motion.rayleigh_taylor(16)["wave_number"]) < 0.015


@pytest.mark.slow
def test_a_lens_of_oil_below_a_free_surface_has_neumanns_angles():
    figures = at_rest.lens("empty space", 6, 2.0)  # still on its way
    assert abs(figures["width"]) < 0.01
    assert max(abs(figures["upper"]), abs(figures["lower"])) < 3.5


@pytest.mark.slow
@pytest.mark.parametrize("flow", sorted(set(study.RUNS) - {"wave", "bubble", "rayleigh-taylor"}))
def test_the_coarsest_runs_are_as_expected(flow):
    name, measured = next(iter(study.RUNS[flow].items()))
    assert study.check(flow, {name: measured()}) == []


@pytest.mark.slow
def test_a_bubble_of_twenty_spacings_across_rises_as_in_the_benchmark():
    figures = in_motion.bubble(40)
    assert max(figures[name] for name in ("height", "circularity")) < 1e-3
    assert figures["velocity"] < 3e-3


def test_closed_forms_are_those_of_their_limits():
    time = np.linspace(0, 3, 50)
    np.testing.assert_allclose(theory.capillary_wave(time, 1.0, 1e-10, 2.0), np.cos(2 * time), atol=1e-3)
    assert theory.capillary_wave(np.zeros(1), 1.0, 0.1, 2.0)[0] == pytest.approx(1.0)
    assert theory.oscillation(2, 1.0, 1.0, 1.0, 1.0, 1e6) == pytest.approx(math.sqrt(3.0))  # n (n^2 - 1) / 2
    assert theory.sessile_radius(math.pi / 2, math.pi / 2) == pytest.approx(1.0)  # half a disc
    angle = math.radians(30)
    arc = (1 - math.sin(angle)) / math.cos(angle)  # the height of an arc between plates 2 m apart
    assert theory.meniscus(1.0, 1e3, angle) == pytest.approx(arc, rel=1e-5)
    assert theory.meniscus(1.0, 0.5, angle) < 0.9 * arc
    # Between plates far apart: y^2 = 2 a^2 (1 - sin(angle)).
    assert theory.meniscus(8.0, 1.0, angle) == pytest.approx(math.sqrt(2 * (1 - math.sin(angle))), rel=2e-3)
    assert theory.lens(1.0, 1.0, 1.0, 1.0)[1:] == pytest.approx([math.pi / 3] * 2)  # three equal tensions
    half, wide = theory.lens(1.0, 1.0, 1.0, 1.0)[0], 2 * math.pi / 3 - math.sin(2 * math.pi / 3)
    assert (half / math.sin(math.pi / 3)) ** 2 * wide == pytest.approx(1.0)  # two segments of one circle
    assert theory.largest_hanging_drop() == pytest.approx(2.715, abs=1e-3)
    assert theory.rayleigh_taylor(1.0, (3.0, 1.0), 2.0, 4.0) == 0.0
    bubble = theory.rising_bubble()
    assert bubble["circularity"].min() == pytest.approx(0.9013, abs=1e-4)
    assert bubble["velocity"].max() == pytest.approx(0.2417, abs=1e-4)


def test_the_check_names_what_is_missed_and_the_table_what_is_allowed(tmp_path):
    good = {"capillary_number": 1e-13, "volume": 0.0, "krylov_iterations": 3, "jump": 0.008}
    assert study.check("static", {"density ratio 1.0": good}) == []
    missed = study.check("static", {"density ratio 1.0": {**good, "capillary_number": math.nan}})
    assert missed == ["static, density ratio 1.0: capillary_number is nan, not 1e-10 at most"]
    coarse = {"height": 1.0, "velocity": 1.0, "circularity": 1.0, "krylov_iterations": 9}
    assert study.check("bubble", {"40 spacings": coarse}) == []
    assert "height is -0.02" in study.check("rise", {"4": {"height": -0.02}})[0]
    study.write_table(tmp_path / "drops.csv", {"static": {"density ratio 1.0": good}})
    rows = list(csv.DictReader((tmp_path / "drops.csv").open()))
    assert [row["allowed"] for row in rows] == ["1e-10", "1e-12", "30", ""]
    assert set(study.RUNS) == set(study.LARGEST)


def test_a_drop_of_eight_spacings_stays_at_rest():
    figures = at_rest.static(1000.0, 8, 20)
    assert study.check("static", {"density ratio 1000.0": figures}) == []
    assert figures["jump"] == pytest.approx(figures["jump_of_polygon"], abs=1e-6)

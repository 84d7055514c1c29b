"""The study of laws of viscosity: its closed forms, and short runs of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tipfem.demos.validation.rheology import run as rheology


@pytest.mark.parametrize("name", list(rheology.PLATES))
def test_the_exact_profiles_are_in_balance(name):
    """The stress of the law at the slope of the profile is that of the force, and the plug has none."""
    _, (yield_stress, consistency, index) = rheology.PLATES[name]
    y = np.linspace(0, rheology.HALF, 4001)
    u = rheology.profile(y, (yield_stress, consistency, index))
    assert u[-1] == 0
    rate, stress = np.maximum(-np.gradient(u, y), 0.0), rheology.DENSITY * rheology.FORCE * y
    yielded = stress > yield_stress + 0.01
    np.testing.assert_allclose(
        (yield_stress + consistency * rate**index)[yielded][1:-1], stress[yielded][1:-1], rtol=1e-3
    )
    assert not np.ptp(u[stress <= yield_stress])


@pytest.mark.slow
def test_mud_stops_where_its_weight_and_its_yield_stress_are_in_balance():
    """With 10 spacings in the height, where the study has 12."""
    figures, shape = rheology.slump(10, end=0.7)
    assert abs(figures["length"]) < 0.05
    assert figures["shape"] < 0.05
    assert figures["speed"] < 2 * rheology.HEIGHT / rheology.MUD.viscosity.regularisation
    assert len(shape) > 10


@pytest.mark.slow
def test_grains_run_as_far_as_those_computed_one_by_one():
    """With 8 spacings in the height, where the study has 12; a law of more friction runs a third less far."""
    figures, shape = rheology.column(8, *rheology.COLUMNS[0])
    assert rheology.check("column", figures) == []
    assert figures["over_height_99"] == pytest.approx(rheology.COLUMNS[0][2][1] * (1 + figures["reach_99"]))
    assert shape[:, 1].max() < 1.1 * rheology.COLUMNS[0][1]
    beads, _ = rheology.beads(8)
    assert rheology.check("beads", beads) == []
    assert 1.0 < beads["over_height"] < 1.8


def test_the_checks_can_fail():
    assert rheology.check("x", {"profile": 0.005, "length": -0.02, "speed": 3.0}) == []
    found = rheology.check("x", {"profile": 0.02, "length": -0.04, "creep": 1e-3, "reach_99": math.nan})
    assert [line.split(" ")[1] for line in found] == ["profile", "length", "creep", "reach_99"]

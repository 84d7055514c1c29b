"""Columns of a history that would have one name are refused before the particles are meshed."""

from __future__ import annotations

import pytest

import tipfem as tp
from tipfem.remesh.remeshers import FittedRemesher
from tipfem.results.history_columns import require_apart

WATER = tp.Fluid("water", 1000.0, 1e-3)
OIL = tp.Fluid("b_water", 900.0, 1e-3)


def bodies(*names):
    tank = tp.tank((1.0, 0.8), 0.05).fill(OIL).fill(WATER, box=((0, 0), (1, 0.4)))
    for name, left in zip(names, (0.2, 0.6), strict=True):
        tank.add(tp.Body(tp.shapes.rectangle((left, 0.3), (left + 0.2, 0.5)), name=name, density=500.0))
    return tp.Case(tank, [WATER, OIL], (0, -9.81))


def openings(one, other):
    tank = tp.tank((0.4, 0.3), 0.02).fill(OIL).fill(WATER, box=((0, 0), (0.4, 0.15)))
    there = [
        tp.Inlet(wall="left", between=((0, 0), (0, 0.1)), fluid=WATER, discharge=0.05, name=one),
        tp.Vent(wall="top", between=((0.1, 0.3), (0.3, 0.3)), name=other),
    ]
    return tp.Case(tank, [WATER, OIL], (0, -9.81), openings=there)


def moving_tank():
    tank = tp.tank((1.0, 0.8), 0.05).fill(WATER, box=((0, 0), (1, 0.4)))
    tank.add(tp.Body(tp.shapes.rectangle((0.2, 0.3), (0.4, 0.5)), name="tank", density=500.0))
    return tp.Case(tank, [WATER], (0, -9.81), free_surface=True, tank_motion=tp.Motion(angle=lambda t: 0.0 * t))


@pytest.mark.parametrize(
    ("case", "name", "owners"),
    [
        (lambda: bodies("momentum", "q"), "momentum_x", "one of every history and one of bodies"),
        (lambda: bodies("remeshing_momentum", "q"), "remeshing_momentum_x", "one of every history and one of bodies"),
        (lambda: bodies("p", "p_velocity"), "p_velocity_x", "two of bodies"),
        (lambda: openings("a_b", "a"), "through_a_b_water", "two of openings"),
        (moving_tank, "tank_x", "one of the tank and one of bodies"),
    ],
)
def test_names_that_would_make_two_columns_one_are_refused(case, name, owners, monkeypatch):
    made = case()
    monkeypatch.setattr(FittedRemesher, "start", None)  # nothing is meshed
    with pytest.raises(ValueError, match=f"two columns of the history would be '{name}', {owners}; rename one of them"):
        tp.Simulation(made)


@pytest.mark.parametrize("case", [lambda: bodies("p", "q"), lambda: openings("in", "out")])
def test_each_column_that_was_announced_is_in_the_history(case):
    simulation = tp.Simulation(case(), time_step=2e-3)
    simulation.step()
    assert set(simulation.balance_columns) < set(simulation.history[-1])
    assert len(set(simulation.balance_columns)) == len(simulation.balance_columns)


def test_a_column_of_one_s_own_cannot_have_the_name_of_the_tank_s():
    tank = tp.tank((1.0, 0.8), 0.05).fill(WATER, box=((0, 0), (1, 0.4)))
    case = tp.Case(tank, [WATER], (0, -9.81), free_surface=True, tank_motion=tp.Motion(angle=lambda t: 0.0 * t))
    with pytest.raises(ValueError, match="'tank_angle' is a column of every history; choose another name"):
        tp.Simulation(case, columns={"tank_angle": lambda _: 0.0})


def test_a_name_of_two_owners_is_refused():
    require_apart({"one": ("a", "b"), "other": ("c",)})
    with pytest.raises(ValueError, match="would be 'b', one of one and one of other"):
        require_apart({"one": ("a", "b"), "other": ("b",)})

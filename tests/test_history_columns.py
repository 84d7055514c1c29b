"""Every column of a history has a unit or is a count, and sums in the summary are of what happens in a step."""

from __future__ import annotations

import json
import math

import pytest

import tipfem as tp
from tipfem.results.history_columns import history_columns

BOX = [(0.15, 0.08), (0.25, 0.08), (0.25, 0.14), (0.15, 0.14)]
COUNTS = {"step", "particles", "rebuilt", "impact", "newton_iterations", "krylov_iterations", "refused_steps"}


def cases(water, air):
    def tank(**more):
        return tp.tank((0.4, 0.3), 0.04, **more)

    def both(**more):
        return tank(**more).fill(air).fill(water, box=((0, 0), (0.4, 0.12)))

    fluids, g = [water, air], (0, -9.81)
    yield tp.Case(both(), fluids, g, surface_tension={("water", "air"): 0.07})
    yield tp.Case(both(), fluids, g, interface="interpolated")
    yield tp.Case(tp.tank((0.4, 0.3), 0.02).fill(air).add(tp.Body(BOX, name="box", density=500.0)), [air], g)
    yield tp.Case(tank().fill(water, box=((0, 0), (0.4, 0.12))), [water], g, free_surface=True)
    yield tp.Case(both(), fluids, g, tank_motion=tp.Motion(angle=lambda t: 0.1 * math.sin(t) ** 2))


@pytest.mark.parametrize("number", range(5))
def test_all_columns_are_known_and_sums_are_of_steps(water, air, tmp_path, number):
    case = list(cases(water, air))[number]
    simulation = tp.Simulation(case, tmp_path, time_step=2e-3, columns={"volume_of_mine": lambda _: 1.0})
    for _ in range(3):
        simulation.step()
    simulation.run(until=0.008, progress=False)
    names = set(simulation.history[-1]) - {"volume_of_mine"}
    bodies = [body.name for body in case.bodies]
    columns = history_columns(names | {"volume_of_mine"}, 2, [fluid.name for fluid in case.fluids], bodies)
    assert set(columns) == names
    without = {name for name, column in columns.items() if not column.unit}
    assert without <= COUNTS | {"relocated", "broken_films", "roughness_water", "roughness_air"}
    results = tp.read_results(tmp_path)
    assert results.history.units["kinetic_energy"] == "J/m"
    assert results.history.units["volume_water" if "volume_water" in names else "volume_air"] == "m2"
    assert {"time_step", "viscous_dissipation", "external_work"} < set(results.history.of_step)
    assert not {"time", "kinetic_energy", "max_speed"} & set(results.history.of_step)
    sums = json.loads((tmp_path / "summary.json").read_text())["sums"]
    together = sum(results.history[f"{what}_dissipation"].sum() for what in ("time", "geometry"))
    assert sums.pop("time_and_geometry_dissipation") == pytest.approx(together, rel=1e-6, abs=1e-12)
    assert not {"time_dissipation", "geometry_dissipation"} & set(sums)
    for name, value in sums.items():
        assert value == pytest.approx(results.history[name].sum(), rel=1e-6, abs=1e-12)
    assert sums["time_step"] == pytest.approx(simulation.time)
    # What the energies have changed by is what the sums say.
    table = results.history
    stored = [name for name in names if name.endswith("_energy") and name not in sums]
    energy = sum(table[name] for name in stored)
    taken = ("viscous_dissipation", "friction_dissipation", "numerical_dissipation", "damper_dissipation")
    rows = [sum(row.get(name, 0.0) for name in taken) - row["external_work"] for row in simulation.history[1:]]
    assert energy[0] - energy[-1] == pytest.approx(sum(rows), abs=1e-6 * abs(energy).max() + 1e-9)


def test_units_in_three_dimensions_are_not_per_depth():
    columns = history_columns(["kinetic_energy", "volume_oil", "momentum_z", "wall_force_x"], 3, ["oil"])
    assert [column.unit for column in columns.values()] == ["J", "m3", "N s", "N"]

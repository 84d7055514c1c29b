"""Probes of one's own, and drops that are chosen by their size, their place, and whether they touch a wall."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass

import numpy as np
import pytest

import tipfem as tp
from tipfem.results.tables import Table

WATER, OIL = tp.Fluid("water", density=1000.0, viscosity=1.0), tp.Fluid("oil", density=900.0, viscosity=1.0)
# On the floor, and two inside, by area in this order: the one on the floor, the right one, the upper one.
DROPS = {"floor": ((0.3, 0.0), 0.25), "right": ((0.7, 0.35), 0.13), "upper": ((0.3, 0.65), 0.1)}


def drops():
    """Water in oil: half a disc on the floor and two discs."""
    tank = tp.tank((1.0, 0.9), 0.03).fill(OIL)
    for at, radius in DROPS.values():
        tank.fill(WATER, disc=(at, radius))
    return tp.Case(tank, [WATER, OIL], (0, -9.81))


@dataclass(frozen=True, kw_only=True)
class Fastest(tp.Probe):
    """The largest speed of a fluid."""

    fluid: str

    def columns(self, case):
        case.fluid_index(self.fluid)
        return [("speed", "m/s"), ("height", "m")]

    def sample(self, simulation):
        own = simulation.particles.fluid == simulation.case.fluid_index(self.fluid)
        speed = np.where(own, np.linalg.norm(simulation.particles.velocity, axis=1), -1.0)
        k = int(np.argmax(speed))
        return [float(speed[k]), float(simulation.particles.position[k, 1])]


@dataclass(frozen=True, kw_only=True)
class TooFew(Fastest):
    def sample(self, simulation):
        return [1.0]


@dataclass(frozen=True, kw_only=True)
class Nothing(tp.Probe):
    pass


@pytest.mark.slow
def test_a_probe_of_ones_own_is_sampled_written_and_resumed(tmp_path):
    def run(until, simulation):
        simulation.run(until, progress=False)
        simulation.results.close()
        return simulation

    probe = Fastest(name="fastest", fluid="water", interval=4e-3)
    whole = run(0.02, tp.Simulation(drops(), tmp_path / "whole", time_step=2e-3, probes=[probe]))
    run(0.012, tp.Simulation(drops(), tmp_path / "part", time_step=2e-3, probes=[probe]))
    with pytest.raises(tp.CheckpointError, match="'fastest' of the class Fastest, which no file keeps"):
        tp.Simulation.resume(tmp_path / "part", drops())
    run(0.02, tp.Simulation.resume(tmp_path / "part", drops(), probes=[probe]))
    tables = [Table.read(tmp_path / name / "probes" / "fastest.csv") for name in ("whole", "part")]
    assert tables[0].units == {"time": "s", "speed": "m/s", "height": "m"}
    assert len(tables[0]["time"]) == len(tables[1]["time"]) == 6
    np.testing.assert_array_equal(tables[0]["speed"], whole.probes["fastest"]["speed"])
    assert (tables[0]["speed"] > 0).all()
    with open(tmp_path / "part" / "probes" / "fastest.csv") as file:
        assert next(csv.reader(file)) == ["time [s]", "speed [m/s]", "height [m]"]


def test_a_probe_of_ones_own_that_does_not_fit_is_told():
    with pytest.raises(ValueError, match="fluid"):
        tp.Simulation(drops(), probes=[Fastest(name="f", fluid="milk")])
    with pytest.raises(NotImplementedError, match=r"Nothing has no method columns\(case\)"):
        tp.Simulation(drops(), probes=[Nothing(name="n")])
    simulation = tp.Simulation(drops(), time_step=2e-3, probes=[TooFew(name="f", fluid="water")])
    with pytest.raises(ValueError, match="TooFew 'f' has measured 1 values for its 2 columns"):
        simulation.step()


@pytest.mark.parametrize(
    ("options", "name", "number"),
    [
        ({}, "floor", 3),
        ({"rank": 2}, "right", 3),
        ({"rank": 3}, "upper", 3),
        ({"off_walls": True}, "right", 2),
        ({"off_walls": True, "rank": 2}, "upper", 2),
        ({"at": (0.35, 0.8)}, "upper", 3),
        ({"at": (0.3, 0.05)}, "floor", 3),
        ({"at": (0.3, 0.05), "off_walls": True}, "right", 2),
    ],
)
def test_a_drop_is_chosen_by_size_place_and_walls(options, name, number):
    probe = tp.DropProbe(name="d", fluid="water", **options)
    simulation = tp.Simulation(drops(), time_step=1e-3, probes=[probe])
    simulation.step()
    found = {key: values[-1] for key, values in simulation.probes["d"].items()}
    (x, y), radius = DROPS[name]
    part = 0.5 if name == "floor" else 1.0
    assert found["number"] == number
    assert found["area"] == pytest.approx(part * math.pi * radius**2, rel=0.03)
    height = 4 * radius / (3 * math.pi) if name == "floor" else y
    assert (found["x"], found["y"]) == pytest.approx((x, height), abs=0.01)
    assert -0.05 < found["velocity_y"] < 0


@pytest.mark.slow
def test_a_drop_that_is_not_there_is_nan_and_bad_choices_are_refused():
    simulation = tp.Simulation(drops(), probes=[tp.DropProbe(name="d", fluid="water", rank=4)])
    simulation.step()
    values = {key: column[-1] for key, column in simulation.probes["d"].items()}
    assert values["number"] == 3
    assert all(math.isnan(value) for key, value in values.items() if key not in ("time", "number"))
    for options, message in (
        ({"rank": 0}, "rank is 0"),
        ({"at": (2.0, 0.1)}, "lies outside of the tank"),
        ({"at": (0.3, 0.1), "rank": 2}, "rank is 2, and at is given"),
    ):
        with pytest.raises(ValueError, match=message):
            tp.Simulation(drops(), probes=[tp.DropProbe(name="d", fluid="water", **options)])

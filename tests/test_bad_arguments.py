"""Values that nobody means, given to the functions of Python's side: each is refused by one error that names it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import tipfem as tp

NUMBERS = [True, "2", math.nan, -1, [1], None, 10**400, np.array([1.0, 2.0])]
NO_TIMES = [True, "2", math.nan, [1], None, 10**400, np.array([1.0, 2.0])]
NO_PATHS = [2.5, True, None, [1], "", np.array([1.0, 2.0])]
NO_TEXTS = [2.5, True, math.nan, None, [1], np.array([1.0, 2.0])]
NO_LISTS = [2.5, True, math.nan, -1, 10**400]
CASE_FILE = "no/case.toml"


@pytest.fixture(scope="module")
def filled():
    """A tank of air, with water in it, and its case."""
    water = tp.Fluid("water", density=998.2, viscosity=1e-3)
    air = tp.Fluid("air", density=1.2, viscosity=1e-5)
    tank = tp.tank(size=(0.4, 0.4), spacing=0.08).fill(air).fill(water, box=((0, 0), (0.16, 0.24)))
    return tp.Case(tank, [water, air], gravity=(0, -9.81))


def case_of(filled: tp.Case, **options: Any) -> tp.Case:
    return tp.Case(filled.particles, filled.fluids, gravity=(0, -9.81), **options)


# What takes the value, the words that the error must have, and the values.
REFUSED: dict[str, tuple[Any, str, list[Any]]] = {
    "threads": (lambda c, v: tp.init(threads=v), "threads", [2.5, True, "2", math.nan, -1, 0, [1], 10**400]),
    "arch": (lambda c, v: tp.init(arch=v), "arch", [*NO_TEXTS, "gpu"]),
    "precision": (lambda c, v: tp.init(precision=v), "precision", [*NO_TEXTS, "f16"]),
    "spacing": (lambda c, v: tp.tank((0.4, 0.4), v), "spacing", NUMBERS),
    "seed": (lambda c, v: tp.tank((0.4, 0.4), 0.08, jitter=0.1, seed=v), "seed", [2.5, "2", math.nan, -1]),
    "fill, a name": (lambda c, v: tp.tank((0.4, 0.4), 0.08).fill(v), "a tank knows no names", ["water", ""]),
    "fill": (lambda c, v: tp.tank((0.4, 0.4), 0.08).fill(v), "must be a Fluid", [2.5, None, True]),
    "shape": (lambda c, v: tp.tank((0.4, 0.4), 0.08).fill(c.fluids[0], shape=v), "shape", NO_LISTS),
    "title": (lambda c, v: case_of(c, title=v), "title", NO_TEXTS),
    "time_step": (lambda c, v: tp.Simulation(c, time_step=v), "time step", [v for v in NUMBERS if v is not None]),
    "columns": (lambda c, v: tp.Simulation(c, columns=v), "columns", [2.5, True, "2", [1]]),
    "probes": (lambda c, v: tp.Simulation(c, probes=v), "probes", [*NO_LISTS, None, "e", [1]]),
    "out": (lambda c, v: tp.Simulation(c, out=v), "out", [v for v in NO_PATHS if v is not None]),
    "overwrite": (lambda c, v: tp.Simulation(c, out="no", overwrite=v), "overwrite", [2.5, "yes", -1]),
    "steering": (lambda c, v: tp.Simulation(c, steering=v), "steering", [*NO_LISTS, [1], "no.jsonl"]),
    "compression": (lambda c, v: tp.FieldOutput(compression=v), "compression", [1.5, True, "2", math.nan, -1, 10]),
    "interval": (
        lambda c, v: tp.Simulation(c, probes=[tp.EnergyProbe(name="e", interval=v)]),
        "interval",
        [v for v in NUMBERS if v is not None],
    ),
    "count": (
        lambda c, v: tp.Simulation(c, probes=[tp.LineProbe(name="l", start=(0.1, 0.1), end=(0.2, 0.2), count=v)]),
        "count",
        [2.5, True, "2", 1, 10**400, None],
    ),
    "volume": (lambda c, v: tp.Simulation(c).volume(v), "there is no fluid", [2.5, "oil", None, np.array([1, 2])]),
    "step": (lambda c, v: tp.Simulation(c).step(v), "until", [*NO_TIMES, -1, 0]),
    "run": (lambda c, v: tp.Simulation(c).run(v), "until", [*NO_TIMES, -1, 0]),
    "end": (lambda c, v: tp.describe(c, v), "end", [*NO_TIMES, -1, 0, math.inf]),
    "load_case": (lambda c, v: tp.load_case(v), "path", NO_PATHS),
    "overrides": (lambda c, v: tp.load_case(CASE_FILE, v), "overrides", [*NO_LISTS, None, "a=1", [1]]),
    "read_results": (lambda c, v: tp.read_results(v), "out", NO_PATHS),
    "resume": (lambda c, v: tp.Simulation.resume(v), "out", NO_PATHS),
}


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_by_one_error_that_names_it(name, filled, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    use, word, values = REFUSED[name]
    for value in values:
        with pytest.raises(ValueError, match=word) as caught:
            use(filled, value)
        assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_times_and_numbers_of_stored_states_are_checked(filled, tmp_path):
    simulation = tp.Simulation(filled, out=tmp_path / "out", time_step=1e-3)
    simulation.run(1e-3)
    results = tp.read_results(tmp_path / "out")
    for value in NO_TIMES:
        with pytest.raises(ValueError, match=r"time is .* s; it must be a number"):
            results.at(value)
        with pytest.raises(ValueError, match=r"time is .* s; it must be a number"):
            results.picture(value)
    for value in ("2", [1], math.nan, -1):
        with pytest.raises(ValueError, match="tolerance is"):
            results.at(0.0, tolerance=value)
    for number in (2.5, "0", None, [1], 2, -3):
        with pytest.raises(IndexError, match="has 2, numbered from 0"):
            results[number]

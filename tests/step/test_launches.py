"""How many kernels a step launches, and what it hands to them from NumPy: ceilings that only fall."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend import launch as launches
from tipfem.backend.runtime import on_cpu

STEPS = 6
# Of a step, without those of Krylov's iterations, for each of Newton's: launches of kernels; arrays of NumPy that they
# are given, each of which a GPU would be sent and would send back.
LAUNCHES, ARRAYS = 46, 168


@pytest.fixture
def counted(monkeypatch):
    """Launches, and arrays of NumPy given to them, since the test began."""
    found = {"launches": 0, "arrays": 0}
    start = launches.Kernel.start

    def counting(self, arguments):
        found["launches"] += 1
        found["arrays"] += sum(isinstance(argument, np.ndarray) for argument in arguments)
        return start(self, arguments)

    monkeypatch.setattr(launches.Kernel, "start", counting)
    return found


def test_a_step_launches_no_more_kernels_than_it_did(counted):
    water, air = tp.Fluid("water", 998.2, 1.002e-3), tp.Fluid("air", 1.204, 1.825e-5)
    tank = tp.tank((0.4, 0.4), 0.02).fill(air).fill(water, box=((0, 0), (0.14, 0.28)))
    simulation = tp.Simulation(tp.Case(tank, [water, air], gravity=(0, -9.81)))
    if not on_cpu():
        pytest.skip("only CPUs make a Krylov iteration in one launch")
    for _ in range(3):
        simulation.step()
    counted.update(launches=0, arrays=0)
    for _ in range(STEPS):
        simulation.step()
    rows = simulation.history[-STEPS:]
    newton, krylov = (sum(row[f"{name}_iterations"] for row in rows) for name in ("newton", "krylov"))
    assert (counted["launches"] - krylov) / newton <= LAUNCHES
    assert counted["arrays"] / newton <= ARRAYS

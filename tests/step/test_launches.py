"""How many kernels a step launches, and what it hands to them from NumPy: ceilings that only fall."""

from __future__ import annotations

import numpy as np
import pytest
import taichi as ti

import tipfem as tp
from tipfem.backend import launch as launches
from tipfem.backend.runtime import on_cpu

STEPS = 6
# Of a step, with 1.5 of Newton's iterations: launches of kernels with arrays of the device; and arrays of NumPy that
# they are given, each of which a GPU would be sent and would send back. Others run on the processor, beside a GPU, too.
LAUNCHES, ARRAYS = 61, 14


@pytest.fixture
def counted(monkeypatch):
    """Launches, and arrays of NumPy given to them, since the test began."""
    found = {"launches": 0, "arrays": 0}
    start = launches.Kernel.start

    def counting(self, arguments):
        if any(isinstance(argument, ti.Ndarray) for argument in arguments):
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
        pytest.skip("only CPUs make all Krylov iterations of a solve in one launch")
    for _ in range(3):
        simulation.step()
    counted.update(launches=0, arrays=0)
    for _ in range(STEPS):
        simulation.step()
    assert sum(row["newton_iterations"] for row in simulation.history[-STEPS:]) <= 9
    assert counted["launches"] <= LAUNCHES * STEPS
    assert counted["arrays"] <= ARRAYS * STEPS

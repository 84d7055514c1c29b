"""Runs that go on from a copy of their results, for tests that compare them with the run that was not interrupted."""

from __future__ import annotations

import shutil

import numpy as np

import tipfem as tp


def require_same_when_resumed(case, folder):
    """A run goes on at half of its time as without a break, to the bit; returns the resumed simulation."""
    whole = tp.Simulation(case, folder / "run", time_step=4e-3)
    whole.run(0.04, progress=False)
    shutil.copytree(folder / "run", folder / "part")
    whole.run(0.08, progress=False)
    resumed = tp.Simulation.resume(folder / "part")
    resumed.run(0.08, progress=False)
    np.testing.assert_array_equal(resumed.particles.position, whole.particles.position)
    if "bodies" in whole.state.parts:
        np.testing.assert_array_equal(resumed.state.parts["bodies"].position, whole.state.parts["bodies"].position)
    return resumed

"""The study of bodies at its coarse resolutions: Archimedes, Faxen, and fluids that a paddle stirs."""

from __future__ import annotations

import pytest
from tipfem.demos.validation.bodies import run

pytestmark = pytest.mark.slow


FLOWS = ["draught", "surface", "light", "falling", "stirring", "heaving", "wavemaker", "slamming"]


@pytest.mark.parametrize("flow", FLOWS)
def test_coarse_flows_pass_their_check(flow):
    figures, (time, values, _known) = run.STUDIES[flow][0](run.SHORT[flow][0], True)
    assert run.check(figures, run.SHORT_LIMITS) == []
    assert len(time) == len(values) > 20

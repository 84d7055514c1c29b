"""Bodies that touch against what is known of them: short runs of the study, and its check."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from tipfem.demos.validation.contact import flows, run

import tipfem as tp

LONG = ("flap", "baffle")
# At the short spacings their figures scatter by more than the limits of the study: over six within 2 %, what a box that
# has landed carries is -0.01 to 0.04 off, and the speed of one that rises 0.02 to 0.17.
AT_OWN_SPACINGS = ("land", "lift")


@pytest.mark.slow(but=("stack", "gate"))
@pytest.mark.parametrize("flow", [pytest.param(f, marks=pytest.mark.slow if f in LONG else ()) for f in run.LIMITS])
def test_short_flows_are_as_expected(flow):
    tp.init()
    assert run.check(flow, getattr(flows, flow)(flow not in AT_OWN_SPACINGS)[0]) == []


@pytest.mark.slow
def test_the_study_passes(tmp_path, capsys):
    """At its own spacings; the ways of the box that is pushed converge."""
    assert run.main(out=tmp_path) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    ways = [summary["flows"]["push"][f"moved {across}"] for across in (4, 6, 8)]
    assert abs(ways[2] - ways[1]) < 0.5 * abs(ways[1] - ways[0])
    assert (tmp_path / "contact.png").stat().st_size > 0
    capsys.readouterr()


TOLD = "needs empty space", "one fluid", "'seal'", "give it a gap"


@pytest.mark.parametrize(("what", "told"), [*zip(flows.REFUSED, TOLD, strict=True)])
def test_what_does_not_work_is_refused(what, told):
    assert told in flows.refusal(what)


def test_what_is_let_through_is_told(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(flows, "REFUSED", {"a gate": ([flows.WATER], flows.DEPTH, {"gap": "seal"})})
    assert run.main(flow=("stack",), short=True, out=tmp_path) == 1
    assert "a gate is not refused" in capsys.readouterr().out


@pytest.mark.parametrize("flow", run.LIMITS)
def test_the_check_can_fail(flow):
    good = dict.fromkeys(run.LIMITS[flow], 0.0)
    assert run.check(flow, good) == []
    for name, limit in run.LIMITS[flow].items():
        for wrong in (1.1 * limit or 1.0, -1.1 * limit or -1.0, math.nan):
            assert len(run.check(flow, {**good, name: wrong})) == 1


def test_a_thin_film_gets_thinner_at_a_steady_rate():
    """At last g' = -k g with rho L^3 k^2 / 12 the weight in water."""
    time, gap, _ = flows.squeezed(0.02, 500.0, 2.0)
    weight = (flows.HEAVY - flows.WATER.density) * flows.WIDE * flows.HIGH * flows.G
    rate = math.sqrt(12 * weight / (flows.WATER.density * flows.WIDE**3))
    late = time > 1.5
    found = -np.gradient(np.log(gap[late]), time[late]).mean()
    assert found == pytest.approx(rate, rel=1e-2)


def test_the_period_over_a_baffle_does_not_depend_on_the_grid():
    """And is longer than without: 2 pi / sqrt(g pi tanh 0.3 pi)."""
    periods = [flows.sloshing_period(count) for count in (40, 80)]
    assert periods[0] == pytest.approx(periods[1], rel=5e-4)
    assert periods[1] > 1.07 * 2 * math.pi / math.sqrt(flows.G * math.pi * math.tanh(0.3 * math.pi))

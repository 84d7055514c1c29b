"""The demo of a dam break against a container, coarse, and its comparison with the experiment."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from demo_runs import called
from tipfem.demos import dam_break_container as demo


@pytest.mark.slow
def test_a_column_falls_as_in_the_experiment(tmp_path, capsys):
    words = ["--spacing", "0.11", "--end-time", "0.3", "--no-frames"]
    figures = called("dam_break_container", tmp_path, *words)["validation"]
    assert "check: passed" in capsys.readouterr().out
    assert 0 < figures["column"] < 0.03
    assert (tmp_path / "levels.png").stat().st_size > 0


def test_levels_of_the_experiment_agree_with_themselves():
    """A run with the levels of the experiment misses nothing, and one that is late and high is told so."""
    given = demo.measured()
    assert given["time"][-1] == 6.0
    assert given["at_2.638"][0] == pytest.approx(0.55, abs=0.005)
    assert demo.arrival(given["time"], given["at_1.488"]) < demo.arrival(given["time"], given["at_0.992"]) < 0.5
    check, options = (
        demo.AsMeasured(SimpleNamespace(fluids=[SimpleNamespace(name="water")])),
        SimpleNamespace(end_time=6.0),
    )
    check._volume = 1.0

    pressed = demo.measured(demo.PRESSED)
    time = np.append(pressed["time"], 0.7)

    def run(late, high, hard=1.0):
        names = [name for name in given if name != "time"]
        tables = {name: {"time": given["time"] + late, "depth": np.maximum(given[name] + high, 0)} for name in names}
        for name in ("P1", "P3"):
            values = hard * np.append(pressed[name], pressed[name][-1])
            sums = np.concatenate([[0.0], np.cumsum(np.diff(time) * 0.5 * (values[1:] + values[:-1]))])
            tables[name] = {"time": time, "pressure": values, "pressure_impulse": sums}
        return SimpleNamespace(probes=tables, volume=lambda _: 1.0)

    same = check.figures(run(0.0, 0.0))
    assert max(same.values()) < 1e-12
    assert check.missed(same, options) == []
    for late, high, names in ((0.25, 0.0, ["column", "arrival"]), (0.0, 0.08, ["column", "between"])):
        found = check.missed(check.figures(run(late, high)), options)
        assert [line.split()[0] for line in found] == names
    found = check.missed(check.figures(run(0.0, 0.0, hard=1.5)), options)
    assert [line.split()[0] for line in found] == ["impulse_P1", "impulse_P3"]
    found = check.missed(check.figures(run(0.0, 0.0, hard=0.0)), options)  # it never arrives
    assert [line.split()[0] for line in found] == ["impulse_P1", "impulse_P3"]

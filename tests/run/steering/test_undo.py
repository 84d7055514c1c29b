"""A run that goes back: what came after is gone, in its folder, too, and it goes on as if it had not been."""

from __future__ import annotations

import json

import pytest

import tipfem as tp
from tipfem.run.liveview.control import WatchedControl
from tipfem.run.steering import FILE
from tipfem.run.steering.commands import Undo


def simulation(out=None):
    """Oil on water in a unit tank."""
    water, oil = tp.Fluid("water", density=1000.0, viscosity=1.0), tp.Fluid("oil", density=800.0, viscosity=2.0)
    tank = tp.tank((1.0, 1.0), 0.1).fill(oil).fill(water, box=((0, 0), (1.0, 0.3)))
    return tp.Simulation(tp.Case(tank, [water, oil], (1.0, -9.81)), out, time_step=0.01, output_interval=0.03)


def names(folder):
    """The files of a folder."""
    return sorted(path.name for path in folder.iterdir())


def test_a_run_goes_back_and_on_to_the_bit(tmp_path):
    run = simulation(tmp_path / "out")
    run.run(0.05, progress=False)
    kept, step = run.kept(), run.step_number
    before = {folder: names(tmp_path / "out" / folder) for folder in ("fields", "checkpoints")}
    run.steer(tp.Gravity((3.0, -9.0)))
    run.run(0.1, progress=False)
    run.go_back(kept)
    assert (run.step_number, run.time) == (step, 0.05)
    assert run.forces.gravity is None
    assert {folder: names(tmp_path / "out" / folder) for folder in before} == before
    assert (tmp_path / "out" / FILE).read_text() == ""
    assert len((tmp_path / "out" / "history.csv").read_text().splitlines()) == step + 1
    run.run(0.1, progress=False)
    other = simulation(tmp_path / "other")
    for until in (0.05, 0.1):
        other.run(until, progress=False)
    assert run.particles.position.tobytes() == other.particles.position.tobytes()
    assert (tmp_path / "out" / "fields.pvd").read_text() == (tmp_path / "other" / "fields.pvd").read_text()
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["steps"] == other.step_number


def test_a_stroke_is_undone_as_one_and_nothing_is_told(tmp_path):
    run = simulation()
    given, said = [], []
    control = WatchedControl(run)
    control._receive, control._report = lambda wait: [given.pop(0)] if given else [], said.append
    for x in (1.0, 2.0, 3.0):
        given.append(tp.Gravity((x, -9.0)))
        assert control.ready(run, run.steer)
        run.step()
    given.append(tp.Poke((0.3, 0.15), (30.0, 0.0), 0.2))
    control.ready(run, run.steer)
    assert [record.command.name for record in run.steering.applied] == ["gravity"] * 3 + ["poke"]
    for left, steps in ((3, 3), (0, 0)):
        given.append(Undo())
        control.ready(run, run.steer)
        assert (len(run.steering.applied), run.step_number) == (left, steps)
    given.append(Undo())
    control.ready(run, run.steer)
    assert said == ["undo: there is nothing to undo"]


def test_a_refused_command_leaves_nothing_to_undo():
    run = simulation()
    control = WatchedControl(run)
    with pytest.raises(ValueError, match="drop"):
        control._steer(run.steer, tp.Drop((0.5, 0.95), 0.15, "water"))
    with pytest.raises(ValueError, match="nothing to undo"):
        control.go_back()

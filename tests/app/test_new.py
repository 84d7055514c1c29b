"""Case files to begin with: each is a sound case, runs, and changes as a whole with its variables."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.app.commands import main
from tipfem.casefile.hints import hints

# Of each, the variables for a coarse run, and the steps that it is followed for.
KINDS = {
    "channel": ["variables.height=0.3", "tank.spacing=0.03"],
    "drop": ["variables.width=0.03", "tank.spacing=0.0012"],
    "filling": ["variables.width=0.5", "tank.spacing=0.018"],
    "flume": ["variables.depth=0.25", "tank.spacing=0.05"],
    "separator": ["variables.length=1"],
    "sloshing": ["variables.width=0.9", "tank.spacing=0.05"],
}


def test_all_kinds_are_listed(capsys):
    assert main(["new"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == sorted(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_case_is_sound_and_runs(kind, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", kind]) == 0
    assert main(["check", f"{kind}.toml", "--no-mesh"]) == 0
    said = capsys.readouterr()
    assert "no mistakes found" in said.out
    assert "note:" not in said.out
    assert said.err == ""
    file = tp.load_case(f"{kind}.toml", KINDS[kind])
    simulation = file.simulation()
    before = simulation.state.volume.sum()
    for _ in range(5):
        simulation.step(file.end)
    assert np.isfinite(simulation.particles.velocity).all()
    assert 0 < simulation.particles.max_speed < 2
    entered = sum(value for row in simulation.history for key, value in row.items() if key.startswith("through_"))
    assert simulation.state.volume.sum() - before == pytest.approx(entered, abs=1e-3 * before)
    assert all(len(probe["time"]) == 5 for probe in simulation.probes.values())
    assert hints(simulation.case, file.end, None) == []


def test_a_file_that_is_there_is_kept_and_other_kinds_are_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "drop", "mine.toml"]) == 0
    before = (tmp_path / "mine.toml").read_text()
    assert "`tipfem run mine.toml --view`" in before
    assert main(["new", "flume", "mine.toml"]) == 2
    assert (tmp_path / "mine.toml").read_text() == before
    assert main(["new", "flum"]) == 2
    assert main(["new", "drop", "nowhere/x.toml"]) == 2
    said = capsys.readouterr().err
    for text in (
        "is there already; name another",
        "there is no kind 'flum'",
        "did you mean 'flume'",
        "cannot be written",
    ):
        assert text in said

"""tipfem resume, and --resume of demos: runs that were stopped, killed or are complete, and folders that are none."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
import time

import pytest
from demo_runs import DEMOS, called

import tipfem as tp
from tipfem.app.commands import main
from tipfem.errors import CheckpointError

CASE = str(DEMOS / "cases" / "dam_break.toml")
COARSE = ("--set", "tank.spacing=0.04", "--set", "time.largest_step=0.0012", "--no-progress")


def rows(out):
    """The history as text, without wall-clock times."""
    with open(out / "history.csv", newline="") as file:
        return [row[:-1] for row in csv.reader(file)]


@pytest.mark.slow
def test_a_run_goes_on_to_the_bit_and_further(tmp_path, capsys):
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert main(["run", CASE, *COARSE, "--until", "0.024", "--out", str(whole)]) == 0
    assert main(["run", CASE, *COARSE, "--until", "0.012", "--out", str(out)]) == 0
    assert main(["resume", str(out), "--until", "0.024", "--no-progress"]) == 0
    assert rows(out) == rows(whole)
    assert (out / "fields.pvd").read_text() == (whole / "fields.pvd").read_text()
    assert json.loads((out / "summary.json").read_text())["status"] == "complete"
    capsys.readouterr()
    assert main(["resume", str(whole)]) == 0
    assert "0.024 s has been reached; give a later --until to go on" in capsys.readouterr().out


def test_without_a_checkpoint_it_starts_from_the_beginning(tmp_path, capsys):
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert main(["run", CASE, *COARSE, "--until", "0.012", "--out", str(whole)]) == 0
    out.mkdir()
    (out / "case.toml").write_text((whole / "case.toml").read_text())
    assert main(["resume", str(out), "--no-progress"]) == 0
    assert "from t = 0 to t = 0.012 s" in capsys.readouterr().err
    assert rows(out) == rows(whole)


def test_the_record_of_the_checkpoint_is_enough(tmp_path, water, air):
    """Of a script's run without functions, with its probes."""
    tank = tp.tank((0.584, 0.584), 0.04).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
    case = tp.Case(tank, [water, air], (0, -9.81))
    probes = [tp.WaveGauge(name="gauge", x=0.1, fluid="water"), tp.PointProbe(name="point", at=(0.1, 0.1))]
    simulation = tp.Simulation(case, tmp_path, time_step=2e-3, probes=probes)
    simulation.run(0.01, progress=False)
    assert main(["resume", str(tmp_path), "--until", "0.02", "--no-progress"]) == 0
    with open(tmp_path / "probes" / "gauge.csv", newline="") as file:
        found = [[float(value) for value in row] for row in list(csv.reader(file))[1:]]
    simulation.run(0.02, progress=False)
    assert found == simulation.probes.rows["gauge"]


def test_a_changed_case_is_refused_unless_numbers_of_the_method_may_change(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["run", CASE, *COARSE, "--until", "0.004", "--out", str(out)]) == 0
    text = (out / "case.toml").read_text()
    (out / "case.toml").write_text(text.replace("[time]", "[numerics]\nlargest_move = 0.5\n\n[time]"))
    words = ["resume", str(out), "--until", "0.008", "--no-progress"]
    capsys.readouterr()
    assert main(words) == 2
    assert "numerics.largest_move: None, now 0.5" in capsys.readouterr().err
    assert main([*words, "--allow-changes"]) == 0
    assert "note: changed: numerics.largest_move: None, now 0.5" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "nowhere: there is no such folder"),
        (["empty"], "it holds neither checkpoints nor case.toml"),
        (["foreign"], "holds no checkpoint that can be read: foreign/checkpoints/step_000000001.h5 is damaged, or no"),
        (["foreign/checkpoints/step_000000001.h5"], "step_000000001.h5: is a file; give the results folder of a run"),
        (["demo"], "go on with it by: tipfem demo dam_break --spacing 0.01 --resume"),
        (["broken"], "this is not valid TOML"),
        (["empty", "--until", "0"], "--until is 0.0 s; it must be a number > 0"),
        (["empty", "--until", "later"], "later"),
        ([], "OUT"),
    ],
)
def test_what_cannot_be_resumed_is_said_in_one_message(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("empty", "foreign/checkpoints", "demo", "broken"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "foreign" / "checkpoints" / "step_000000001.h5").write_text("nothing")
    (tmp_path / "demo" / "command.json").write_text('["tipfem", "demo", "dam_break", "--spacing", "0.01", "--resume"]')
    (tmp_path / "broken" / "case.toml").write_text("end = ")
    assert main(["resume", *words]) == 2
    said = capsys.readouterr()
    text = " ".join((said.out + said.err).replace("│", " ").split())
    assert message in text
    assert "Traceback" not in text


@pytest.mark.slow
def test_a_demo_that_is_killed_is_resumed_to_the_bit(tmp_path, capsys):
    options = ["--spacing", "0.03", "--end-time", "0.1", "--no-frames"]
    whole, out = tmp_path / "whole", tmp_path / "out"
    complete = called("dam_break", whole, *options, "--resume")  # with nothing to go on with
    process = subprocess.Popen(
        [sys.executable, "-m", "tipfem", "demo", "dam_break", *options, "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while not (out / "history.csv").exists() or len(rows(out)) < 10:
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.communicate()
    capsys.readouterr()
    assert main(["resume", str(out)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert f"go on with it by: tipfem demo dam_break {' '.join(options)} --out {out} --resume" in said
    resumed = called("dam_break", out, *options, "--resume")
    assert "going on from step" in capsys.readouterr().err
    assert rows(out) == rows(whole)
    assert resumed["validation"] == complete["validation"]


MOVED = """
[tank_motion]
angle = { form = "sine", amplitude = 0.1, frequency = 2.0, soft_start = 0.5 }
translation = { form = "table", file = "shift.csv" }
"""


@pytest.mark.slow
def test_python_goes_on_with_a_case_file_s_run_and_its_motions(tmp_path, capsys):
    """The table, too, is in the results folder: nothing beside it is needed."""
    (tmp_path / "moved.toml").write_text((DEMOS / "cases" / "dam_break.toml").read_text("utf-8") + MOVED, "utf-8")
    (tmp_path / "shift.csv").write_text("0, 0, 0\n0.5, 0.05, 0\n1.0, 0.1, 0.1\n")
    whole, out = tmp_path / "whole", tmp_path / "out"
    dt = 2**-10  # whose multiples are exact
    words = ["run", str(tmp_path / "moved.toml"), *COARSE, "--set", f"time.largest_step={dt}"]
    assert main([*words, "--until", str(12 * dt), "--out", str(whole)]) == 0
    assert main([*words, "--until", str(6 * dt), "--out", str(out)]) == 0
    (tmp_path / "shift.csv").unlink()
    (tmp_path / "moved.toml").unlink()
    tp.Simulation.resume(out).run(until=12 * dt)
    assert rows(out) == rows(whole)


def test_a_script_s_run_leaves_its_whole_case(tmp_path, water, air):
    def run(out, case, **options):
        simulation = tp.Simulation(case, out, time_step=2e-3, probes=[tp.EnergyProbe(name="e")], **options)
        simulation.run(until=0.006)
        return simulation

    tank = tp.tank((0.4, 0.4), 0.08).fill(air).fill(water, box=((0, 0), (0.16, 0.24))).wall("top", velocity=(1, 0))
    case = tp.Case(tank, [water, air], gravity=(0, -9.81), title="A lid that slides")
    run(tmp_path / "out", case, output_interval=4e-3)
    file = tp.load_case(tmp_path / "out" / "case.toml")
    assert (file.end, file.table.output.interval, file.parts.probes[0].name) == (0.006, 4e-3, "e")
    assert main(["run", str(tmp_path / "out" / "case.toml"), "--out", str(tmp_path / "again"), "--no-progress"]) == 0
    assert rows(tmp_path / "again") == rows(tmp_path / "out")
    assert main(["resume", str(tmp_path / "out"), "--until", "0.008", "--no-progress"]) == 0


def test_a_script_s_run_says_which_part_no_file_keeps(tmp_path, water, air, capsys):
    tank = tp.tank((0.4, 0.4), 0.08).fill(air).fill(water, where=lambda x: x[:, 1] < 0.2)
    tank.wall("top", velocity=lambda time: (time, 0.0))
    case = tp.Case(tank, [water, air], gravity=(0, -9.81))
    tp.Simulation(case, tmp_path / "out", time_step=2e-3).run(until=0.004)
    text = (tmp_path / "out" / "case.toml").read_text()
    assert "#   fill[1].where: the Python function test_a_script_s_run_says" in text
    assert "#   walls.top.velocity: the Python function test_a_script_s_run_says" in text
    assert main(["resume", str(tmp_path / "out"), "--until", "0.006"]) == 2
    said = capsys.readouterr().err
    assert "the case has functions of Python's, which no file keeps: walls.top.velocity; give the case" in said
    simulation = tp.Simulation.resume(tmp_path / "out", case)
    simulation.run(until=0.006)
    assert simulation.step_number == 3


def times(out):
    """The times of the states on disk [s]."""
    return [round(float(time), 9) for time in re.findall(r'timestep="([^"]+)"', (out / "fields.pvd").read_text())]


def changed(out, before, after):
    """Replace a part of the folder's case file."""
    text = (out / "case.toml").read_text()
    assert before in text
    (out / "case.toml").write_text(text.replace(before, after))


@pytest.fixture
def begun(tmp_path):
    """A run to 0.012 s with a state every 0.004 s and a probe, to go on with."""
    (tmp_path / "case.toml").write_text((DEMOS / "cases" / "dam_break.toml").read_text("utf-8") + GAUGE, "utf-8")
    out = tmp_path / "out"
    words = ["run", str(tmp_path / "case.toml"), *COARSE, "--set", "output.interval=0.004"]
    assert main([*words, "--until", "0.012", "--out", str(out)]) == 0
    return out


GAUGE = """
[[probes]]
type = "energy"
name = "energy"

[[probes]]
type = "volume"
name = "water"
fluid = "water"
"""


def test_changes_of_what_is_written_are_taken_from_the_file_and_the_command_line(begun, capsys):
    changed(begun, "interval = 0.004", "interval = 0.002")
    changed(begun, 'name = "energy"', 'name = "energy"\ninterval = 0.004')
    assert main(["resume", str(begun), "--until", "0.016", "--no-progress"]) == 0
    said = capsys.readouterr().err
    assert "note: changed: output_interval: 0.004, now 0.002" in said
    assert "note: changed: probe energy.interval: None, now 0.004" in said
    assert times(begun) == [0.0, 0.004, 0.008, 0.012, 0.014, 0.016]
    with open(begun / "probes" / "energy.csv", newline="") as file:
        late = [float(row[0]) for row in list(csv.reader(file))[1:] if float(row[0]) > 0.0121]
    assert late == pytest.approx([0.016])
    words = ["resume", str(begun), "--set", "output.interval=0.001", "--set", "checkpoint.interval=0.002"]
    assert main([*words, "--until", "0.018", "--no-progress"]) == 0
    assert times(begun)[-2:] == [0.017, 0.018]
    assert main(["resume", str(begun), "--until", "0.02", "--no-progress"]) == 0  # the file keeps what --set said
    assert times(begun)[-2:] == [0.019, 0.02]
    assert (begun / "checkpoints" / "step_000000000.h5").exists()


def test_python_changes_what_is_written(begun):
    added = [tp.EnergyProbe(name="energy"), tp.FrontProbe(name="front", fluid="water")]
    simulation = tp.Simulation.resume(begun, output_interval=0.001, probes=added)
    assert "changed: probe 'front' is added; its file begins here" in simulation.notes
    assert "changed: probe 'water' is left out; its file ends here" in simulation.notes
    before = (begun / "probes" / "water.csv").read_text()
    simulation.run(0.014, progress=False)
    assert times(begun)[-3:] == [0.012, 0.013, 0.014]
    assert (begun / "probes" / "water.csv").read_text() == before
    assert min(simulation.probes["front"]["time"]) > 0.012
    left = tp.load_case(begun / "case.toml")
    assert left.table.output.interval == 0.001
    assert simulation.case.tank is not None
    assert left.case().tank is not None  # the tank and its fills are kept, not replaced by particles
    assert main(["resume", str(begun), "--until", "0.0145", "--no-progress"]) == 0
    with pytest.raises(CheckpointError, match=r"probes/water.csv is there from an earlier probe; give .* another name"):
        tp.Simulation.resume(begun, probes=[*added, tp.VolumeProbe(name="water", fluid="water")])
    with pytest.raises(CheckpointError, match=r"fields: format is 'vtkhdf'; the run has written 'vtu'"):
        tp.Simulation.resume(begun, fields="vtkhdf")
    with pytest.raises(ValueError, match=r"output_interval is -1 s; it must be a number > 0"):
        tp.Simulation.resume(begun, output_interval=-1)
    assert tp.Simulation.resume(begun, output_interval=None).fields.interval is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--set", "fluids.water.density=3"],
            "--set fluids.water.density=3: it changes the flow, and a run goes on with",
        ),
        (["--set", "time.end=1"], "--set time.end=1: the time to run to is given by --until"),
        (["--set", "output.folder=x"], "--set output.folder=x: the results of a run stay in their folder"),
        (["--set", "numerics.rho_inf=0.5"], "the method change the results; add --allow-changes"),
        (
            ["--set", "output.fields=vtkhdf"],
            "--set output.fields=vtkhdf: output.fields is 'vtkhdf'; the run has written",
        ),
        (["--set", "output.intervall=1"], "did you mean 'interval'?"),
    ],
)
def test_what_changes_the_flow_is_refused(words, message, begun, capsys):
    history = rows(begun)
    assert main(["resume", str(begun), *words, "--until", "0.016"]) == 2
    assert message in capsys.readouterr().err
    assert rows(begun) == history


def test_a_flow_that_was_changed_in_the_file_is_refused_with_its_line(begun, capsys):
    changed(begun, "density = 998.2", "density = 3")
    changed(begun, "largest_step = 0.0012", "largest_step = 1e-3")
    lines = (begun / "case.toml").read_text().splitlines()
    assert main(["resume", str(begun), "--until", "0.016"]) == 2
    said = capsys.readouterr().err
    line = lines.index("density = 3") + 1
    assert (
        f"case.toml:{line}: fluids.water.density: 998.2, now 3.0; the flow of a run that goes on cannot change" in said
    )
    line = lines.index("largest_step = 1e-3") + 1
    assert f"case.toml:{line}: time.largest_step is 0.001 s; the run has" in said


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("interval = 0.004", "interval = 0.002"),
        ("viscosity = 0.001002", "viscosity = 0.1"),
        ("[time]", "[tme]"),
        ("", ""),
    ],
)
def test_python_says_that_it_does_not_read_an_edited_case_file(tmp_path, old, new):
    assert main(["run", CASE, *COARSE, "--until", "0.004", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "case.toml").read_text()
    assert old in text
    (tmp_path / "case.toml").write_text(text.replace(old, new) if old else text + "\n# nothing new\n")
    resumed = tp.Simulation.resume(tmp_path)
    resumed.results.close()
    assert [note for note in resumed.notes if "does not read it; `tipfem resume` does" in note] == resumed.notes
    assert len(resumed.notes) == (1 if old else 0)
    assert resumed.fields.interval == 0.004
    assert resumed.case.fluids[0].viscosity == 1.002e-3


def test_an_end_in_the_case_file_is_noted_unless_until_is_given(tmp_path, capsys):
    assert main(["run", CASE, *COARSE, "--until", "0.004", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "case.toml").read_text()
    (tmp_path / "case.toml").write_text(re.sub(r"(?m)^end = .*$", "end = 0.02", text))
    capsys.readouterr()
    assert main(["resume", str(tmp_path), "--no-progress"]) == 0
    assert "`--until 0.02` goes on further" in capsys.readouterr().err
    assert main(["resume", str(tmp_path), "--until", "0.008", "--no-progress"]) == 0
    assert "note:" not in capsys.readouterr().err

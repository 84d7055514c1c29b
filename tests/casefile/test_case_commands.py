"""The commands on case files: what they do, what they say, and their exit codes."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from collections import Counter
from itertools import islice

import h5py
import imageio.v3 as imageio
import numpy as np
import pytest
from demo_runs import DEMOS
from test_bad_input import GOOD
from tipfem.demos.support import small_cases

import tipfem as tp
from tipfem.app import compiling, inspection
from tipfem.app.commands import main
from tipfem.backend import kept_kernels
from tipfem.backend import launch as launches
from tipfem.results.folder_lock import FolderLock
from tipfem.run.case_file import load_case
from tipfem.step import stepper

CASE = str(DEMOS / "cases" / "dam_break.toml")
COARSE = ("--set", "tank.spacing=0.02")


def tipfem(*words, **options):
    """A command in a process of its own."""
    return subprocess.run([sys.executable, "-m", "tipfem", *words], capture_output=True, text=True, **options)


def test_run_writes_results_and_the_whole_case(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["run", CASE, *COARSE, "--set", "fluids.water.viscosity=2e-3", "--until", "0.012", "--out", str(out)]
    assert main([*words, "--no-progress"]) == 0
    assert "to t = 0.012 s" in capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert (summary["status"], summary["time"], summary["fluids"][0]["viscosity"]) == ("complete", 0.012, 2e-3)
    kept = load_case(out / "case.toml")
    assert (kept.end, kept.folder, kept.table.fluids["water"].viscosity) == (0.012, out, 2e-3)
    wanted = load_case(CASE, [COARSE[1]]).case().particles
    assert np.array_equal(kept.case().particles.position, wanted.position)
    assert len(list((out / "fields").glob("*.vtu"))) == 4  # 0, 0.004, 0.008 and 0.012 s
    # Another run does not go there by accident.
    assert main(words) == 2
    assert "holds results" in capsys.readouterr().err
    assert main([*words, "--overwrite"]) == 0
    listed = (out / ".tipfem").read_bytes()
    (out / ".tipfem").write_bytes(listed + b"\xff")
    capsys.readouterr()
    assert main([*words, "--overwrite"]) == 2
    assert capsys.readouterr().err.startswith(
        f"error: '{out}/.tipfem', which lists the files of an earlier run, is dam"
    )
    (out / ".tipfem").write_bytes(listed)
    assert main(["info", str(out)]) == 0
    said = capsys.readouterr().out
    for word in ("Dam break of water in air", "water (998.2", "complete", "to t = 0.012 s", "taichi 1.7.4", "MB"):
        assert word in said
    error = summary["numerical_error"]
    assert f"numerics    energy {error['energy']:.2g}, momentum {error['momentum']:.2g}, volume_water" in said


def test_states_go_where_and_how_the_case_file_says(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["run", CASE, *COARSE, "--until", "0.004", "--out", str(out), "--no-progress"]
    single = ["--set", "output.fields=vtkhdf", "--set", "output.precision=single", "--set", "output.compression=0"]
    assert main([*words, *single, "--set", "output.quantities=['vorticity']"]) == 0
    assert not (out / "fields.pvd").exists()
    with h5py.File(out / "fields.vtkhdf", "r") as file:
        points = file["VTKHDF/Points"]
        assert points.dtype == np.float32
        assert points.compression is None
        assert file["VTKHDF/PointData/vorticity"].dtype == np.float32
    assert tp.read_results(out).times.tolist() == [0.0, 0.004]
    capsys.readouterr()
    assert main(["info", str(out)]) == 0
    assert "states      2 in fields.vtkhdf\n" in capsys.readouterr().out
    kept = load_case(out / "case.toml")
    assert kept.fields == tp.FieldOutput(format="vtkhdf", precision="single", compression=0, quantities=["vorticity"])
    assert main(["resume", str(out), "--until", "0.008", "--no-progress"]) == 0
    assert tp.read_results(out).times.tolist() == [0.0, 0.004, 0.008]


def test_a_tank_that_sets_off_at_once_is_warned_of_and_keeps_its_size(tmp_path):
    motion = "tank_motion.translation={form='sine', amplitude=[0.1, 0.0], frequency=2.0%s}"
    words = ["run", CASE, *COARSE, "--until", "0.03", "--no-progress"]
    with pytest.warns(UserWarning, match=r"tank_motion begins with a speed of 1\.26 m/s at t = 0"):
        assert main([*words, "--set", motion % "", "--out", str(tmp_path / "at once")]) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        assert main([*words, "--set", motion % ", soft_start=0.1", "--out", str(tmp_path / "smooth")]) == 0
    case = json.loads((tmp_path / "at once" / "case.json").read_text())
    assert case["upper"][0] - case["lower"][0] > 0.59  # all places that it has moved to
    assert case["size"] == pytest.approx([0.584, 0.584], abs=0.02)


def test_another_parameter_of_a_motion_is_another_case(tmp_path, capsys):
    motion = "tank_motion.angle={form='sine', amplitude=0.1, frequency=2.0, soft_start=%s}"
    out = tmp_path / "out"
    words = ["run", CASE, *COARSE, "--until", "0.002", "--out", str(out), "--no-progress"]
    assert main([*words, "--set", motion % 0.5]) == 0
    text = (out / "case.toml").read_text()
    assert "soft_start = 0.5" in text
    (out / "case.toml").write_text(text.replace("soft_start = 0.5", "soft_start = 0.6"))
    assert main(["resume", str(out), "--until", "0.004"]) == 2
    said = capsys.readouterr().err
    assert "tank_motion.angle: " in said
    assert "soft_start=0.6" in said


def test_a_run_that_cannot_go_on_exits_with_1(tmp_path, capsys, monkeypatch):
    def fail(self, *_, **__):
        raise tp.SimulationError("the run stops at t = 0 s")

    monkeypatch.setattr(tp.Simulation, "run", fail)
    assert main(["run", CASE, *COARSE, "--out", str(tmp_path / "out")]) == 1
    assert "the run stops" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("number", "code"), [pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow), (signal.SIGINT, 130)]
)
def test_signals_end_a_run_with_its_last_state_written(number, code, tmp_path):
    out = tmp_path / "out"
    case = str(DEMOS / "cases" / "dam_break_free_surface.toml")  # which starts sooner than with air
    words = ["run", case, "--set", "tank.spacing=0.01", "--until", "100", "--out", str(out)]
    process = subprocess.Popen([sys.executable, "-m", "tipfem", *words], stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 300
        while not (out / "history.csv").exists():
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.1)
        time.sleep(0.5)
        process.send_signal(number)
        _, said = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == code
    assert "Traceback" not in said
    assert "stopped at t = " in said
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["status"] == {143: "ended by signal 15", 130: "interrupted"}[code]
    assert "tipfem resume" in said
    with open(out / "history.csv", newline="") as file:
        steps = list(csv.DictReader(file))
    assert len(steps) == summary["steps"]
    assert (out / "fields" / f"step_{len(steps):06d}.vtu").exists()


def test_check_says_what_a_run_takes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["check", CASE, *COARSE]) == 0
    said = capsys.readouterr().out
    assert not list(tmp_path.iterdir())
    assert "no mistakes found" in said
    count = len(load_case(CASE, [COARSE[1]]).case().particles)
    assert f"particles   {count}, " in said
    assert re.search(r"steps       178\b", said)
    assert re.search(r"memory      about \d+ MB", said)
    assert "water (998.2 kg/m^3, 0.001002 Pa s), air (1.204 kg/m^3, " in said
    assert re.search(r"states      101 written to disk, with the checkpoints about \d+(\.\d+)? MB", said)
    assert "walls       left, right, bottom, top: layer, because boundary layers may be thinner" in said


def test_check_says_how_fluids_move_along_bodies(tmp_path, capsys):
    text = (DEMOS / "cases" / "floating.toml").read_text("utf-8")
    (tmp_path / "case.toml").write_text(text.replace('name = "log"', 'name = "log"\nslip = true'), "utf-8")
    assert main(["check", str(tmp_path / "case.toml"), "--no-mesh"]) == 0
    said = capsys.readouterr().out
    assert "box: layer, along the outline" in said
    assert "log: slip, along the outline" in said


@pytest.mark.slow
def test_check_draws_the_initial_state_where_it_is_told_to(tmp_path, capsys):
    assert main(["check", CASE, *COARSE, "--picture", str(tmp_path / "initial.png")]) == 0
    assert f"picture     {tmp_path / 'initial.png'}" in capsys.readouterr().out
    picture = imageio.imread(tmp_path / "initial.png")
    assert picture.shape[0] == 720
    assert 720 < picture.shape[1] < 1280  # as wide as a square tank needs
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20
    assert main(["check", CASE, *COARSE, "--picture", "no/folder.png"]) == 2
    assert main(["check", CASE, "--no-mesh", "--picture", "initial.png"]) == 2
    assert "leave out one of them" in capsys.readouterr().err


@pytest.mark.slow
def test_check_of_a_case_in_3d_draws_its_fluid(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = GOOD[: GOOD.index("[walls.top]")].replace("-9.81]", "-9.81, 0]").replace('"sharp"', '"interpolated"')
    text = text.replace("[0.3, 0.2]", "[0.2, 0.2, 0.2]").replace("spacing = 0.02", "spacing = 0.05\njitter = 0.1")
    text = text.replace("[[0, 0], [0.3, 0.1]]", "[[0, 0, 0], [0.2, 0.1, 0.2]]") + "[time]\nend = 1.0\n"
    (tmp_path / "cube.toml").write_text(text)
    assert main(["check", "cube.toml", "--picture", "cube.png"]) == 0
    assert "picture     cube.png" in capsys.readouterr().out
    picture = imageio.imread("cube.png").astype(int)
    assert picture.shape == (720, 1280, 3)
    blue = picture[..., 2] - picture[..., 0] > 40
    assert 0.02 < blue.mean() < 0.5
    assert np.flatnonzero(blue.any(axis=1))[0] > 150  # the lower half of the tank, along y


@pytest.mark.slow
def test_a_broken_file_is_refused_without_taichi(tmp_path):
    (tmp_path / "case.toml").write_text(GOOD.replace("998.2", "-998.2"))
    code = (
        "import sys; from tipfem.app.commands import main; code = main(['check', 'case.toml']); "
        "sys.exit(99 if 'taichi' in sys.modules else code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert done.stderr.splitlines() == [
        "case.toml:6: fluids.water.density is -998.2 kg/m^3; it must be a number > 0 in kg/m^3",
        "1 mistake; nothing was started",
    ]


def time_of(*words):
    """Time of the processor that a process of Python takes [s], and its exit code."""
    before = os.times()
    done = subprocess.run([sys.executable, *words], capture_output=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system, done.returncode


@pytest.mark.slow
def test_a_broken_file_is_refused_in_a_second_of_the_processor(tmp_path):
    """Compared with the time that NumPy takes to be imported, because machines differ: 7 to 8 times as long."""
    (tmp_path / "case.toml").write_text(GOOD.replace("998.2", "-998.2"))
    ratios = []
    for _ in range(5):
        unit, _ = time_of("-c", "import numpy")
        taken, code = time_of("-m", "tipfem", "check", str(tmp_path / "case.toml"))
        assert code == 2
        ratios.append(taken / unit)
        if ratios[-1] < 10:
            return
    pytest.fail(f"{ratios} times as long as importing NumPy")


@pytest.mark.slow
def test_check_without_a_mesh_needs_no_taichi(tmp_path):
    code = (
        "import sys; from tipfem.app.commands import main; "
        f"code = main(['check', {CASE!r}, '--no-mesh']); sys.exit(99 if 'taichi' in sys.modules else code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "particles   13806" in done.stdout


def test_schema_prints_or_writes_the_schema(tmp_path, capsys):
    assert main(["schema"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert main(["schema", "--out", str(tmp_path / "s.json")]) == 0
    assert json.loads((tmp_path / "s.json").read_text("utf-8")) == printed
    assert printed["properties"]["gravity"]["unit"] == "m/s^2"


def test_info_on_a_run_that_was_killed(tmp_path, capsys):
    out = tmp_path / "out"
    file = load_case(CASE, [COARSE[1]])
    simulation = file.simulation(out)
    simulation.step()
    simulation.step()
    simulation.results.close()
    with open(out / "history.csv", "a") as history:
        history.write("3,0.1")  # half a row
    assert main(["info", str(out)]) == 0
    said = capsys.readouterr().out
    assert "no summary: it was killed" in said
    FolderLock(out).take()
    assert main(["info", str(out)]) == 0
    assert "no summary: still running" in capsys.readouterr().out
    assert "steps       2, to t = " in said


@pytest.mark.slow
def test_compile_readies_each_kernel_for_short_and_long_loops(monkeypatch, capsys):
    prepared = []
    prepare = kept_kernels.prepare
    monkeypatch.setattr(kept_kernels, "prepare", lambda *given: prepared.append(given[0]) or prepare(*given))
    monkeypatch.setattr(compiling, "STEPS", 2)
    before, cases = launches.is_serial(1e9, 1.0), small_cases.cases
    monkeypatch.setattr(small_cases, "cases", lambda: islice(cases(), 1))
    assert main(["compile"]) == 0
    (count,) = re.findall(r"(\d+) kernels are ready", capsys.readouterr().out)
    assert int(count) >= len({id(kernel) for kernel in prepared})
    assert launches.is_serial(1e9, 1.0) == before
    variants = Counter(kernel._primal.func.__name__ for kernel in prepared)
    assert variants["iterate"] >= 2


def test_a_small_case_needs_what_the_control_of_long_steps_does(monkeypatch):
    (case,) = (case for case in small_cases.cases() if case.numerics.largest_move)
    lengths = []
    measured = stepper.smallest_jacobian
    monkeypatch.setattr(stepper, "smallest_jacobian", lambda *given: lengths.append(given[-1]) or measured(*given))
    tp.Simulation(case).step()
    assert lengths


def test_doctor_finds_what_is_there_and_the_cure_of_what_is_not(monkeypatch, capsys):
    tried = []

    def starts(name, code, cure, *, needed=True):
        tried.append(name)
        return inspection.Finding(name, name != "CUDA", "tried", cure, needed)

    monkeypatch.setattr(inspection, "_starts", starts)
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert tried == ["processor", "CUDA", "Vulkan"]
    assert re.search(r"none +CUDA +tried\n +optional; needs an NVIDIA GPU", said)
    for name in ("Python", "Taichi", "ffmpeg", "cache folder", "threads"):
        assert re.search(rf"ok +{name}", said)
    monkeypatch.setattr(inspection, "version", lambda name: "1.6.0")
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    assert main(["doctor"]) == 1
    said = capsys.readouterr().out
    assert re.search(r"MISSING +Taichi +1.6.0\n +pip install taichi==1.7.4", said)
    assert re.search(r"none +cache folder .*\n.*set XDG_CACHE_HOME", said)


def test_what_does_not_start_is_told_in_one_line():
    found = inspection._starts("x", "raise RuntimeError('no driver')", "install it", needed=False)
    assert (found.fine, found.what) == (False, "RuntimeError: no driver")
    crashed = inspection._starts("x", "import os; os.kill(os.getpid(), 11)", "install it")
    assert (crashed.fine, crashed.what) == (False, "ended by signal 11")
    assert inspection._starts("x", "print('other output')", "").what == "starts"
    assert inspection._starts("x", "print('starts, in software alone')", "").what == "starts, in software alone"


def test_help_names_the_exit_codes_and_all_commands(capsys):
    assert main(["--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for word in ("run", "check", "info", "doctor", "render", "schema", "143", "nothing was started"):
        assert word in said


@pytest.mark.slow
@pytest.mark.parametrize("command", ["view", "check", "sweep", "demo", "render"])
def test_exit_codes_of_runs_are_not_in_the_help_of_other_commands(command):
    done = subprocess.run([sys.executable, "-m", "tipfem", command, "--help"], capture_output=True, text=True)
    assert done.returncode == 0
    assert "SIGTERM" not in done.stdout
    assert "--no-no-" not in done.stdout
    assert "Usage: tipfem" in done.stdout or "usage: tipfem render" in done.stdout


def test_a_command_of_another_name_is_suggested(capsys):
    assert main(["study", "st.toml"]) == 2
    assert "the command for that is `tipfem sweep`" in capsys.readouterr().err


def test_render_passes_its_words_on(capsys):
    assert main(["render", "--help"]) == 0
    assert "--playback-rate" in capsys.readouterr().out


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_a_script_with_the_commands(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for word in ("tipfem", "run", "check", "overwrite"):
        assert word in script
    if shell == "bash":
        assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0


@pytest.mark.slow
def test_a_reader_that_closes_the_output_is_no_mistake():
    code = f"import sys; sys.argv[1:] = ['check', {str(CASE)!r}, '--no-mesh']; from tipfem.app.main import main; main()"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.close()  # before a line is written
    said = process.stderr.read()
    process.stderr.close()
    assert (process.wait(), said) == (1, "")

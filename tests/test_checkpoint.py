"""tipfem/run/checkpoint.py: a run goes on to the bit, and what is damaged or foreign is refused in one line."""

from __future__ import annotations

import copy
import inspect
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time as clock

import h5py
import meshio
import numpy as np
import pytest

import tipfem as tp
from tipfem.casefile.record import case_record, differences
from tipfem.errors import CheckpointError
from tipfem.run import checkpoint

GRAVITY = (0.0, -9.81)
COLUMN = ((0, 0), (0.146, 0.292))


def dam_break(water, air, spacing=0.02, **options):
    tank = tp.tank((0.584, 0.584), spacing).fill(air).fill(water, box=COLUMN)
    return tp.Case(tank, [water, air], GRAVITY, **options)


def test_what_is_written_is_read(tmp_path, water, air):
    shared = np.arange(6.0).reshape(2, 3)
    content = {
        "none": None,
        "flag": True,
        "count": 7,
        "number": 0.1 + 0.2,
        "odd": [math.inf, -math.inf, math.nan],
        "text": "spacing \u00e4",
        "pair": (1, 2.5),
        "arrays": [shared, shared, np.asfortranarray(shared), np.zeros((0, 2), dtype=np.int32)],
    }
    path = tmp_path / "c.h5"
    checkpoint.write_file(path, content)
    found = checkpoint.read_file(path, None)
    assert list(found) == list(content)
    for key in ("none", "flag", "count", "number", "text", "pair"):
        assert found[key] == content[key]
        assert type(found[key]) is type(content[key])
    assert found["odd"][:2] == [math.inf, -math.inf]
    assert math.isnan(found["odd"][2])
    for new, old in zip(found["arrays"], content["arrays"], strict=True):
        assert new.dtype == old.dtype
        assert new.tobytes() == old.tobytes()
        assert new.flags.f_contiguous == old.flags.f_contiguous
    assert found["arrays"][0] is found["arrays"][1]  # one array stays one


@pytest.mark.parametrize("value", [object(), {1: 2}, {"f": lambda: 0}, {"case": np.float64}])
def test_what_is_no_data_is_not_written(tmp_path, value):
    with pytest.raises(TypeError, match="a checkpoint"):
        checkpoint.write_file(tmp_path / "c.h5", {"value": value})
    assert not list(tmp_path.iterdir())


def damaged(path, how):
    content = bytearray(path.read_bytes())
    if how == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "foreign":
        path.write_text("time,step\n0,1\n")
    elif how == "other hdf5":
        with h5py.File(path, "w") as file:
            file["data"] = np.zeros(3)
    elif how == "other format":
        path.write_bytes(bytes(content).replace(b"tipfem checkpoint 2", b"tipfem checkpoint 9"))
    elif how == "flipped bit":
        content[len(content) // 3] ^= 4
        path.write_bytes(content)
    elif how == "other step":
        shutil.copy(path.with_name("step_000000001.h5"), path)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("truncated", "is damaged, or no checkpoint"),
        ("empty", "is damaged, or no checkpoint"),
        ("foreign", "is damaged, or no checkpoint"),
        ("other hdf5", "is damaged, or no checkpoint"),
        ("other format", "is damaged, or no checkpoint of this version"),
        ("flipped bit", "is damaged: its checksum is wrong"),
        ("other step", "is the checkpoint of step 1"),
    ],
)
def test_a_bad_file_is_one_line_and_the_one_before_is_taken(tmp_path, water, air, how, message):
    case, folder, warnings = dam_break(water, air, 0.04), checkpoint.CheckpointFolder(tmp_path), []
    folder.write(1, {"value": np.array([1.0])})
    newest = folder.write(2, {"value": np.array([2.0])})
    assert folder.read(case, warnings.append)["value"][0] == 2.0
    damaged(newest, how)
    assert folder.read(case, warnings.append)["value"][0] == 1.0
    assert len(warnings) == 1
    assert re.search(message, warnings[0])
    assert "\n" not in warnings[0]
    damaged(tmp_path / checkpoint.FOLDER / "step_000000001.h5", "empty")
    with pytest.raises(CheckpointError, match="holds no checkpoint that can be read"):
        folder.read(case, warnings.append)


def test_any_flipped_bit_is_found(tmp_path, water, air):
    """Wherever it is in the file of a whole state, also in what HDF5 keeps for itself."""
    simulation = tp.Simulation(dam_break(water, air, 0.08), tmp_path, time_step=2e-3)
    simulation.run(0.004, progress=False)
    path = checkpoint.CheckpointFolder(tmp_path).files()[0]
    whole = path.read_bytes()
    for bit in np.random.default_rng(1).integers(8 * len(whole), size=500):
        content = bytearray(whole)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match="is damaged"):
            checkpoint.read_file(path, simulation.case)


FULL_DISK = """
import resource, signal, sys
import numpy as np
from tipfem.run import checkpoint
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # so that a write beyond the limit is an error, as on a full disk
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    checkpoint.CheckpointFolder(sys.argv[1]).write(2, {"value": np.random.default_rng(1).random(100_000)})
except OSError as error:
    print("refused:", error.strerror)
"""


def test_a_disk_that_is_full_is_an_error_and_not_the_end_of_the_process(tmp_path):
    checkpoint.CheckpointFolder(tmp_path).write(1, {"value": 1})
    done = subprocess.run([sys.executable, "-c", FULL_DISK, str(tmp_path)], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "refused: File too large\n"), done.stderr
    assert [path.name for path in (tmp_path / checkpoint.FOLDER).iterdir()] == ["step_000000001.h5"]


def test_the_newest_two_and_the_start_are_kept(tmp_path):
    folder = checkpoint.CheckpointFolder(tmp_path)
    for step in (0, 5, 10, 15):
        folder.write(step, {"step": step})
    assert [path.name for path in folder.files()] == ["step_000000015.h5", "step_000000010.h5", "step_000000000.h5"]


def test_a_write_that_fails_leaves_what_there_was(tmp_path, monkeypatch):
    folder = checkpoint.CheckpointFolder(tmp_path)
    folder.write(1, {"step": 1})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space"):
        folder.write(2, {"step": 2})
    assert [path.name for path in (tmp_path / checkpoint.FOLDER).iterdir()] == ["step_000000001.h5"]


def test_cases_are_compared_value_by_value(water, air):
    one = case_record(dam_break(water, air, 0.04))
    assert differences(one, case_record(dam_break(water, air, 0.04))) == []
    thick = tp.Fluid("water", density=water.density, viscosity=0.1)
    other = dam_break(thick, air, 0.04, numerics=tp.Numerics(rho_inf=0.5), body_force=lambda x, t: 0 * x)
    lines = differences(one, case_record(other))
    assert [line.split(":")[0] for line in lines] == ["fluids.water.viscosity", "body_force", "numerics.rho_inf"]
    assert lines[2] == "numerics.rho_inf: 0.0, now 0.5"
    finer = differences(one, case_record(dam_break(water, air, 0.02)))
    assert "particles.position: other values at the start" in finer


def test_a_record_has_all_that_a_case_is_made_of(water, air):
    asked = set(inspect.signature(tp.Case).parameters)
    beside = {
        "shape",
        "period",
        "coordinates",
    }  # the domain where there is one; there where it is periodic, or axisymmetric
    assert asked - set(case_record(dam_break(water, air, 0.04))) == beside


def tank_of_drop(water, air, **options):
    tank = tp.tank((0.04, 0.04), 0.0025).fill(air).fill(water, disc=((0.02, 0.02), 0.01))
    return tp.Case(tank, [water, air], (0, 0), **options)


def openings(air, velocity):
    ends = ((0, 0.01), (0, 0.03)), ((0.04, 0.01), (0.04, 0.03))
    inlet = tp.Inlet(wall="left", between=ends[0], fluid=air, velocity=velocity)
    return [inlet, tp.Vent(wall="right", between=ends[1])]


@pytest.mark.slow(only=("surface_tension",))
@pytest.mark.parametrize("what", ["surface_tension", "openings", "contact_angle"])
def test_what_a_case_is_given_stays_when_it_is_found_in_its_folder(tmp_path, water, air, what):
    def case(value):
        pair = ("water", "air")
        if what == "contact_angle":
            tank = tp.tank((0.04, 0.04), 0.0025).fill(air).fill(water, box=((0.01, 0), (0.03, 0.01)))
            tank.wall("bottom", contact_angle={pair: 1000 * value})
            return tp.Case(tank, [water, air], (0, 0), surface_tension={pair: 0.0728})
        return tank_of_drop(water, air, **{what: {pair: value} if what == "surface_tension" else openings(air, value)})

    simulation = tp.Simulation(case(0.05), tmp_path, time_step=1e-3)
    simulation.run(2e-3, progress=False)
    resumed = tp.Simulation.resume(tmp_path)
    resumed.run(4e-3, progress=False)
    simulation.run(4e-3, progress=False)
    for field in ("position", "velocity", "pressure"):
        assert getattr(resumed.particles, field).tobytes() == getattr(simulation.particles, field).tobytes(), field
    with pytest.raises(CheckpointError, match=rf"{what}\..*: (0.05|50.0), now (0.03|30.0)"):
        tp.Simulation.resume(tmp_path, case(0.03))


def tidy(path):
    """The lines of a history without the column of wall-clock times."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    at = rows[0].index("wall_seconds")
    return [row[:at] + row[at + 1 :] for row in rows]


FUNCTION = {"column": lambda simulation: simulation.particles.max_speed}

CASES = {
    "sharp": lambda water, air: dam_break(water, air),
    "interpolated": lambda water, air: dam_break(water, air, interface="interpolated"),
    "graded": lambda water, air: dam_break(water, air, 0.01, grading=tp.Grading({"air": 0.03})),
    "free surface": lambda water, air: tp.Case(
        tp.tank((0.584, 0.584), 0.02).fill(water, box=COLUMN), [water], GRAVITY, free_surface=True
    ),
    "walls": lambda water, air: tp.Case(
        tp.tank((0.584, 0.584), 0.02)
        .fill(air)
        .fill(water, box=COLUMN)
        .wall("left", slip=True)
        .wall("bottom", slip_length=1e-3)
        .wall("top", velocity=(0.3, 0.0))
        .wall("right", law="layer"),
        [water, air],
        GRAVITY,
    ),
    "two-sided pressure": lambda water, air: dam_break(water, air, numerics=tp.Numerics(pressure="two-sided")),
    "moving": lambda water, air: dam_break(
        water, air, tank_motion=tp.Motion(angle=lambda t: 0.3 * np.sin(8 * t) ** 2, pivot=(0.3, 0.0))
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_resumed_run_is_the_uninterrupted_one_to_the_bit(tmp_path, water, air, name):
    """Histories, probes, fields and states, at the end of a run that was stopped between two outputs."""

    def simulation(out):
        probe = tp.PointProbe(name="gauge", at=(0.05, 0.05), interval=0.007)
        force = tp.WallForce(name="force", wall="left", interval=0.004, impulse=True, time_constant=0.005)
        return tp.Simulation(
            CASES[name](water, air),
            out,
            time_step=2e-3,
            output_interval=0.02,
            columns=FUNCTION,
            probes=[probe, force],
            checkpoint_interval=0.01,
        )

    whole = simulation(tmp_path / "whole")
    whole.run(0.06, progress=False)
    stopped = simulation(tmp_path / "stopped")

    def stop(_):
        if stopped.time > 0.033:
            raise KeyboardInterrupt
        return stopped.particles.max_speed

    # The run is killed: nothing that is done on the way out may be of importance.
    stopped.recorded.columns = {"column": stop}
    copied = tmp_path / "killed"
    real = stopped.checkpoints.finish

    def copy_first(flow, until):
        if flow.time > 0.033 and not copied.exists():
            shutil.copytree(flow.results.path, copied)
        real(flow, until)

    stopped.checkpoints.finish = copy_first
    with pytest.raises(KeyboardInterrupt):
        stopped.run(0.06, progress=False)
    stopped.results.close()
    (copied / ".lock").unlink(missing_ok=True)
    probes = list(whole.probes.probes.values())
    resumed = tp.Simulation.resume(copied, CASES[name](water, air), columns=FUNCTION, probes=probes)
    assert resumed.notes == []
    assert 0.02 < resumed.time <= 0.033
    resumed.run(resumed.until, progress=False)
    for field in ("position", "velocity", "acceleration", "pressure", "fluid", "wall"):
        assert getattr(resumed.particles, field).tobytes() == getattr(whole.particles, field).tobytes(), field
    assert tidy(copied / "history.csv") == tidy(tmp_path / "whole" / "history.csv")
    names = sorted(path.relative_to(copied) for path in copied.rglob("*.*") if path.suffix in (".vtu", ".pvd", ".csv"))
    there = sorted(
        path.relative_to(tmp_path / "whole")
        for path in (tmp_path / "whole").rglob("*.*")
        if path.suffix in (".vtu", ".pvd", ".csv")
    )
    assert names == there
    for path in names:
        if path.name != "history.csv":
            assert (copied / path).read_bytes() == (tmp_path / "whole" / path).read_bytes(), path


def test_a_case_without_functions_is_found_in_its_folder(tmp_path, water, air):
    simulation = tp.Simulation(dam_break(water, air, 0.04), tmp_path, time_step=2e-3)
    simulation.run(0.01, progress=False)
    resumed = tp.Simulation.resume(tmp_path)
    assert resumed.time == 0.01
    resumed.run(0.02, progress=False)
    simulation.run(0.02, progress=False)
    assert resumed.particles.position.tobytes() == simulation.particles.position.tobytes()


def test_rows_of_walls_along_a_period_are_those_of_the_run(tmp_path, water, air):
    """Not those of the case, which has other particles once the mesh has changed."""
    tank = tp.tank((0.2, 0.1), 0.02, periodic="x").fill(air).fill(water, box=((0, 0), (0.2, 0.05)))
    case = tp.Case(tank.wall("bottom", slip=True).wall("top", slip=True), [water, air], GRAVITY)
    boundary = copy.copy(case.boundary)
    boundary.endless = [row[::-1] for row in boundary.endless]
    checkpoint.write_file(tmp_path / "c.h5", {"boundary": boundary})
    found = checkpoint.read_file(tmp_path / "c.h5", case)["boundary"]
    assert [row.tolist() for row in found.endless] == [row.tolist() for row in boundary.endless]
    assert len(found.endless) == 2
    assert found.walls is case.boundary.walls


@pytest.mark.slow(but=("planar",))
@pytest.mark.parametrize("coordinates", ["planar", "axisymmetric"])
def test_a_tank_of_a_shape_is_found_though_no_case_file_keeps_how_it_is_filled(tmp_path, water, air, coordinates):
    """Filled by a function of Python's, so that the checkpoint alone has the case."""
    corners, names = [(0, 0), (0.4, 0.1), (0.4, 0.5), (0, 0.5)], ["floor", "side", "top", "left"]
    tank = tp.tank(shape=tp.shapes.polygon(corners, names=names), spacing=0.04, coordinates=coordinates)
    tank.fill(air).fill(water, where=lambda x: x[:, 1] < 0.3).wall("floor", slip=True)
    case = tp.Case(tank, [water, air], GRAVITY)
    simulation = tp.Simulation(case, tmp_path, time_step=2e-3)
    simulation.run(0.01, progress=False)
    before = {key: value for key, value in case_record(case).items() if key != "domain"}  # of an earlier version
    resumed = tp.Simulation.resume(tmp_path)
    assert resumed.case.tank is None
    assert differences(case_record(case), case_record(resumed.case)) == differences(before, case_record(case)) == []
    other = {**case_record(case), "domain": {**case_record(case)["domain"], "sides": ["bottom", *names[1:]]}}
    assert len(differences(other, case_record(case))) == 1
    resumed.run(0.02, progress=False)
    simulation.run(0.02, progress=False)
    assert resumed.particles.position.tobytes() == simulation.particles.position.tobytes()


def test_what_does_not_fit_the_run_is_refused_in_one_line(tmp_path, water, air):
    with pytest.raises(CheckpointError, match="holds no checkpoint that can be read: there is no such folder"):
        tp.Simulation.resume(tmp_path / "nothing")
    with pytest.raises(CheckpointError, match="is it the results folder of a run"):
        tp.Simulation.resume(tmp_path)
    push = dam_break(water, air, 0.04, body_force=lambda x, t: 0 * x)
    tp.Simulation(push, tmp_path, time_step=2e-3, columns=FUNCTION).run(0.004, progress=False)
    with pytest.raises(CheckpointError, match="functions of Python's, which no file keeps: body_force"):
        tp.Simulation.resume(tmp_path)
    with pytest.raises(CheckpointError, match=r"the run had the columns \['column'\], and \[\] are given"):
        tp.Simulation.resume(tmp_path, push)
    softer = dam_break(water, air, 0.04, body_force=lambda x, t: 0 * x, numerics=tp.Numerics(rho_inf=0.5))
    with pytest.raises(CheckpointError, match=r"numerics.rho_inf: 0.0, now 0.5; .* may change with allow_changes"):
        tp.Simulation.resume(tmp_path, softer, columns=FUNCTION)
    resumed = tp.Simulation.resume(tmp_path, softer, columns=FUNCTION, allow_changes=True)
    assert resumed.notes == ["changed: numerics.rho_inf: 0.0, now 0.5"]
    resumed.results.close()
    thick = tp.Fluid("water", density=1000.0, viscosity=0.1)
    with pytest.raises(CheckpointError, match=r"fluids.water.density: 998\.2, now 1000\.0"):
        tp.Simulation.resume(tmp_path, dam_break(thick, air, 0.04), columns=FUNCTION, allow_changes=True)


UNTIL = 0.2  # end of the runs that are killed [s]
SCRIPT = f"""
import sys
import tipfem as tp
tp.init(threads=int(sys.argv[2]))
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
tank = tp.tank((0.584, 0.584), 0.02).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
case = tp.Case(tank, [water, air], (0, -9.81))
if "resume" in sys.argv:
    simulation = tp.Simulation.resume(sys.argv[1])
    assert simulation.notes == [], simulation.notes
    until = simulation.until
else:
    simulation = tp.Simulation(case, sys.argv[1], time_step=1e-3, output_interval=0.02, checkpoint_interval=0.004)
    until = {UNTIL}
print("begins", flush=True)
simulation.run(until, progress=False)
"""


def start(out, *words, threads=1):
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(out), str(threads), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The results of a run that nothing stops, on all threads of this process."""
    out = tmp_path_factory.mktemp("whole")
    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
    air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
    simulation = tp.Simulation(
        dam_break(water, air), out, time_step=1e-3, output_interval=0.02, checkpoint_interval=0.004
    )
    simulation.run(UNTIL, progress=False)
    return out


def go_on(out, delay, *words, threads=1):
    """A run, from its last checkpoint or from the start, some time after it has written a checkpoint [s]."""
    before = {path.name for path in out.glob("checkpoints/*.h5")}
    process = start(out, *words, threads=threads)
    process.stdout.readline()
    while {path.name for path in out.glob("checkpoints/*.h5")} <= before:
        assert process.poll() is None, process.stderr.read()
        clock.sleep(0.01)
    clock.sleep(delay)
    return process


def kill(process, out):
    """By SIGKILL: no file under its own name is truncated."""
    process.kill()
    process.wait()
    assert (out / ".lock").exists()
    for path in out.glob("checkpoints/*.h5"):
        checkpoint.read_file(path, None)
    for path in out.glob("fields/*.vtu"):
        meshio.read(path)


def end(process, out, number, status):
    """By a signal: the run ends with a checkpoint."""
    process.send_signal(number)
    code = process.wait(60)
    error = process.stderr.read()
    assert code == status or (number == signal.SIGINT and code == 1 and "KeyboardInterrupt" in error), (code, error)
    summary = json.loads((out / "summary.json").read_text())
    steps = len(tidy(out / "history.csv")) - 1
    assert summary["steps"] == steps
    assert summary["status"] != "complete"
    assert (out / "checkpoints" / checkpoint.file_name(steps)).exists()
    assert not (out / ".lock").exists()


def is_in_use(process, out, case):
    """While a run lives no other takes its folder; what it leaves when it is killed is asked for."""
    with pytest.raises(ValueError, match=f"is in use by process {process.pid} on "):
        tp.Simulation(case, out)


def is_left(out, case):
    """The folder of a run that was killed: its lock is stale, and its results are not overwritten unasked."""
    with pytest.raises(ValueError, match=r"holds the results of a run of 0:00:\d+; name another folder"):
        tp.Simulation(case, out, overwrite=False)
    tp.Simulation(case, out).results.close()
    assert not list(out.glob("checkpoints/*.h5"))
    assert not (out / ".lock").exists()


def goes_on_to_the_end_as(out, whole):
    """A run that was stopped is resumed in this process, and has the history and outputs of the whole one."""
    resumed = tp.Simulation.resume(out)
    assert resumed.notes == []
    assert 0 < resumed.time < UNTIL
    resumed.run(resumed.until, progress=False)
    assert tidy(out / "history.csv") == tidy(whole / "history.csv")
    assert (out / "fields.pvd").read_text() == (whole / "fields.pvd").read_text()


@pytest.mark.slow
def test_killed_and_ended_by_a_signal_it_goes_on_to_the_bit(tmp_path, whole, water, air):
    """On one thread at first, killed, ended by a signal, and then on all threads of this process."""
    out = tmp_path / "run"
    process = go_on(out, 0.0)
    is_in_use(process, out, dam_break(water, air, 0.04))
    kill(process, out)
    is_left(shutil.copytree(out, tmp_path / "copy"), dam_break(water, air, 0.04))
    end(go_on(out, 0.0, "resume"), out, signal.SIGTERM, 143)
    goes_on_to_the_end_as(out, whole)


@pytest.mark.slow
def test_killed_again_and_ended_by_other_signals_it_goes_on_to_the_bit(tmp_path, whole):
    """At other numbers of threads each time."""
    out, two = tmp_path / "run", min(2, len(os.sched_getaffinity(0)))
    kill(go_on(out, 0.2, threads=two), out)
    kill(go_on(out, 0.3, "resume"), out)
    end(go_on(out, 0.1, "resume", threads=two), out, signal.SIGINT, -signal.SIGINT)
    end(go_on(out, 0.0, "resume"), out, signal.SIGHUP, 129)
    goes_on_to_the_end_as(out, whole)


@pytest.mark.slow
def test_the_kth_write_fails_and_nothing_that_was_readable_is_lost(tmp_path, water, air, monkeypatch):
    """k = 1, 2, ...: every file that is put under its own name, until a whole run passes."""
    real, case = os.replace, dam_break(water, air, 0.08)
    messages = []
    for k in range(1, 200):
        count = 0
        out = tmp_path / str(k)
        simulation = tp.Simulation(case, out, time_step=4e-3, output_interval=0.008, checkpoint_interval=0.008)

        def replace(source, target, k=k):
            nonlocal count
            count += 1
            if count >= k:
                raise OSError(28, "No space left on device", str(target))
            real(source, target)

        monkeypatch.setattr(os, "replace", replace)
        try:
            simulation.run(0.02, progress=False)
            break
        except tp.SimulationError as error:
            messages.append(str(error))
        finally:
            monkeypatch.setattr(os, "replace", real)
            simulation.results.close()
        assert not list(out.rglob("*.part"))
        for path in out.glob("fields/*.vtu"):
            meshio.read(path)
        for path in out.glob("checkpoints/*.h5"):
            checkpoint.read_file(path, case)
        if list(out.glob("checkpoints/*.h5")):
            resumed = tp.Simulation.resume(out)
            if resumed.time < 0.02:
                resumed.run(0.02, progress=False)
            resumed.results.close()
    else:
        pytest.fail("the run never passed")
    assert len(messages) > 8
    assert all("No space left on device" in message for message in messages)
    assert tidy(tmp_path / str(len(messages)) / "history.csv") == tidy(out / "history.csv")

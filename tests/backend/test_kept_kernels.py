"""Kept machine code gives the same bits as Taichi's, and no file is run that is not whole, own and of its kernel."""

import json
import logging
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import kept_kernels, kernel_files
from tipfem.backend.array_types import Array1, Reals1, Template
from tipfem.backend.fingerprint import NotKeptError, fingerprint
from tipfem.backend.kernel_files import UntrustedError
from tipfem.backend.launch import kernel, launch
from tipfem.backend.machine_code import UnsuitableError, one_function, with_constant_arguments
from tipfem.backend.runtime import init, settings, threads

FACTOR = 3.0


@ti.func
def multiplied(x):
    return FACTOR * x


@kernel
def tripled(values: Reals1, result: Reals1, n: ti.i32, shift: float, twice: Template) -> float:
    """result = FACTOR values + shift, or twice that; the last of them is returned."""
    last = 0.0
    for i in range(n):
        result[i] = (multiplied(values[i]) + shift) * (2.0 if ti.static(twice) else 1.0)
    ti.loop_config(serialize=True)
    for i in range(n):
        last = result[i]
    return last


@kernel
def random(values: Array1):
    """Needs the state of Taichi's random numbers."""
    for i in values:
        values[i] = ti.random()


@pytest.fixture(autouse=True)
def _runtime():
    init()
    if not kept_kernels._library:
        pytest.skip("kernels are not kept here")


@pytest.fixture
def library(tmp_path, monkeypatch):
    """An empty library of this process's settings, without what a wheel that was made here has."""
    monkeypatch.setattr(kept_kernels, "SHIPPED", tmp_path / "shipped")
    return kept_kernels.Library(tmp_path / "kept", threads())


def start(library, values, shift=1.0, twice=False):
    """What `tripled` makes of the values, by a library."""
    arguments = (values, np.zeros(len(values)), len(values), shift, twice)
    last = library.prepare(tripled.taichi, tripled._annotations, arguments)(arguments)
    assert last == arguments[1][-1]
    return arguments[1]


def the_file(library):
    """The only file of a kernel that it keeps."""
    (path,) = library._folder.glob("tripled-*")
    return path


CASES = """
import hashlib, json, logging, sys
import numpy as np
import tipfem as tp
from tipfem.backend import kept_kernels
not_kept, logger = [], logging.getLogger("tipfem")
logger.setLevel(logging.DEBUG)
logger.addFilter(lambda record: not_kept.append(record.getMessage()) if "is not kept" in record.getMessage() else True)
tp.init(threads=int(sys.argv[1]))
air, water, g = tp.Fluid("air", 1.2, 1.8e-5), tp.Fluid("water", 1000.0, 1e-3), (0.0, -9.81)
body = tp.Body([(0.15, 0.1), (0.25, 0.1), (0.25, 0.18), (0.15, 0.18)], density=500.0)

def tank(**options):
    return tp.tank((0.4, 0.3), 0.02, **options).fill(air).fill(water, box=((0, 0), (0.12, 0.24)))

CASES = {
    "two fluids, graded": lambda: tp.Case(tank(), [air, water], g, grading=tp.Grading({"air": 0.04})),
    "free surface": lambda: tp.Case(
        tp.tank((0.4, 0.3), 0.02).fill(water, box=((0, 0), (0.12, 0.24))), [water], g, free_surface=True
    ),
    "periodic": lambda: tp.Case(tank(periodic="x"), [air, water], g),
    "body": lambda: tp.Case(tank().add(body), [air, water], g),
    "three axes": lambda: tp.Case(
        tp.tank((0.2, 0.2, 0.2), 0.05, jitter=0.1).fill(air).fill(water, box=((0, 0, 0), (0.1, 0.2, 0.1))),
        [air, water], (0, 0, -9.81), interface="interpolated",
    ),
}
for name, case in CASES.items():
    simulation = tp.Simulation(case(), time_step=2e-3)
    for _ in range(20):
        simulation.step()
    state, bits = simulation.particles, hashlib.sha256()
    for array in (state.position, state.velocity, state.acceleration, state.pressure, simulation.mesh.cells):
        bits.update(np.ascontiguousarray(array).tobytes())
    print(json.dumps([name, len(state), bits.hexdigest()]))
library = kept_kernels._library
print(json.dumps(len(library[0]._loaded) if library else 0))
print(json.dumps(not_kept))
"""


def run(script, *arguments, **environment):
    """A script in a process of its own; what it has printed, from JSON."""
    done = subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.slow
def test_twenty_steps_of_five_cases_are_the_same_bit_by_bit():
    *states, kept, not_kept = run(CASES, 1)
    *by_taichi, none, _ = run(CASES, 1, TIPFEM_KERNELS="taichi")
    assert kept > 50
    assert not_kept == []
    assert none == 0
    assert states == by_taichi
    assert len({bits for *_, bits in states}) == 5
    if threads() > 1:
        *shared, kept, _ = run(CASES, 2)
        assert kept > 50
        assert shared == by_taichi


def test_a_kernel_is_made_once_and_read_by_the_next_process(library, monkeypatch):
    values = np.arange(5000.0)
    np.testing.assert_array_equal(start(library, values), 3 * values + 1)
    np.testing.assert_array_equal(start(library, values, -2.0, True), 6 * values - 4)
    assert len(list(library._folder.glob("tripled-*"))) == 2
    again = kept_kernels.Library(library._folder.parent, threads())
    monkeypatch.setattr(again, "_make", None)  # nothing is compiled
    np.testing.assert_array_equal(start(again, values, 0.5), 3 * values + 0.5)


def test_a_kernel_is_made_once_for_any_number_of_threads(library, monkeypatch):
    values = np.arange(50.0)
    assert start(library, values)[-1] == 148.0
    other = kept_kernels.Library(library._folder.parent, threads() + 1)
    monkeypatch.setattr(other, "_make", None)
    assert start(other, values)[-1] == 148.0
    most = kept_kernels.Library(library._folder.parent, kept_kernels.SHARES + 1)  # which share loops otherwise
    assert most._folder != library._folder


def test_shipped_kernels_are_used_and_damaged_or_foreign_ones_are_not(library, tmp_path, monkeypatch, caplog):
    values = np.arange(50.0)
    start(library, values)
    shipped = kept_kernels.SHIPPED
    shutil.copytree(library._folder, shipped / library._folder.name)
    foreign = shipped / "0123456789abcdef"
    foreign.mkdir()
    (foreign / the_file(library).name).write_bytes(b"of another version")
    first = kept_kernels.Library(tmp_path / "first", threads())
    monkeypatch.setattr(first, "_make", None)  # nothing is compiled
    assert start(first, values)[-1] == 148.0
    assert not list(first._folder.iterdir())
    (path,) = (shipped / library._folder.name).glob("tripled-*")
    path.write_bytes(path.read_bytes()[:-1])
    with caplog.at_level(logging.WARNING, "tipfem"):
        again = kept_kernels.Library(tmp_path / "first", threads())
        assert start(again, values)[-1] == 148.0
    (record,) = caplog.records
    assert f"{path} is ignored" in record.getMessage()
    assert the_file(again).exists()


def test_a_changed_constant_is_another_kernel(library, monkeypatch):
    values = np.arange(3.0)
    before = fingerprint(tripled.taichi._primal.func)
    monkeypatch.setitem(globals(), "FACTOR", 4.0)
    assert fingerprint(tripled.taichi._primal.func) != before
    monkeypatch.setitem(globals(), "FACTOR", object())
    with pytest.raises(NotKeptError, match="object"):
        fingerprint(tripled.taichi._primal.func)
    arguments = (values, values.copy(), 3, 0.0, False)
    assert library.prepare(tripled.taichi, tripled._annotations, arguments) is None


DAMAGE = {
    "truncated": lambda content: content[:-100],
    "empty": lambda content: b"",
    "a changed byte": lambda content: content[:-50] + bytes([content[-50] ^ 1]) + content[-49:],
    "text": lambda content: b"hello\n" * 100,
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_told_in_one_line_and_made_anew(library, damage, caplog):
    values = np.arange(4.0)
    start(library, values)
    path = the_file(library)
    content = path.read_bytes()
    path.write_bytes(DAMAGE[damage](content))
    with caplog.at_level(logging.WARNING, "tipfem"):
        again = kept_kernels.Library(library._folder.parent, threads())
        np.testing.assert_array_equal(start(again, values), 3 * values + 1)
    (record,) = caplog.records
    assert str(path) in record.getMessage()
    assert kernel_files.read(path, again._environment) is not None  # whole again


@pytest.mark.parametrize("kind", ["folder", "pipe", "link"])
def test_what_is_no_file_under_its_name_is_told_and_not_waited_for(library, kind, caplog):
    values = np.arange(4.0)
    start(library, values)
    path = the_file(library)
    path.rename(path.with_name("elsewhere"))
    {"folder": path.mkdir, "pipe": lambda: os.mkfifo(path), "link": lambda: path.symlink_to("elsewhere")}[kind]()
    with caplog.at_level(logging.WARNING, "tipfem"):
        again = kept_kernels.Library(library._folder.parent, threads())
        np.testing.assert_array_equal(start(again, values), 3 * values + 1)
    assert str(path) in caplog.records[0].getMessage()
    assert len(caplog.records) == (2 if kind == "folder" else 1)  # which cannot be replaced


def test_a_damaged_folder_is_told_in_one_line(library, caplog):
    values = np.arange(4.0)
    for twice in (False, True):
        start(library, values, twice=twice)
    for path in library._folder.iterdir():
        path.write_bytes(b"damaged")
    with caplog.at_level(logging.WARNING, "tipfem"):
        again = kept_kernels.Library(library._folder.parent, threads())
        for twice in (False, True):
            start(again, values, twice=twice)
    (record,) = caplog.records
    assert "made anew: it is not a kernel; so are others like it" in record.getMessage()


def test_a_compiler_whose_parent_has_gone_ends_without_a_word():
    code = "import sys; sys.stdout.close(); from tipfem.backend.host_compiler import serve; import os; serve('f64')"
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-c", code], stdin=subprocess.DEVNULL, stdout=write, stderr=subprocess.PIPE)
    os.close(write)
    assert b"Traceback" not in done.stderr
    assert b"Exception" not in done.stderr


def test_a_file_of_another_processor_or_user_or_kernel_is_not_run(library, tmp_path):
    start(library, np.arange(4.0))
    path, environment = the_file(library), library._environment
    with pytest.raises(UntrustedError, match="other settings"):
        kernel_files.read(path, environment[::-1])
    other = path.with_name("other")
    other.write_bytes(path.read_bytes())
    other.chmod(0o600)
    with pytest.raises(UntrustedError, match="another kernel"):
        kernel_files.read(other, environment)
    link = path.with_name("link")
    link.symlink_to(path)
    with pytest.raises(UntrustedError):
        kernel_files.read(link, environment)
    path.chmod(0o666)
    with pytest.raises(UntrustedError, match="other users can write to it"):
        kernel_files.read(path, environment)
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    with pytest.raises(UntrustedError, match="other users can write to it"):
        kept_kernels.Library(tmp_path / "open", 1)


def test_files_written_first_go_when_there_are_too_many(tmp_path, monkeypatch):
    for number in range(5):
        (tmp_path / str(number)).write_bytes(bytes(100))
        os.utime(tmp_path / str(number), (number, number))
    monkeypatch.setattr(kernel_files, "MOST_BYTES", 250)
    kernel_files.remove_oldest(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["3", "4"]


def test_code_that_needs_more_of_taichi_is_left_to_taichi(library):
    values = np.zeros(50)
    assert library.prepare(random.taichi, random._annotations, (values,)) is None
    launch(random, values)
    assert len(set(values)) > 40
    with pytest.raises(UnsuitableError):
        one_function("define void @task() {\n ret void\n}\n", ["task"], "kernel")


def test_tasks_may_name_the_type_of_their_argument_differently(library):
    """As Taichi names it where it links what it has compiled apart."""
    texts = [f"%struct.RuntimeContext.{n} = type {{ i8*, %struct.LLVMRuntime*, i32, i64* }}" for n in (3, 21)]
    for task, number in (("one", 3), ("other", 21)):
        texts.append(f"define void @{task}(%struct.RuntimeContext.{number}* %context) {{\n  ret void\n}}")
    text = one_function("\n".join(texts), ["one", "other"], "kernel")
    assert library._machine.compile(f"%struct.LLVMRuntime = type opaque\n{text}")


TASK = """
define void @task(%struct.RuntimeContext.3* %context) {
  %0 = bitcast %struct.RuntimeContext.3* %context to { { { i32 }, double* } }**
  %1 = load { { { i32 }, double* } }*, { { { i32 }, double* } }** %0, align 8
  %2 = getelementptr { { { i32 }, double* } }, { { { i32 }, double* } }* %1, i64 0, i32 0, i32 1
  %3 = load double*, double** %2, align 8
  %4 = load double, double* %3, align 8
}
define void @other(%struct.RuntimeContext.3* %context, double** %2) {
  %copy = alloca %struct.RuntimeContext.3
  %0 = bitcast %struct.RuntimeContext.3* %copy to { { { i32 }, double* } }**
  %1 = load { { { i32 }, double* } }*, { { { i32 }, double* } }** %0, align 8
  %3 = load double*, double** %2, align 8
}
"""


def test_only_what_a_kernel_is_given_counts_as_constant():
    task, other = with_constant_arguments(TASK).split("define void @other")
    constant = [line.split()[0] for line in task.splitlines() if line.endswith("!invariant.load !9999")]
    assert constant == ["%1", "%3"]
    assert "!invariant" not in other
    assert with_constant_arguments("define void @f() {") == "define void @f() {"


SMALL = """
import json, sys
from pathlib import Path
import numpy as np
import tipfem as tp
from tipfem.backend import kept_kernels
from tipfem.linalg import vector_kernels
from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
kept_kernels.SHIPPED = Path("none")
tp.init(threads=1)
buffers = Buffers()
krylov, partial = buffers.upload("krylov", np.arange(500.0)), buffers.partials("partial", 3, flat=True)
launch(vector_kernels.orthogonalise, krylov, partial, buffers.get("results", 10), 1, 100, 0.0, work=(100, 1.0))
print(json.dumps(download(krylov, 500).tolist()))
print(json.dumps(len(kept_kernels._library)))
"""


@pytest.mark.slow
def test_several_processes_may_fill_one_library_and_a_switch_turns_it_off(tmp_path):
    environment = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path)}
    command = [sys.executable, "-c", SMALL]
    off = run(SMALL, **{**environment, "TIPFEM_KERNELS": "taichi"})
    assert off[1] == 0
    assert not (tmp_path / "tipfem").exists()
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) for _ in range(2)]
    found = [[json.loads(line) for line in each.communicate()[0].splitlines()] for each in both]
    assert found == [[off[0], 1]] * 2
    names = sorted(path.name.partition("-")[0] for path in (tmp_path / "tipfem").rglob("*") if path.is_file())
    assert names == ["orthogonalise", "threads"]  # and no file half written


def test_a_wrong_choice_is_an_error(monkeypatch):
    monkeypatch.setenv("TIPFEM_KERNELS", "both")
    with pytest.raises(ValueError, match="TIPFEM_KERNELS is 'both'; it must be one of"):
        kept_kernels.chosen()
    assert settings()["arch"] == "cpu"

"""tipfem/fields: VTKHDF files, read back by VTK; changes that come into force in one piece."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time as clock

import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

from tipfem.results.fields import FieldOutput, FieldState, vtkhdf, vtu
from tipfem.results.fields import atomic_file as atomic
from tipfem.results.fields.atomic_file import AtomicFile, journal_of, recover

NAMES = ("velocity", "pressure", "fluid", "density", "wall")


def state(step: int, dimension: int = 2, owners: bool = True) -> FieldState:
    """A state of random numbers; particles, cells and spray differ from step to step."""
    rng = np.random.default_rng(step)
    count, cells = int(rng.integers(50, 900)), int(rng.integers(1, 1500))
    return FieldState(
        step,
        0.1 * step,
        rng.normal(size=(count, dimension)),
        rng.normal(size=(count, dimension)),
        rng.normal(size=count),
        rng.integers(0, 3, count),
        rng.uniform(1, 1000, count),
        rng.integers(0, 2, count).astype(bool),
        rng.integers(0, count, (cells, dimension + 1)),
        rng.integers(0, 3, cells) if owners else None,
        rng.choice(count, step % 4, replace=False),
    )


def read_back(path, number: int, dimension: int) -> FieldState:
    """A state of a VTKHDF file, with its step and time."""
    steps, times = vtkhdf.times(path)
    return vtkhdf.read(path, number, dimension).fields(steps[number], float(times[number]))


def content(grid) -> dict[str, np.ndarray]:
    """What VTK has read, as arrays."""
    cells = grid.GetCells()
    found = {
        "points": vtk_to_numpy(grid.GetPoints().GetData()),
        "corners": vtk_to_numpy(cells.GetConnectivityArray()),
        "offsets": vtk_to_numpy(cells.GetOffsetsArray()),
        "types": np.array([grid.GetCellType(k) for k in range(grid.GetNumberOfCells())]),
    }
    for name in NAMES:
        found[name] = vtk_to_numpy(grid.GetPointData().GetArray(name))
    owners = grid.GetCellData().GetArray("fluid")
    return found if owners is None else {**found, "owners": vtk_to_numpy(owners)}


def by_vtk(path) -> list[tuple[float, dict[str, np.ndarray]]]:
    """All stored times of a VTKHDF file, as VTK reads them."""
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    found = []
    for number in range(reader.GetNumberOfSteps()):
        reader.SetStep(number)
        reader.Update()
        found.append((reader.GetTimeValue(), content(reader.GetOutputDataObject(0))))
    return found


def vtu_by_vtk(path) -> dict[str, np.ndarray]:
    """A VTU file, as VTK reads it."""
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return content(reader.GetOutput())


def assert_same(one: FieldState, other: FieldState) -> None:
    """All values of two states are the same, to the bit."""
    for name, value in vars(one).items():
        if value is None:
            assert getattr(other, name) is None
        else:
            np.testing.assert_array_equal(getattr(other, name), value, err_msg=name)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("owners", [True, False])
@pytest.mark.parametrize("compression", [0, 4])
def test_vtk_reads_what_it_reads_from_vtu(tmp_path, dimension, owners, compression):
    path, output = tmp_path / "f.vtkhdf", FieldOutput(format="both", compression=compression)
    states = [state(step, dimension, owners) for step in range(5)]
    for one in states:
        vtkhdf.append(path, one, output)
        vtu.write(tmp_path / f"{one.step}.vtu", one)
    found = by_vtk(path)
    assert len(found) == 5
    for (time, values), one in zip(found, states, strict=True):
        assert time == one.time
        expected = vtu_by_vtk(tmp_path / f"{one.step}.vtu")
        assert set(values) == set(expected)
        assert ("owners" in values) == owners
        for name, value in expected.items():
            np.testing.assert_array_equal(values[name], value, err_msg=name)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("owners", [True, False])
def test_states_are_read_as_they_were(tmp_path, dimension, owners):
    path = tmp_path / "f.vtkhdf"
    states = [state(step, dimension, owners) for step in (0, 3, 7, 8)]
    for one in states:
        vtkhdf.append(path, one, FieldOutput())
        vtu.write(tmp_path / "one.vtu", one)
        assert_same(one, vtu.read(tmp_path / "one.vtu", dimension).fields(one.step, one.time))
    steps, times = vtkhdf.times(path)
    assert steps == [0, 3, 7, 8]
    np.testing.assert_array_equal(times, [one.time for one in states])
    for number, one in enumerate(states):
        assert_same(one, read_back(path, number, dimension))


def test_single_precision_and_compression_take_less_space(tmp_path):
    sizes = {}
    for precision in ("double", "single"):
        for compression in (0, 9):
            path = tmp_path / f"{precision}{compression}"
            vtkhdf.write(
                path, [state(3)] * 3, FieldOutput(format="vtkhdf", precision=precision, compression=compression)
            )
            sizes[precision, compression] = path.stat().st_size
            read = read_back(path, 1, 2)
            assert read.velocity.dtype == read.position.dtype == ("f8" if precision == "double" else "f4")
            np.testing.assert_allclose(read.pressure, state(3).pressure, rtol=1e-7)
    assert sizes["single", 0] < sizes["double", 0]
    assert sizes["single", 9] < sizes["double", 9] < sizes["double", 0]
    vtu.write(tmp_path / "d", state(3))
    vtu.write(tmp_path / "s", state(3), FieldOutput(precision="single"))
    assert (tmp_path / "s").stat().st_size < 0.7 * (tmp_path / "d").stat().st_size


def test_a_step_written_again_replaces_it_and_what_came_later(tmp_path):
    path = tmp_path / "f.vtkhdf"
    for step in (1, 2, 3, 2, 5):
        vtkhdf.append(path, state(step), FieldOutput())
    assert vtkhdf.times(path)[0] == [1, 2, 5]
    assert_same(state(5), read_back(path, 2, 2))
    assert [time for time, _ in by_vtk(path)] == [0.1, 0.2, 0.5]


def test_states_after_a_checkpoint_are_removed(tmp_path):
    path = tmp_path / "f.vtkhdf"
    vtkhdf.truncate(path, [1])
    for step in (1, 2, 3, 4):
        vtkhdf.append(path, state(step), FieldOutput())
    vtkhdf.truncate(path, [1, 2, 3, 4])
    assert vtkhdf.times(path)[0] == [1, 2, 3, 4]
    vtkhdf.truncate(path, [1, 2, 9])
    assert vtkhdf.times(path)[0] == [1, 2]
    vtkhdf.append(path, state(7), FieldOutput())
    for number, step in enumerate((1, 2, 7)):
        assert_same(state(step), read_back(path, number, 2))
    assert len(by_vtk(path)) == 3
    vtkhdf.truncate(path, [])
    assert not path.exists()


def test_foreign_and_damaged_files_are_refused_by_name(tmp_path):
    import h5py

    path = tmp_path / "f.vtkhdf"
    with pytest.raises(ValueError, match=r"f\.vtkhdf: there is no such file"):
        vtkhdf.times(path)
    with h5py.File(path, "w") as file:
        file["other"] = 1
    before = path.read_bytes()
    for act in (lambda: vtkhdf.times(path), lambda: vtkhdf.append(path, state(1), FieldOutput())):
        with pytest.raises(ValueError, match=r"f\.vtkhdf: no VTKHDF file of tipfem"):
            act()
    assert path.read_bytes() == before
    vtkhdf.write(path, [state(1)], FieldOutput())
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"f\.vtkhdf: not a VTKHDF file that can be read"):
        vtkhdf.times(path)
    with pytest.raises(ValueError, match="no state to be written"):
        vtkhdf.write(path, [], FieldOutput())
    with pytest.raises(ValueError, match=r"gone\.vtu: .* no such file"):
        vtu.read(tmp_path / "gone.vtu", 2)
    path.write_text("<VTKFile")
    with pytest.raises(ValueError, match=r"f\.vtkhdf: not a VTU file"):
        vtu.read(path, 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"format": "hdf"}, "format is 'hdf'; it must be one of 'vtu', 'vtkhdf', 'both'"),
        ({"precision": "half"}, "precision is 'half'"),
        ({"compression": 10}, "compression is 10; it must be a whole number from 0 to 9"),
        ({"compression": True}, "compression is True"),
        ({"compression": "4"}, "compression is '4'"),
    ],
)
def test_a_wrong_choice_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        FieldOutput(**options)


class Crash(OSError):
    """Stands for a full disk, or for the end of the process."""


def crash_at(monkeypatch, count: int) -> None:
    """Let the call number `count` of the system that changes a file fail, and all after it."""
    calls = 0

    def guarded(function):
        def call(*arguments, **options):
            nonlocal calls
            calls += 1
            if calls > count:
                raise Crash("no space left")
            return function(*arguments, **options)

        return call

    for name in ("pwrite", "ftruncate", "fsync", "replace"):
        monkeypatch.setattr(atomic.os, name, guarded(getattr(os, name)))


@pytest.mark.slow
@pytest.mark.parametrize("compression", [0, 4])
def test_wherever_a_change_fails_the_file_has_all_of_it_or_nothing(tmp_path, monkeypatch, compression):
    """Each call of the system fails in turn; the file is then read as a reader finds it, and goes on."""
    path, output = tmp_path / "f.vtkhdf", FieldOutput(compression=compression)
    for step in (1, 2):
        vtkhdf.append(path, state(step), output)
    before = path.read_bytes()
    outcomes, vtk_fails = [], 0
    for count in range(10000):
        path.write_bytes(before)
        journal_of(path).unlink(missing_ok=True)
        with monkeypatch.context() as patch:
            crash_at(patch, count)
            try:
                vtkhdf.append(path, state(3), output)
                done = True
            except OSError:
                done = False
        steps, _ = vtkhdf.times(path)
        outcomes.append(len(steps))
        assert steps in ([1, 2], [1, 2, 3])
        for number, step in enumerate(steps):
            assert_same(state(step), read_back(path, number, 2))
        if not journal_of(path).exists():
            assert [time for time, _ in by_vtk(path)] == [0.1 * step for step in steps]
        else:
            vtk_fails += 1
            recover(path)
            assert len(by_vtk(path)) == 3
        if done:
            break
        vtkhdf.append(path, state(4), output)
        assert vtkhdf.times(path)[0] == [*steps, 4]
    assert done
    assert count > 10
    assert outcomes == sorted(outcomes)
    assert vtk_fails


APPEND_FOREVER = """
import sys
sys.path.insert(0, {folder!r})
from pathlib import Path
from test_vtkhdf import state
from tipfem.results.fields import FieldOutput, vtkhdf
for step in range(1, 100000):
    vtkhdf.append(Path({path!r}), state(step % 50 + 50 * (step // 50)), FieldOutput())
    print(step, flush=True)
"""


@pytest.mark.slow
def test_a_process_that_is_killed_leaves_all_it_had_appended(tmp_path):
    path, rng = tmp_path / "f.vtkhdf", np.random.default_rng(1)
    for _ in range(6):
        path.unlink(missing_ok=True)
        code = APPEND_FOREVER.format(folder=os.path.dirname(__file__), path=str(path))
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        assert process.stdout.readline() == "1\n"
        clock.sleep(rng.uniform(0.05, 0.4))
        os.kill(process.pid, signal.SIGKILL)
        said = process.stdout.read().split()
        process.wait()
        steps, _ = vtkhdf.times(path)
        assert len(steps) - len(said) in (1, 2)  # 1 was read before; the last may not have been said
        recover(path)
        assert len(by_vtk(path)) == len(steps)
        assert_same(state(steps[-1]), read_back(path, len(steps) - 1, 2))


def test_an_atomic_file_is_a_file(tmp_path):
    """Random reads, writes and truncations, against a file in memory."""
    import io

    path, rng = tmp_path / "f", np.random.default_rng(0)
    path.write_bytes(rng.bytes(20000))
    for _ in range(5):
        before = path.read_bytes()
        twin = io.BytesIO(before)
        with AtomicFile(path, write=True) as file:
            for _ in range(200):
                place, data = int(rng.integers(0, 30000)), rng.bytes(int(rng.integers(1, 9000)))
                for one in (file, twin):
                    one.seek(place)
                    assert one.write(data) == len(data)
                place, count = int(rng.integers(0, 30000)), int(rng.integers(1, 9000))
                read = []
                for one in (file, twin):
                    one.seek(place)
                    read.append(one.read(count))
                    assert one.tell() == place + len(read[-1])
                assert read[0] == read[1]
            assert path.read_bytes()[: len(before)] == before
            assert file.seek(0, os.SEEK_END) == len(twin.getvalue())
            file.truncate(25000)
            twin.truncate(25000)
            file.commit()
        assert path.read_bytes() == twin.getvalue()
    with AtomicFile(path, write=True) as file:
        file.write(b"not to be")
        file.seek(0, os.SEEK_END)
        file.write(b"this neither")
    assert path.read_bytes() == twin.getvalue()


def test_a_journal_that_is_no_whole_one_is_passed_over(tmp_path):
    path = tmp_path / "f"
    path.write_bytes(b"content")
    journal_of(path).write_bytes(b"tipfem journal 1\nhalf of it")
    with AtomicFile(path) as file:
        assert file.read() == b"content"
    recover(path)
    assert path.read_bytes() == b"content"
    assert not journal_of(path).exists()

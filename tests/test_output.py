"""tipfem/results/output.py: the results folder, read back."""

from __future__ import annotations

import csv
import json
import xml.etree.ElementTree as ElementTree
import zlib

import meshio
import numpy as np
import pytest

import tipfem as tp
from tipfem.casefile.record import case_facts
from tipfem.errors import FolderRefused
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh
from tipfem.results.fields import FieldOutput
from tipfem.results.folder_lock import LOCK
from tipfem.results.output import MANIFEST, STEP_COLUMNS, ResultsFolder, own_columns
from tipfem.run.checkpoint import file_name


def state(water: tp.Fluid, air: tp.Fluid, dimension: int = 2, seed: int = 0) -> tuple[tp.Particles, Mesh]:
    """A jittered tank of two fluids with a random flow, and its mesh."""
    tank = tp.tank((1,) * dimension, 0.25, jitter=0.2, seed=seed).fill(air)
    p = tank.fill(water, box=((0,) * dimension, (0.5,) * dimension)).sample([water, air])
    rng = np.random.default_rng(seed)
    velocity = rng.normal(size=p.position.shape)
    velocity[p.wall] = 0
    p = p.copy(velocity=velocity, pressure=rng.normal(size=len(p)))
    return p, triangulate(p.position, p.wall, p.spacing)


def files(folder) -> set[str]:
    """All files below a folder, hidden ones included, but for the list of them and the lock."""
    found = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    return {path.as_posix() for path in found if path.name not in (MANIFEST, LOCK)}


def listed(folder) -> list[tuple[float, str]]:
    """Times and files of fields.pvd."""
    root = ElementTree.parse(folder / "fields.pvd").getroot()
    assert root.tag == "VTKFile"
    assert root.get("type") == "Collection"
    return [(float(entry.get("timestep")), entry.get("file")) for entry in root.iter("DataSet")]


def test_columns_that_every_history_has_cannot_be_replaced():
    mine = {"front": lambda simulation: 1.0}
    assert own_columns(mine) == mine
    with pytest.raises(ValueError, match="'time' is a column of every history"):
        own_columns({"time": lambda simulation: 1.0})
    with pytest.raises(ValueError, match="'front' is 3; it must be a function"):
        own_columns({"front": 3})


def test_a_new_folder_is_made_with_all_above_it_and_holds_nothing(tmp_path):
    ResultsFolder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b" / "fields").is_dir()
    ResultsFolder(tmp_path / "one file", fields=FieldOutput(format="vtkhdf"))
    assert not (tmp_path / "one file" / "fields").exists()
    assert files(tmp_path) == set()


@pytest.mark.parametrize("dimension", [2, 3])
def test_fields_come_back_as_they_were(dimension, tmp_path, water, air):
    p, mesh = state(water, air, dimension)
    density = np.array([water.density, air.density])[p.fluid]
    ResultsFolder(tmp_path).write_fields(12, 0.5, mesh, p, density)
    assert files(tmp_path) == {"fields.pvd", "fields/step_000012.vtu"}
    read = meshio.read(tmp_path / "fields" / "step_000012.vtu")
    np.testing.assert_array_equal(read.points[:, :dimension], p.position)
    np.testing.assert_array_equal(read.point_data["velocity"][:, :dimension], p.velocity)
    assert read.points.shape == read.point_data["velocity"].shape == (len(p), 3)
    if dimension == 2:
        assert not read.points[:, 2].any()
        assert not read.point_data["velocity"][:, 2].any()
    assert [block.type for block in read.cells] == ["triangle" if dimension == 2 else "tetra"]
    np.testing.assert_array_equal(read.cells[0].data, mesh.cells)
    assert set(read.point_data) == {"velocity", "pressure", "fluid", "density", "wall"}
    for name, expected in (("pressure", p.pressure), ("fluid", p.fluid), ("density", density), ("wall", p.wall)):
        np.testing.assert_array_equal(read.point_data[name], expected)
    assert read.point_data["fluid"].dtype.kind == read.point_data["wall"].dtype.kind == "i"


def test_fields_are_compressed_quickly(tmp_path, water, air, monkeypatch):
    slow, compress = [], zlib.compress
    monkeypatch.setattr(zlib, "compress", lambda *given: slow.append(1) or compress(*given))
    particles, mesh = state(water, air)
    ResultsFolder(tmp_path).write_fields(12, 0.25, mesh, particles, np.ones(len(particles)))
    file = tmp_path / "fields" / "step_000012.vtu"
    assert not slow
    assert 'compressor="vtkZLibDataCompressor"' in file.read_text()
    meshio.write(tmp_path / "own.vtu", meshio.read(file))  # as it does elsewhere
    assert slow
    assert file.stat().st_size < 1.1 * (tmp_path / "own.vtu").stat().st_size


def test_the_collection_lists_every_time_and_its_file_in_order(tmp_path, water, air):
    folder = ResultsFolder(tmp_path)
    times = {0: 0.0, 7: 1 / 3, 1000000: 2.5}
    for seed, (step, time) in enumerate(times.items()):
        p, mesh = state(water, air, seed=seed)
        folder.write_fields(step, time, mesh, p, np.ones(len(p)))
        expected = [(t, f"fields/step_{n:06d}.vtu") for n, t in list(times.items())[: seed + 1]]
        assert [name for _, name in listed(tmp_path)] == [name for _, name in expected]
        np.testing.assert_allclose([t for t, _ in listed(tmp_path)], [t for t, _ in expected], rtol=1e-8)
    for seed, (_, name) in enumerate(listed(tmp_path)):
        p, _ = state(water, air, seed=seed)
        np.testing.assert_array_equal(meshio.read(tmp_path / name).points[:, :2], p.position)


def test_a_step_written_again_is_listed_once(tmp_path, water, air):
    folder = ResultsFolder(tmp_path)
    p, mesh = state(water, air)
    for _ in range(2):
        folder.write_fields(3, 0.1, mesh, p, np.ones(len(p)))
    assert listed(tmp_path) == [(0.1, "fields/step_000003.vtu")]


def test_history_has_a_header_and_a_row_a_step_on_disk_at_once(tmp_path):
    folder = ResultsFolder(tmp_path)
    assert not (tmp_path / "history.csv").exists()
    folder.append_history({"step": 1, "time": 0.1, "volume_water": 1 / 3, "count": np.int64(12345678901)})
    text = (tmp_path / "history.csv").read_text()
    assert text == "step,time,volume_water,count\n1,0.1,0.333333333,12345678901\n"
    # The first row decides on the columns and on their order; others are left out.
    time = np.float64(2e7 / 3)
    folder.append_history({"count": 2, "volume_water": 1e-12, "further": 9.0, "time": time, "step": 1000000})
    rows = (tmp_path / "history.csv").read_text().splitlines()
    assert rows[2:] == ["1000000,6666666.67,1e-12,2"]
    folder.append_history({"step": 3, "time": float("nan"), "volume_water": np.float32(0.5), "count": 0})
    folder.close()
    folder.close()
    with open(tmp_path / "history.csv", newline="") as source:
        read = list(csv.DictReader(source))
    assert [row["step"] for row in read] == ["1", "1000000", "3"]
    assert read[2]["time"] == "nan"
    assert float(read[2]["volume_water"]) == 0.5


def test_a_history_goes_on_after_it_was_closed(tmp_path):
    folder = ResultsFolder(tmp_path)
    for step in (1, 2):
        folder.append_history({"step": step, "time": 0.5 * step})
        folder.close()
    assert (tmp_path / "history.csv").read_text() == "step,time\n1,0.5\n2,1\n"


def test_a_row_that_lacks_a_column_is_an_error(tmp_path):
    folder = ResultsFolder(tmp_path)
    folder.append_history({"step": 1, "time": 0.1})
    with pytest.raises(KeyError, match="time"):
        folder.append_history({"step": 2})
    folder.close()


@pytest.mark.parametrize("name", ["water, salt", "two\nlines", '"quoted"'])
def test_any_name_of_a_column_survives(tmp_path, name):
    folder = ResultsFolder(tmp_path)
    folder.append_history({"step": 1, f"volume_{name}": 2.0, "time": 0.5})
    folder.close()
    with open(tmp_path / "history.csv", newline="") as source:
        (row,) = csv.DictReader(source)
    assert row == {"step": "1", f"volume_{name}": "2", "time": "0.5"}


def test_the_case_is_described(tmp_path, water, air):
    tank = tp.tank((0.8, 0.6), 0.1).fill(air).fill(water, box=((0, 0), (0.4, 0.6)))
    case = tp.Case(tank, [water, air], gravity=(0, -9.81), title="a ⅔ full tank")
    ResultsFolder(tmp_path).write_case(case_facts(case))
    assert files(tmp_path) == {"case.json"}
    read = json.loads((tmp_path / "case.json").read_text("utf-8"))
    assert read == {
        "format": 1,
        "title": "a ⅔ full tank",
        "dimension": 2,
        "fluids": [
            {"name": "water", "density": 998.2, "viscosity": 1.002e-3},
            {"name": "air", "density": 1.204, "viscosity": 1.825e-5},
        ],
        "lower": [0.0, 0.0],
        "upper": [0.8, 0.6],
        "size": [0.8, 0.6],
        "spacing": 0.1,
        "gravity": [0.0, -9.81],
        "interface": "sharp",
        "free_surface": False,
        "bodies": [],
        "tank": read["tank"],  # see tests/render
    }
    (loop,) = read["tank"]["loops"]
    assert loop["corners"] == [[0.0, 0.0], [0.8, 0.0], [0.8, 0.6], [0.0, 0.6]]


def test_the_summary_takes_numpy_values_and_adds_versions(tmp_path):
    content = {"array": np.arange(3), "one": np.float64(0.1), "n": np.int32(4), "flag": np.bool_(True), "text": "å"}
    ResultsFolder(tmp_path).write_summary(content)
    read = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    versions = read.pop("versions")
    assert read == {"array": [0, 1, 2], "one": 0.1, "n": 4, "flag": True, "text": "å"}
    assert set(versions) == {"python", "tipfem", "taichi", "numpy", "scipy", "meshio"}
    assert versions["numpy"] == np.__version__
    assert versions["tipfem"] == tp.__version__


def test_what_json_cannot_hold_leaves_the_earlier_summary(tmp_path):
    folder = ResultsFolder(tmp_path)
    folder.write_summary({"a": 1})
    with pytest.raises(TypeError, match="object cannot be written to JSON"):
        folder.write_summary({"a": object()})
    assert json.loads((tmp_path / "summary.json").read_text())["a"] == 1
    assert files(tmp_path) == {"summary.json"}


def test_a_second_run_replaces_the_first_s_files_and_no_others(tmp_path, water, air):
    p, mesh = state(water, air)
    first = ResultsFolder(tmp_path)
    for step in (0, 5):
        first.write_fields(step, 0.1 * step, mesh, p, np.ones(len(p)))
    first.append_history({"step": 1, "time": 0.1})
    first.write_case(case_facts(tp.Case(p.copy(), [water, air], gravity=(0, -9.81))))
    first.write_summary({})
    first.close()
    own = files(tmp_path)
    assert set((tmp_path / MANIFEST).read_text().splitlines()) == own
    assert own == {"case.json", "history.csv", "summary.json", "fields.pvd"} | {
        f"fields/step_{step:06d}.vtu" for step in (0, 5)
    }
    foreign = {"notes.txt", "fields/mine.vtu", "fields/step.txt", "movie/frame.png", "history.csv.bak"}
    foreign |= {"other/history.csv", "other/fields.pvd", "movie.mp4.part"}
    for name in ("fields/step_000006.vtu", "summary.json"):  # of a run that was killed
        (tmp_path / (name + ".part")).write_text("half a fi")
        with open(tmp_path / MANIFEST, "a") as manifest:
            manifest.write(name + "\n")
    foreign |= {"front.png", "fields/step_000007.vtu", "frames/frame_0000.png", "animation.mp4", "../outside.txt"}
    with open(tmp_path / MANIFEST, "a") as manifest:
        manifest.write("../outside.txt\n/etc/hostname\nfields\n\n")
    for name in foreign:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    assert (tmp_path.parent / "outside.txt").exists()
    foreign.remove("../outside.txt")
    second = ResultsFolder(tmp_path)
    assert files(tmp_path) == foreign
    assert (tmp_path.parent / "outside.txt").exists()
    second.write_fields(2, 0.7, mesh, p, np.ones(len(p)))
    second.append_history({"step": 2, "speed": 3.0})
    second.close()
    assert listed(tmp_path) == [(0.7, "fields/step_000002.vtu")]
    assert (tmp_path / "history.csv").read_text() == "step,speed\n2,3\n"
    assert files(tmp_path) == foreign | {"fields.pvd", "history.csv", "fields/step_000002.vtu"}
    assert all((tmp_path / name).read_text() == name for name in foreign)


def test_a_failed_write_leaves_the_earlier_file_whole(tmp_path, water, air, monkeypatch):
    p, mesh = state(water, air)
    folder = ResultsFolder(tmp_path)
    folder.write_fields(1, 0.1, mesh, p, np.ones(len(p)))
    before = (tmp_path / "fields.pvd").read_bytes(), (tmp_path / "fields" / "step_000001.vtu").read_bytes()

    def full_disk(path, *_, **__):
        path.write_text("half a fi")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(meshio, "write", full_disk)
    for step in (1, 2):
        with pytest.raises(OSError, match="No space left"):
            folder.write_fields(step, 0.2, mesh, p, np.ones(len(p)))
    assert before == ((tmp_path / "fields.pvd").read_bytes(), (tmp_path / "fields" / "step_000001.vtu").read_bytes())
    assert not (tmp_path / "fields" / "step_000002.vtu").exists()


def test_a_failed_write_leaves_no_part_behind(tmp_path, water, air, monkeypatch):
    p, mesh = state(water, air)
    folder = ResultsFolder(tmp_path)

    def full_disk(path, *_, **__):
        path.write_text("half a fi")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(meshio, "write", full_disk)
    with pytest.raises(OSError, match="No space left"):
        folder.write_fields(1, 0.1, mesh, p, np.ones(len(p)))
    assert files(tmp_path) == set()


@pytest.mark.parametrize("name", ["case.json", "history.csv", "summary.json", "fields.pvd"])
def test_a_foreign_file_in_the_way_is_refused_and_nothing_is_touched(tmp_path, monkeypatch, water, name):
    """As in out=".", in a folder of other work."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("mine")
    (tmp_path / "front.png").write_text("mine too")
    case = tp.Case(tp.tank((1, 1), 0.25).fill(water), [water], gravity=(0, -9.81))
    with pytest.raises(ValueError, match=rf"out is '.', where {name} is no file of an earlier run"):
        tp.Simulation(case, out=".")
    assert files(tmp_path) == {name, "front.png"}
    assert (tmp_path / name).read_text() == "mine"
    (tmp_path / name).unlink()
    tp.Simulation(case, out=".", time_step=1e-3).run(1e-3, progress=False)
    tp.Simulation(case, out=".", time_step=1e-3).run(1e-3, progress=False)
    assert (tmp_path / "front.png").read_text() == "mine too"


def test_a_column_cannot_have_the_name_of_a_budget_s(water, air):
    case = tp.Case(tp.tank((1, 1), 0.25).fill(water), [water, air][:1], gravity=(0, -9.81))
    for name in ("kinetic_energy", "volume_water", "wall_force_y", "refused_steps", "wall_seconds"):
        with pytest.raises(ValueError, match=f"columns: '{name}' is a column of every history"):
            tp.Simulation(case, columns={name: lambda s: 1.0})
    simulation = tp.Simulation(case, time_step=1e-3, columns={"volume_air": lambda s: 1.0})
    simulation.step()
    assert set(simulation.budget.columns) < set(simulation.history[0])
    assert set(simulation.history[0]) == {*STEP_COLUMNS, *simulation.budget.columns, "volume_air"}


@pytest.mark.parametrize("damage", [b"\xff\xfe\n", b"fields\x00.vtu\n"])
def test_a_damaged_list_of_the_files_is_named(tmp_path, damage):
    ResultsFolder(tmp_path).list_file("history.csv")
    with open(tmp_path / MANIFEST, "ab") as manifest:
        manifest.write(damage)
    message = rf"'{tmp_path}/{MANIFEST}', which lists the files of an earlier run, is damaged: it has .* in line 2;"
    with pytest.raises(FolderRefused, match=message):
        ResultsFolder(tmp_path, overwrite=True)
    assert (tmp_path / MANIFEST).read_bytes().endswith(damage)


@pytest.mark.parametrize("below", ["", "results", "deep/er/results"])
def test_a_folder_that_cannot_be_made_is_refused(tmp_path, below):
    (tmp_path / "file").write_text("here")
    path = tmp_path / "file" / below
    with pytest.raises(ValueError, match="cannot be written to") as refusal:
        ResultsFolder(path)
    assert f"out is {str(path)!r}" in str(refusal.value)
    assert "Not a directory" in str(refusal.value)
    assert (tmp_path / "file").read_text() == "here"


def test_a_run_writes_the_whole_folder(tmp_path, water, air):
    tank = tp.tank((1, 1), 0.2).fill(air).fill(water, box=((0, 0), (1, 0.5)))
    case = tp.Case(tank, [water, air], gravity=(0, -9.81))
    columns = {"top": lambda s: s.particles.position[:, 1].max()}
    simulation = tp.Simulation(case, out=tmp_path, time_step=1e-3, output_interval=2e-3, columns=columns)
    simulation.run(4e-3, progress=False)
    steps = simulation.step_number
    names = [name for _, name in listed(tmp_path)]
    np.testing.assert_allclose([t for t, _ in listed(tmp_path)], [0, 2e-3, 4e-3], atol=1e-12)
    assert names[0] == "fields/step_000000.vtu"
    assert names[-1] == f"fields/step_{steps:06d}.vtu"
    checkpoints = {f"checkpoints/{file_name(step)}" for step in (0, steps)}
    assert files(tmp_path) == {
        "case.json",
        "case.toml",
        "summary.json",
        "history.csv",
        "fields.pvd",
        "walls.pvd",
        "walls/step_000000.vtu",
        *checkpoints,
        *names,
    }
    np.testing.assert_array_equal(meshio.read(tmp_path / names[-1]).points[:, :2], simulation.particles.position)
    with open(tmp_path / "history.csv", newline="") as source:
        rows = list(csv.DictReader(source))
    assert len(rows) == len(simulation.history) == steps
    assert list(rows[0]) == list(simulation.history[0])
    assert [int(row["step"]) for row in rows] == list(range(1, steps + 1))
    for row, kept in zip(rows, simulation.history, strict=True):
        np.testing.assert_allclose([float(x) for x in row.values()], list(kept.values()), rtol=1e-8)
        assert float(row["top"]) == 1.0
        assert float(row["volume_water"]) + float(row["volume_air"]) == pytest.approx(1.0, rel=1e-8)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["status"] == "complete"
    assert summary["time"] == 4e-3
    assert summary["steps"] == steps
    assert summary["particles"] == len(case.particles)
    assert (summary["arch"], summary["precision"], summary["interface"]) == ("cpu", "f64", "sharp")
    assert summary["numerics"]["relocation"]["too_close"] == 0.6
    assert [fluid["name"] for fluid in summary["fluids"]] == ["water", "air"]


def test_an_interrupted_run_says_so_and_keeps_its_last_state(tmp_path, water):
    def interrupt(simulation):
        raise KeyboardInterrupt

    case = tp.Case(tp.tank((1, 1), 0.25).fill(water), [water], gravity=(0, -9.81))
    simulation = tp.Simulation(case, out=tmp_path, time_step=1e-3, columns={"stop": interrupt})
    with pytest.raises(KeyboardInterrupt):
        simulation.run(1.0, progress=False)
    assert json.loads((tmp_path / "summary.json").read_text())["status"] == "interrupted"
    assert listed(tmp_path)[-1] == (1e-3, "fields/step_000001.vtu")
    assert [row["time"] for row in simulation.history] == [1e-3]
    assert len((tmp_path / "history.csv").read_text().splitlines()) == 2
    assert not [name for name in files(tmp_path) if name.endswith(".part")]


def test_a_long_run_is_not_replaced_unasked(tmp_path):
    """One of less than ten minutes is, as by a script that is run again."""
    for seconds, replaced in ((599.0, True), (601.0, False)):
        folder = ResultsFolder(tmp_path, overwrite=True)
        folder.append_history({"step": 1, "time": 0.1, "wall_seconds": seconds})
        folder.close()
        if replaced:
            ResultsFolder(tmp_path).close()
            assert not (tmp_path / "history.csv").exists()
            continue
        with pytest.raises(ValueError, match="holds the results of a run of 0:10:01; name another folder, resume"):
            ResultsFolder(tmp_path)
        assert (tmp_path / "history.csv").exists()
    ResultsFolder(tmp_path, overwrite=True).close()
    assert not (tmp_path / "history.csv").exists()

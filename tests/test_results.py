"""tipfem/results/reader.py, tables.py, notebook.py: what a run leaves, read back."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time as clock

import numpy as np
import pytest
from tipfem.render import View

import tipfem as tp
from tipfem.app import commands
from tipfem.results.fields import vtkhdf
from tipfem.results.fields.atomic_file import journal_of
from tipfem.results.folder_lock import LOCK
from tipfem.results.output import MANIFEST
from tipfem.results.tables import Table, package

END, INTERVAL = 8e-3, 2e-3


def dam_break(water, air):
    tank = tp.tank((0.584, 0.584), 0.04).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
    return tp.Case(tank, [water, air], (0.0, -9.81), title="Dam <break>")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a run with both formats, and its simulation."""
    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
    air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
    out = tmp_path_factory.mktemp("finished")
    simulation = tp.Simulation(
        dam_break(water, air),
        out,
        time_step=1e-3,
        output_interval=INTERVAL,
        fields="both",
        probes=[tp.WallForce(name="force", wall="left"), tp.FrontProbe(name="front", fluid="water")],
    )
    simulation.run(until=END)
    return out, simulation


def without_vtu(out, folder):
    """A copy of a results folder whose states are in the VTKHDF file alone."""
    shutil.copytree(out, folder, dirs_exist_ok=True)
    shutil.rmtree(folder / "fields")
    (folder / "fields.pvd").unlink()
    return folder


def test_the_history_is_a_table_of_columns(finished):
    out, simulation = finished
    history = tp.read_results(out).history
    assert list(history) == list(simulation.history[0])
    for name, column in history.items():
        np.testing.assert_allclose(column, [row[name] for row in simulation.history], rtol=1e-8, err_msg=name)
    assert history["step"].dtype.kind == "i"
    assert history.units["time"] == "s"
    with pytest.raises(KeyError, match=r"history\.csv has no column 'tyme'; it has step, time"):
        history["tyme"]
    frame = history.to_pandas()
    assert list(frame.columns) == list(history)
    assert frame["time"].iloc[-1] == END
    assert frame.attrs["units"]["time"] == "s"
    assert float(tp.read_results(out).to_xarray()["max_speed"].sel(time=END, method="nearest")) > 0
    assert history.to_xarray()["max_speed"].attrs == {"units": "m/s"}


def test_probes_are_tables_with_units(finished):
    out, simulation = finished
    probes = tp.read_results(out).probes
    assert list(probes) == ["force", "front"]
    for name, table in probes.items():
        for column, values in simulation.probes[name].items():
            np.testing.assert_array_equal(table[column], values)
    assert probes["front"].units == {"time": "s", "front": "m"}
    assert probes["force"].units["time"] == "s"
    with pytest.raises(KeyError, match=r"there is no probe 'gauge'; there are: force, front"):
        probes["gauge"]


@pytest.mark.parametrize("only_vtkhdf", [False, True])
def test_states_are_read_by_time(finished, tmp_path, only_vtkhdf):
    out, simulation = finished
    results = tp.read_results(without_vtu(out, tmp_path / "copy") if only_vtkhdf else out)
    np.testing.assert_allclose(results.times, [0, 2e-3, 4e-3, 6e-3, 8e-3], rtol=1e-8)
    assert len(results) == 5
    last = results.at(END, tolerance=0)
    assert last.step == simulation.step_number
    particles, mesh = simulation.particles, simulation.mesh
    for name in ("position", "velocity", "pressure", "fluid", "wall"):
        np.testing.assert_array_equal(getattr(last, name), getattr(particles, name))
    np.testing.assert_array_equal(last.cells, mesh.cells)
    np.testing.assert_array_equal(last.cell_fluid, mesh.fluid)
    assert results.at(4.9e-3).time == pytest.approx(4e-3)
    assert results[1].time == pytest.approx(2e-3)
    assert [state.time for state in results] == pytest.approx(list(results.times))
    with pytest.raises(ValueError, match=r"no state is stored at t = 0\.0049 s; the nearest is at 0\.004 s, and there"):
        results.at(4.9e-3, tolerance=0)
    with pytest.raises(IndexError, match=r"stored state 5: .* has 5, numbered from 0"):
        results[5]


def test_both_formats_hold_the_same(finished, tmp_path):
    out, _ = finished
    one, other = tp.read_results(out), tp.read_results(without_vtu(out, tmp_path / "copy"))
    for left, right in zip(one, other, strict=True):
        for name, value in vars(left).items():
            if name != "time":
                np.testing.assert_array_equal(getattr(right, name), value, err_msg=name)


def test_other_packages_get_their_objects_in_one_call(finished):
    out, _ = finished
    results = tp.read_results(out)
    state = results[-1]
    grid = results.to_pyvista(END)
    assert (grid.n_points, grid.n_cells) == (len(state.position), len(state.cells))
    np.testing.assert_array_equal(grid.point_data["pressure"], state.pressure)
    np.testing.assert_array_equal(grid.cell_data["fluid"], state.cell_fluid)
    assert grid.compute_cell_sizes()["Area"].sum() == pytest.approx(0.584**2)
    data = results.to_xarray(END)
    np.testing.assert_array_equal(data["velocity"].sel(axis="y"), state.velocity[:, 1])
    assert data["pressure"].attrs["units"] == "Pa"
    assert data.attrs["step"] == state.step


@pytest.mark.parametrize("missing", ["pandas", "pyvista", "xarray"])
def test_a_package_that_is_missing_is_named(finished, monkeypatch, missing):
    results = tp.read_results(finished[0])
    monkeypatch.setitem(sys.modules, missing, None)
    act = {
        "pandas": results.history.to_pandas,
        "pyvista": lambda: results.to_pyvista(0.0),
        "xarray": lambda: results.to_xarray(0.0),
    }[missing]
    with pytest.raises(ImportError, match=f"to_{missing} needs {missing}, which is not installed: pip install"):
        act()
    with pytest.raises(ImportError, match="m needs nothing_of_that_name"):
        package("nothing_of_that_name", "m")


def test_results_show_themselves(finished):
    out, simulation = finished
    results = tp.read_results(out)
    assert results.status == "complete"
    assert "status complete" in repr(results)
    assert "5 from 0 to 0.008 s" in repr(results)
    for shown in (results, simulation, simulation.case):
        text = shown._repr_html_()
        assert "Dam &lt;break&gt;" in text
        assert text.count("<tr>") == text.count("</tr>") > 3
    assert "largest speed" in repr(results[-1])
    assert "<td>0.008</td>" in results.history._repr_html_()
    assert "the last 5" in results.history._repr_html_()
    assert "columns time, front" in repr(results.probes["front"])


@pytest.mark.slow
@pytest.mark.parametrize("only_vtkhdf", [False, True])
def test_pictures_and_movies(finished, tmp_path, only_vtkhdf):
    out, _ = finished
    results = tp.read_results(without_vtu(out, tmp_path / "copy") if only_vtkhdf else out)
    options = {"size": (320, 240), "backend": "raster"}
    image = results.picture(END, "pressure", **options)
    assert image.size == (320, 240)
    assert len(np.unique(np.asarray(image).reshape(-1, 3), axis=0)) > 20
    assert np.array_equal(image, tp.read_results(out).picture(END, "pressure", **options))
    # Fluids look as in movies, lit by depth.
    lit, flat = (np.asarray(results.picture(END, look=look, **options)) for look in (None, "flat"))
    assert len(np.unique(lit.reshape(-1, 3), axis=0)) > len(np.unique(flat.reshape(-1, 3), axis=0)) + 50
    # What a View holds may be given here, too.
    arrows = results.picture(END, "pressure", arrows=True, streamlines=True, **options)
    viewed = results.picture(END, "pressure", view=View(arrows=True, streamlines=True), **options)
    assert np.array_equal(arrows, viewed)
    assert not np.array_equal(arrows, image)
    movie = results.movie(name="short.gif", **options)
    assert movie.path == results.folder / "short_320x240.gif"
    assert movie._repr_html_().startswith('<img style="max-width: 100%" src="data:image/gif;base64,R0lG')
    assert "short_320x240.gif" in repr(movie)
    assert "video/mp4;base64" in results.movie(name="short.mp4", **options)._repr_html_()


def test_a_run_that_is_going_on_and_one_without_fields(tmp_path, water, air):
    simulation = tp.Simulation(dam_break(water, air), tmp_path, time_step=1e-3)
    simulation.step()
    results = tp.read_results(tmp_path)
    assert results.status == "running"
    assert results.history.rows == 1
    assert len(results) == 0
    assert results.probes == {}
    assert results.summary == {}
    with pytest.raises(ValueError, match="no fields have been written"):
        results.at(0.0)
    simulation.run(until=2e-3)
    assert results.history.rows == 1
    assert results.refresh().history.rows == 2
    assert results.status == "complete"
    assert len(results) == 2
    # A row that is being written is left out.
    with open(tmp_path / "history.csv", "a") as file:
        file.write("3,0.00")
    assert results.refresh().history.rows == 2


KILLED = """
import sys
import tipfem as tp
tp.init(arch="cpu", threads=1)
water = tp.Fluid("water", density=998.2, viscosity=1e-3)
tank = tp.tank((0.584, 0.584), 0.04).fill(water, box=((0, 0), (0.146, 0.292)))
case = tp.Case(tank, [water], (0.0, -9.81), free_surface=True)
simulation = tp.Simulation(
    case, sys.argv[1], time_step=5e-4, output_interval=5e-4, fields="vtkhdf", checkpoint_interval=4e-3
)
simulation.run(until=1.0)
"""


@pytest.mark.slow
def test_a_run_that_is_killed_and_resumed_has_the_states_of_one_run(tmp_path):
    """By kill -9; the checkpoint is older than the last states, which are removed."""
    code = [sys.executable, "-c", KILLED, str(tmp_path / "killed")]
    process = subprocess.Popen(code, stderr=subprocess.DEVNULL)
    history = tmp_path / "killed" / "history.csv"
    deadline = clock.monotonic() + 120
    while not (history.exists() and history.read_text().count("\n") > 14):
        assert process.poll() is None
        assert clock.monotonic() < deadline
        clock.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    results = tp.read_results(tmp_path / "killed")
    assert results.status.startswith("no summary")
    rows, before = results.history.rows, [state.position for state in results]
    assert rows >= 13
    assert len(before) in (rows, rows + 1)  # with the initial state; the last may be missing
    resumed = tp.Simulation.resume(tmp_path / "killed")
    end = 0.5e-3 * (rows + 1)
    assert 0 < resumed.step_number < rows
    steps = [state.step for state in results.refresh()]
    assert steps == list(range(resumed.step_number + 1))
    assert resumed.results.fields.format == "vtkhdf"
    resumed.run(until=end)
    after = [state.position for state in results.refresh()]
    assert [state.step for state in results] == list(range(rows + 2))
    for one, other in zip(before, after, strict=False):
        np.testing.assert_array_equal(one, other)
    assert not (tmp_path / "killed" / "fields.pvd").exists()


def test_convert_makes_one_file_of_vtu_files(finished, tmp_path, capsys):
    out, _ = finished
    folder = tmp_path / "copy"
    shutil.copytree(out, folder)
    (folder / vtkhdf.NAME).unlink()
    assert commands.main(["convert", str(folder), "--precision", "single", "--compression", "9"]) == 0
    assert "fields.vtkhdf" in capsys.readouterr().out
    steps, times = vtkhdf.times(folder / vtkhdf.NAME)
    assert len(steps) == 5
    np.testing.assert_allclose(times, tp.read_results(folder).times)
    state = vtkhdf.read(folder / vtkhdf.NAME, 4, 2).fields(0, 0.0)
    assert state.position.dtype == np.float32
    np.testing.assert_allclose(state.pressure, tp.read_results(folder)[4].pressure, rtol=1e-6)
    assert vtkhdf.NAME in (folder / MANIFEST).read_text().split("\n")
    assert commands.main(["convert", str(folder), "--compression", "11"]) == 2
    assert "compression is 11" in capsys.readouterr().err
    (folder / LOCK).write_text(json.dumps({"host": "another", "process": 1}))
    with pytest.raises(ValueError, match="a run is writing into it"):
        tp.to_vtkhdf(folder)


def test_a_later_run_removes_the_file_and_its_journal(tmp_path, water, air):
    simulation = tp.Simulation(dam_break(water, air), tmp_path, time_step=1e-3, fields="vtkhdf")
    simulation.run(until=1e-3)
    assert len(tp.read_results(tmp_path)) == 2
    assert not (tmp_path / "fields").exists()
    journal_of(tmp_path / vtkhdf.NAME).write_bytes(b"")
    tp.Simulation(dam_break(water, air), tmp_path, time_step=1e-3)
    assert not (tmp_path / vtkhdf.NAME).exists()
    assert not journal_of(tmp_path / vtkhdf.NAME).exists()


def test_what_is_no_result_is_refused_by_name(finished, tmp_path):
    with pytest.raises(ValueError, match="gone: there is no such folder"):
        tp.read_results(tmp_path / "gone")
    with pytest.raises(ValueError, match=r"it has no case\.json and is no results folder"):
        tp.read_results(tmp_path)
    folder = tmp_path / "copy"
    shutil.copytree(finished[0], folder)
    for name, text, read, message in (
        ("history.csv", "step,time\n1\n", lambda r: r.history, r"history\.csv: row 1 has 1 values; it must have 2"),
        ("history.csv", "step\nx\n", lambda r: r.history, r"history\.csv: column 'step' has a value that is no number"),
        ("summary.json", "{", lambda r: r.summary, r"summary\.json: it cannot be read"),
        ("summary.json", "[]", lambda r: r.summary, r"summary\.json: it must hold a JSON object"),
        ("fields.pvd", "<VTKFile>", lambda r: r.times, r"fields\.pvd: not a collection of ParaView"),
        ("case.json", '{"format": 9}', lambda r: r, r"case\.json: format 9 in None dimensions"),
    ):
        (folder / name).write_text(text)
        with pytest.raises(ValueError, match=message):
            read(tp.read_results(folder))


def test_tables_without_units_or_rows(tmp_path):
    table = Table.read(tmp_path / "none.csv")
    assert (table.rows, len(table)) == (0, 0)
    assert "columns none" in repr(table)
    path = tmp_path / "t.csv"
    path.write_text('time [s],"c, d"\n')
    table = Table.read(path)
    assert list(table) == ["time", "c, d"]
    assert table.units["time"] == "s"
    assert table.rows == 0
    assert table._repr_html_().startswith("<p>t.csv: 0 rows</p>")


@pytest.mark.parametrize("fields", ["hdf", 3, None])
def test_a_wrong_format_is_refused_before_anything_starts(tmp_path, water, air, fields):
    with pytest.raises(ValueError, match="fields: format is"):
        tp.Simulation(dam_break(water, air), tmp_path / "out", fields=fields)
    assert not os.path.exists(tmp_path / "out")

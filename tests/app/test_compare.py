"""`tipfem compare`: a history beside measured data."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.app import commands
from tipfem.results.comparison import compared


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    water, air = tp.Fluid("water", density=998.2, viscosity=1.002e-3), tp.Fluid("air", density=1.204, viscosity=1.8e-5)
    tank = tp.tank((0.4, 0.4), 0.04).fill(air).fill(water, box=((0, 0), (0.12, 0.24)))
    probes = [tp.WallForce(name="force", wall="left"), tp.FrontProbe(name="front", fluid="water")]
    out = tmp_path_factory.mktemp("compared") / "out"
    tp.Simulation(tp.Case(tank, [water, air], (0, -9.81)), out, time_step=4e-3, probes=probes).run(0.1, progress=False)
    return out


def front(out):
    table = tp.read_results(out).probes["front"]
    (column,) = (name for name in table if name not in ("time", "step"))
    return table["time"], table[column]


def written(path, time, values, header="t,x\n"):
    path.write_text(header + "".join(f"{t!r},{x!r}\n" for t, x in zip(time.tolist(), values.tolist(), strict=True)))
    return path


def test_what_is_added_to_a_history_is_found(finished, tmp_path, capsys):
    time, x = front(finished)
    data = written(tmp_path / "data.csv", time, x - 0.01)
    picture = tmp_path / "front.png"
    words = ["compare", str(finished), "--probe", "front", "--with", str(data), "--picture", str(picture)]
    assert commands.main(words) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert lines["compared"].startswith(f"front, {len(time)} values from")
    assert lines["rms"].startswith("0.01 m, ")
    assert lines["mean"].startswith("+0.01 m")
    assert lines["largest"].startswith("+0.01 m at")
    assert lines["correlation"] == "1.0000"
    assert "shift" not in lines
    assert picture.stat().st_size > 5000


def test_a_shift_in_time_is_found(finished, tmp_path, capsys):
    time, x = front(finished)
    at = np.linspace(0.02, 0.08, 25)
    data = written(tmp_path / "late.csv", at + 7.3e-3, np.interp(at, time, x), header="")
    assert commands.main(["compare", str(finished), "--probe", "front", "--with", str(data), "--fit-shift"]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert float(lines["shift"].split()[0]) == pytest.approx(-7.3e-3, rel=0.01)
    assert float(lines["rms"].split()[0]) < 1e-4


def test_columns_of_the_history_are_compared(finished, tmp_path, capsys):
    history = tp.read_results(finished).history
    data = written(tmp_path / "energy.csv", history["time"], 2.0 * history["kinetic_energy"])
    assert commands.main(["compare", str(finished), "--column", "kinetic_energy", "--with", str(data)]) == 0
    assert "kinetic_energy" in capsys.readouterr().out


@pytest.mark.parametrize("shift", [-0.4, 0.0, 0.17])
def test_shifts_of_a_wave_are_fitted(shift):
    time = np.linspace(0.0, 10.0, 2001)
    at = np.linspace(2.0, 8.0, 97)
    found = compared(time, np.sin(time) * time, at - shift, np.sin(at) * at, fit_shift=True)
    assert found.shift == pytest.approx(shift, abs=1e-3)
    assert found.rms < 2e-2
    assert compared(time, np.sin(time), at, np.sin(at) + 0.5).rms == pytest.approx(0.5, rel=1e-4)


@pytest.mark.parametrize(
    ("words", "content", "message"),
    [
        (["--probe", "frnt"], "0,1\n0.1,2\n", "the probes are: force, front; did you mean 'front'?"),
        (["--probe", "force"], "0,1\n0.1,2\n", "has several columns; say which with --column: "),
        (["--column", "kinetic"], "0,1\n0.1,2\n", "has no column 'kinetic': "),
        (["--probe", "front"], "0,1\n0.05,x\n0.1,2\n", "line 2 is '0.05,x'; it must be finite numbers"),
        (["--probe", "front"], "5,1\n6,2\n", "from 5 s to 6 s, the run from"),
        (["--probe", "front"], "0,1,2\n0.1,2,3\n", "has 3 columns; give one with times and values alone"),
        (["--probe", "front", "--picture", "a.svg"], "0,1\n0.1,2\n", "it must be the name of a PNG file"),
    ],
)
def test_bad_input_is_told_in_a_sentence(finished, tmp_path, capsys, words, content, message):
    (tmp_path / "data.csv").write_text(content)
    assert commands.main(["compare", str(finished), "--with", str(tmp_path / "data.csv"), *words]) == 2
    assert message in capsys.readouterr().err.replace("\n", " ")


def test_data_that_is_not_there_is_told(finished, tmp_path, capsys):
    assert commands.main(["compare", str(finished), "--probe", "front", "--with", str(tmp_path / "no.csv")]) == 2
    assert "cannot be read (No such file or directory)" in capsys.readouterr().err

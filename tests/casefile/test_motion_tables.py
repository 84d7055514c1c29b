"""Tables of motions as they are recorded: times that begin late, angles in degrees, columns by their names."""

from __future__ import annotations

import math

import pytest

from tipfem.casefile.describing import describe
from tipfem.casefile.loading import load_case, read_case
from tipfem.casefile.problems import CaseFileError

TEXT = """gravity = [0, -9.81]
free_surface = true
fluids.water = { density = 1000, viscosity = 1e-3 }
tank = { size = [0.5, 0.4], spacing = 0.1 }
fill = [{ fluid = "water", box = [[0, 0], [0.5, 0.2]] }]
tank_motion.angle = { form = "table", TABLE }
time.end = 0.2
"""
TIMES = [12.0, 12.05, 12.1, 12.15, 12.2]
FILE = "# a rig\nt, heave, pitch\n" + "".join(f"{t}, 9.0, {3 * math.sin(5 * (t - 12)) ** 2}\n" for t in TIMES)


def angle(case, time):
    """Of the tank [degrees]."""
    return math.degrees(case.tank_motion.freedoms(time)[2])


@pytest.mark.parametrize("kind", ["file", "lists"])
def test_a_recording_moves_the_tank_from_its_start(kind, tmp_path):
    table = 'file = "rig.csv", columns = ["t", "pitch"], start_time = 12.0, degrees = true'
    if kind == "lists":
        values = [3 * math.sin(5 * (t - 12)) ** 2 for t in TIMES]
        table = f"times = {TIMES}, values = {values}, start_time = 12.0, degrees = true"
    (tmp_path / "rig.csv").write_text(FILE)
    (tmp_path / "case.toml").write_text(TEXT.replace("TABLE", table))
    case = load_case(tmp_path / "case.toml").case()
    for time in (0.0, 0.05, 0.1, 0.2):
        assert angle(case, time) == pytest.approx(3 * math.sin(5 * time) ** 2, abs=1e-9)
    # A run leaves the numbers themselves, not the file.
    (tmp_path / "rig.csv").unlink()
    again = read_case(describe(case, 0.2).text, "again.toml").case()
    assert angle(again, 0.123) == angle(case, 0.123)


def test_times_that_begin_late_are_told_with_what_helps(tmp_path):
    (tmp_path / "rig.csv").write_text(FILE)
    table = 'file = "rig.csv", columns = ["t", "pitch"]'
    with pytest.raises(
        CaseFileError, match=r"has times from 12\.0 to 12\.2 s; .*; start_time = 12\.0 would let the run"
    ):
        read_case(TEXT.replace("TABLE", table), "case.toml", tmp_path)
    with pytest.raises(CaseFileError, match=r"has times from 0\.5 to"):
        read_case(TEXT.replace("TABLE", f"{table}, start_time = 11.5"), "case.toml", tmp_path)
    with pytest.raises(CaseFileError, match="roll"):
        read_case(TEXT.replace("TABLE", table.replace("pitch", "roll")), "case.toml", tmp_path)

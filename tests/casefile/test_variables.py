"""Variables of case files: formulas give the same case as the numbers do, and mistakes are told at their lines."""

from __future__ import annotations

import numpy as np
import pytest

from tipfem.app.study.study import load_study
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError

TEXT = """gravity = [0, -9.81]
free_surface = true
[variables]
width = 0.5
gate = 0.08
level = "= gate + width / 4"
[fluids.water]
density = 998.2
viscosity = "= 1e-6 * 1000"
[tank]
size = ["= width", 0.3]
spacing = "=gate/4"
[[fill]]
fluid = "water"
box = [[0, 0], ["= width - gate", "= (level)"]]
[walls.left]
motion = { form = "sine", amplitude = "= -gate / -16", frequency = 1.0, soft_start = 0.1 }
[time]
end = 0.01
"""


def test_formulas_are_the_numbers_that_they_give():
    plain = TEXT[: TEXT.index("[variables]")] + TEXT[TEXT.index("[fluids") :]
    for formula, number in (
        ("= 1e-6 * 1000", 1e-6 * 1000),
        ("= width - gate", 0.42),
        ("= width", 0.5),
        ("=gate/4", 0.02),
        ("= (level)", 0.08 + 0.125),
        ("= -gate / -16", 0.005),
    ):
        assert f'"{formula}"' in plain
        plain = plain.replace(f'"{formula}"', repr(number))
    one, other = read_case(TEXT, "a.toml"), read_case(plain, "b.toml")
    assert one.table.fluids == other.table.fluids
    np.testing.assert_array_equal(one.case().particles.position, other.case().particles.position)
    assert one.case().walls[0].displacement(0.3) == other.case().walls[0].displacement(0.3)


def test_a_study_varies_a_variable_and_all_that_is_written_with_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(TEXT)
    (tmp_path / "study.toml").write_text('case = "case.toml"\nfolder = "o"\n[grid]\nvariables.gate = [0.08, 0.1]\n')
    runs = load_study(tmp_path / "study.toml").runs
    assert [run.file.table.tank.spacing for run in runs] == [0.02, 0.025]
    corners = [run.file.table.fill[0].box[1] for run in runs]
    np.testing.assert_allclose(corners, [[0.42, 0.205], [0.4, 0.225]], rtol=1e-15)
    assert read_case(TEXT, "a.toml", overrides=["variables.gate=0.1"]).table.tank.spacing == 0.025
    assert read_case(TEXT, "a.toml", overrides=['tank.spacing="= width / 10"']).table.tank.spacing == 0.05


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("=gate/4", "= gat / 4", "a.toml:12: tank.spacing is '= gat / 4'; there is no variable 'gat', but width, gate"),
        ("=gate/4", "= gate /", "a.toml:12: tank.spacing is '= gate /', which is no formula"),
        ("=gate/4", "= gate ** 4", "which is no formula"),
        ("=gate/4", "= __import__('os')", "which is no formula"),
        ("=gate/4", "= gate.real", "which is no formula"),
        ("=gate/4", "= gate / (width - width)", "which divides by zero"),
        ("=gate/4", "= 1e300 * 1e300", "which is inf"),
        ("=gate/4", "= 1j", "which is no formula"),
        ("=gate/4", "=" + "(" * 150 + "1" + ")" * 150, "it must be a number, or a formula"),
        ("=gate/4", "=" + "-" * 190 + "gate", "tank.spacing"),
        ("= gate + width / 4", "= later", "a.toml:6: variables.level is '= later'; there is no variable 'later'"),
        ("= gate + width / 4", "text", "a.toml:6: variables.level is 'text'; it must be a number, or a formula"),
        ("=gate/4", "= -gate", "a.toml:12: tank.spacing is -0.08 m; it must be a number > 0"),
    ],
)
def test_mistakes_are_told_at_their_lines(old, new, message):
    if new.count("-") == 190:  # an even number of signs
        assert read_case(TEXT.replace(old, new), "a.toml").table.tank.spacing == 0.08
        return
    with pytest.raises(CaseFileError) as error:
        read_case(TEXT.replace(old, new), "a.toml")
    assert message in str(error.value)
    assert len(str(error.value)) < 1000


def test_an_override_of_no_variable_is_told():
    with pytest.raises(CaseFileError, match=r"there is no variable 'gat', but width, gate"):
        read_case(TEXT, "a.toml", overrides=["variables.gat=0.1"])

"""Waves and beaches in case files."""

from __future__ import annotations

import pytest
from case_texts import WATER_IN_AIR

import tipfem as tp
from tipfem.casefile.describing import describe
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError

GOOD = (
    WATER_IN_AIR
    + """\
box = [[0, 0], [0.4, 0.1]]
[walls.left]
slip = true
motion = { form = "waves", height = 0.02, period = 0.8, depth = 0.1 }
[[vents]]
wall = "top"
[[beaches]]
wall = "right"
length = 0.3
period = 0.8
[time]
end = 1.0
"""
)
IRREGULAR = 'form = "irregular_waves", seed = 4, spectrum = "pierson-moskowitz"'


@pytest.mark.parametrize("form", ['form = "waves"', IRREGULAR])
def test_a_case_file_has_waves_and_beaches_and_is_written_back(form):
    text = GOOD.replace('form = "waves"', form)
    case = read_case(text, "case.toml").case()
    motion = next(wall.motion for wall in case.walls if wall.name == "left")
    expected = {"height": 0.02, "period": 0.8, "depth": 0.1}
    if form == IRREGULAR:
        assert motion == tp.IrregularWaves(**expected, seed=4, spectrum="pierson-moskowitz")
    else:
        assert motion == tp.WavePiston(**expected)
    assert [zone.beach for zone in case.beaches] == [tp.Beach(wall="right", length=0.3, period=0.8)]
    described = describe(case, 1.0)
    assert described.missing == ()
    again = read_case(str(described), "again.toml").case()
    assert next(wall.motion for wall in again.walls if wall.name == "left") == motion
    assert [zone.beach for zone in again.beaches] == [zone.beach for zone in case.beaches]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("height = 0.02", "height = 0.2", "walls.left.motion.height is 0.2 m; waves of that period and depth break"),
        ("height = 0.02, ", "", "walls.left.motion.height is missing"),
        ("height = 0.02", "order = 3, height = 0.02", "walls.left.motion.order is 3; it must be a whole number from 1"),
        ("length = 0.3", "length = -1.0", "beaches[0].length is -1.0 m; it must be a number > 0"),
        (
            'wall = "right"',
            'wall = "rihgt"',
            "beaches[0].wall is 'rihgt'; it must be one of the walls 'left', 'right',",
        ),
        (
            "[[vents]]",
            '[[beaches]]\nwall = "right"\nlength = 0.1\nperiod = 1.0\n[[vents]]',
            "which has a beach already",
        ),
    ],
)
def test_mistakes_have_their_place(old, new, message):
    assert old in GOOD
    with pytest.raises(CaseFileError) as error:
        read_case(GOOD.replace(old, new, 1), "case.toml").case()
    assert message in str(error.value)

"""The demos' case files are their scripts: the same case, and bitwise the same first steps."""

import numpy as np
import pytest
from demo_runs import DEMOS
from tipfem.demos import harness

import tipfem as tp
from tipfem.casefile.describing import ARRAYS
from tipfem.casefile.loading import load_case

CASES = sorted(path.stem for path in (DEMOS / "cases").glob("*.toml"))
# Spacings [m] at which a few steps take no time, and how many of them.
COARSE = {
    "dam_break": (0.02, 5),
    "dam_break_free_surface": (0.02, 5),
    "floating": (0.025, 3),
    "layer_inversion": (0.005, 3),
    "layers_at_rest": (0.005, 3),
    "obstacle": (0.02, 3),
    "oil_on_water": (0.0146, 3),
    "sinking_drop": (0.005, 3),
    "sloshing": (0.05, 3),
}


def test_every_demo_without_functions_has_a_case_file():
    assert set(CASES) == set(COARSE)


@pytest.mark.parametrize("name", CASES)
def test_a_case_file_is_the_case_of_its_script(name):
    script, file = harness.load(name), load_case(DEMOS / "cases" / f"{name}.toml")
    case = file.case()
    for array in ARRAYS:
        assert np.array_equal(getattr(case.particles, array), getattr(script.case.particles, array)), array
    for attribute in ("fluids", "numerics", "title", "interface", "free_surface", "grading"):
        assert getattr(case, attribute) == getattr(script.case, attribute), attribute
    assert np.array_equal(case.gravity, script.case.gravity)
    assert [wall.name for wall in case.walls] == [wall.name for wall in script.case.walls]
    assert (file.end, file.table.time.largest_step) == (script.options.end_time, script.options.time_step)
    assert file.table.output.interval == pytest.approx(1 / script.options.frames_per_second)
    assert file.folder == script.options.out


@pytest.mark.parametrize("name", CASES)
def test_its_first_steps_are_bitwise_those_of_the_script(name):
    spacing, steps = COARSE[name]
    script = harness.load(name, spacing=spacing)
    one = tp.Simulation(script.case, time_step=script.options.time_step)
    file = load_case(DEMOS / "cases" / f"{name}.toml", [f"tank.spacing={spacing}"])
    other = file.simulation()
    for _ in range(steps):
        one.step()
        other.step()
    assert one.time == other.time
    for array in ARRAYS:
        assert np.array_equal(getattr(one.particles, array), getattr(other.particles, array)), array

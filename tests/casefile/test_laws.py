"""Laws of viscosity in case files, in commands to a run, and in runs that go on."""

from __future__ import annotations

import dataclasses
import shutil

import numpy as np
import pytest

import tipfem as tp
from tipfem.casefile.describing import describe
from tipfem.casefile.loading import load_case
from tipfem.casefile.problems import CaseFileError

LAWS = [
    tp.Bingham(60.0, 1.0, regularisation=20.0),
    tp.PowerLaw(2.0, 0.5),
    tp.HerschelBulkley(30.0, 2.0, 0.7, regularisation=20.0),
    tp.Carreau(at_rest=5.0, at_infinity=0.5, time=0.2, index=0.4),
    tp.Granular(0.4, 0.7, diameter=1e-3, grain_density=2500.0),
    tp.Smagorinsky(1e-3),
]

FILE = """
gravity = [0, -9.81]
free_surface = true

[fluids.mud]
density = 1000

[fluids.mud.viscosity]
law = "bingham"
yield_stress = 60
viscosity = 1

[tank]
size = [0.4, 0.15]
spacing = 0.025

[[fill]]
fluid = "mud"
box = [[0, 0], [0.2, 0.1]]

[time]
end = 0.02
"""


def slump(law=LAWS[0], spacing=0.025):
    mud = tp.Fluid("mud", 1000.0, law)
    tank = tp.tank((0.4, 0.15), spacing, jitter=0.1, seed=2).fill(mud, box=((0, 0), (0.2, 0.1)))
    tank.wall("left", slip=True)
    return tp.Case(tank, [mud], (0, -9.81), free_surface=True)


@pytest.mark.parametrize("law", LAWS, ids=[law.law for law in LAWS])
def test_a_law_is_written_and_read_back(law, tmp_path):
    (tmp_path / "case.toml").write_text(describe(slump(law), end=0.1).text, encoding="utf-8")
    assert load_case(tmp_path / "case.toml").case().fluids[0].viscosity == law


@pytest.mark.parametrize(
    ("override", "text"),
    [
        (
            "viscosity.law='binghm'",
            "viscosity.law is 'binghm'; it must be one of 'bingham', .* did you mean 'bingham'?",
        ),
        ("viscosity.yield_stress=-1", "viscosity.yield_stress is -1 Pa; it must be a number >= 0 in Pa"),
        ("viscosity.yield=3", "viscosity.yield is no key of the law 'bingham'; its keys are law, yield_stress, "),
        ("viscosity={law='power',consistency=2}", "viscosity.index is missing; give a number from 0.1 to 3: n"),
        ("viscosity={yield_stress=3}", "viscosity.law is missing; give a number >= 0 in Pa s or a table with law = "),
        ("viscosity='thick'", "viscosity is 'thick'; it must be a number >= 0 in Pa s or a table with law = 'bingham'"),
        ("yield_stress=3", "yield_stress is not a known key; a law is the viscosity of a fluid, as viscosity = "),
    ],
)
def test_mistakes_are_named(override, text, tmp_path):
    (tmp_path / "case.toml").write_text(FILE, encoding="utf-8")
    with pytest.raises(CaseFileError, match=f"fluids.mud.{text}"):
        load_case(tmp_path / "case.toml", overrides=[f"fluids.mud.{override}"])


def test_a_number_of_a_law_is_changed_by_its_key(tmp_path):
    (tmp_path / "case.toml").write_text(FILE, encoding="utf-8")
    found = load_case(tmp_path / "case.toml", overrides=["fluids.mud.viscosity.yield_stress=20"]).case()
    assert found.fluids[0].viscosity == tp.Bingham(20.0, 1.0)


def test_a_wall_has_a_law_beside_those_of_fluids(tmp_path):
    """A key that walls and tables of viscosity have alike."""
    text = FILE + '\n[walls.bottom]\nlaw = "no-slip"\nslipp = true\n'
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    with pytest.raises(CaseFileError, match=r"walls.bottom.slipp is not a known key; did you mean 'slip'"):
        load_case(tmp_path / "case.toml")


def test_mud_goes_on_to_the_bit_with_what_a_command_has_changed(tmp_path):
    simulation = tp.Simulation(slump(), tmp_path / "run", time_step=4e-3)
    simulation.run(0.02, progress=False)
    simulation.steer(tp.Viscosity("mud", 10.0, number="yield_stress"))
    simulation.run(0.04, progress=False)
    assert simulation.forces.fluids(simulation.case)[0].viscosity == dataclasses.replace(LAWS[0], yield_stress=10.0)
    shutil.copytree(tmp_path / "run", tmp_path / "part")
    simulation.run(0.06, progress=False)
    resumed = tp.Simulation.resume(tmp_path / "part")
    resumed.run(0.06, progress=False)
    np.testing.assert_array_equal(resumed.particles.position, simulation.particles.position)
    stiff = tp.Simulation(slump(), time_step=4e-3)
    stiff.run(0.06, progress=False)
    assert simulation.particles.max_speed > 1.02 * stiff.particles.max_speed


@pytest.mark.parametrize(
    ("law", "number", "value", "text"),
    [
        (LAWS[0], "", 2.0, r"number is '' of mud; it must be one of \['yield_stress', 'viscosity', 'regularisation'\]"),
        (LAWS[1], "index", 5.0, "PowerLaw: index is 5.0; it must be a number from 0.1 to 3"),
        (1.0, "index", 1.0, "number is 'index' of mud; it must be left out, for it follows no law"),
    ],
)
def test_commands_that_do_not_fit_the_law_are_refused(law, number, value, text):
    with pytest.raises(ValueError, match=text):
        tp.Simulation(slump(law)).steer(tp.Viscosity("mud", value, number=number))

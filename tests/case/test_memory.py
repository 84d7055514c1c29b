"""Tanks whose particles do not fit into the memory are refused before any of them is made."""

from __future__ import annotations

import pytest

import tipfem as tp
from tipfem.case import memory
from tipfem.casefile.loading import read_case

WATER = tp.Fluid("water", density=998.2, viscosity=1e-3)


@pytest.fixture
def gigabyte(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 1e9)


def test_the_limit_is_that_of_the_memory(gigabyte):
    """At 4.5 kB a particle a gigabyte has 222 222 of them, 2.1 mm apart in a square metre."""
    assert not memory.too_many(1.0, 0.00213, 2)
    text = memory.too_many(1.0, 0.0021, 2)
    assert "is 0.0021 m, which makes about 2.3e+05 particles. They take about 1.02 GB" in text
    assert not memory.too_many(1.0, 0.0006, 2, graded=True)
    assert memory.too_many(1.0, 0.02, 3)
    assert memory.available_memory() == 1e9


def test_what_it_names_as_right_is_right(gigabyte):
    text = memory.too_many(0.7, 1e-4, 2)
    assert not memory.too_many(0.7, float(text.split("it must be ")[1].split(" m ")[0]), 2)


@pytest.mark.parametrize("place", [{"size": (1.0, 1.0)}, {"shape": [(0, 0), (1, 0), (1, 1)]}])
def test_python_and_case_files_refuse_it_at_once(place, gigabyte):
    with pytest.raises(ValueError, match=r"tank: spacing is 1e-05 m, which makes about \d"):
        tp.tank(**place, spacing=1e-5)
    inside = "size = [1, 1]" if "size" in place else "shape = {corners = [[0, 0], [1, 0], [1, 1]]}"
    text = f"""
gravity = [0, -9.81]
fluids.water = {{ density = 998.2, viscosity = 1e-3 }}
fill = [{{ fluid = "water" }}]
time = {{ end = 1 }}
[tank]
spacing = 1e-5
{inside}
"""
    with pytest.raises(ValueError, match=r"case.toml:7: tank.spacing is 1e-05 m, which makes about \d"):
        read_case(text, "case.toml")


def test_the_memory_of_this_machine_is_known():
    assert 1e7 < memory.available_memory() < 1e14


@pytest.mark.parametrize("given", [{"size": (1, 1)}, {"shape": tp.shapes.circle((0, 0), 1.0)}, {"size": (1, 1, 1)}])
@pytest.mark.parametrize("spacing", [1e-300, 1e-9])
def test_a_spacing_of_almost_nothing_is_refused_before_any_time_is_spent(given, spacing):
    with pytest.raises(
        ValueError, match=rf"tank: spacing is {spacing:g} m, (which makes about .* particles|far too small)"
    ):
        tp.tank(**given, spacing=spacing)

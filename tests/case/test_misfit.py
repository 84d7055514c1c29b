"""A warning where the first mesh has another area or volume of a fluid than was filled in."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest

import tipfem as tp
from tipfem.case import region
from tipfem.errors import StartWarning

WATER, AIR = tp.Fluid("water", density=1000.0, viscosity=1e-3), tp.Fluid("air", density=1.2, viscosity=1.8e-5)
SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])


def started(part, spacing=0.1, free_surface=False, fitted=True, **options):
    """A simulation in a tank of a shape, whose walls have particles at all levels, or in a rectangle of even ones."""
    tank = tp.tank(shape=[tuple(x) for x in SQUARE], spacing=spacing) if fitted else tp.tank((1.0, 1.0), spacing)
    if not free_surface:
        tank.fill(AIR)
    tank.fill(WATER, **part)
    fluids = [WATER] if free_surface else [WATER, AIR]
    return tp.Simulation(tp.Case(tank, fluids, (0, -9.81), free_surface=free_surface, **options))


def turned(corners, quarters):
    """Corners turned about the square's centre."""
    c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarters]
    return [tuple(x) for x in (np.array(corners) - 0.5) @ np.array([(c, s), (-s, c)]) + 0.5]


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("left", [1e-6, 0.01])
def test_a_face_just_before_a_wall_is_warned_of(quarters, left):
    corners = turned([(0, 0), (1, 0), (1, 1 - left), (0, 1 - left)], quarters)
    with pytest.warns(UserWarning, match="begins with") as found:
        simulation = started({"shape": corners}, fitted=False)
    assert abs(simulation.volume("water") - (1 - left)) > 0.05 * (1 - left)
    assert f"'water' begins with {simulation.volume('water'):.3g} m^2" in str(found[0].message)
    assert found[0].filename == __file__  # the line that makes the simulation


@pytest.mark.parametrize("free_surface", [False, True])
@pytest.mark.parametrize(
    ("part", "area"),
    [
        ({"shape": [(0, 0), (1, 0), (1, 0.99), (0, 0.99)]}, 0.99),
        ({"shape": [(0, 0), (1, 0), (1, 0.95), (0, 0.95)]}, 0.95),
        ({"shape": [(0, 0), (1, 0), (1, 0.537), (0, 0.537)]}, 0.537),
        ({"shape": [(0, 0), (1, 0), (1, 0.7), (0, 0.3)]}, 0.5),
        ({"box": ((0, 0), (0.4, 0.63))}, 0.252),
        ({"disc": ((0.5, 0.5), 0.3)}, 0.09 * np.pi),
        ({"where": lambda x: x[:, 1] < 0.5 + 0.1 * np.sin(2 * np.pi * x[:, 0])}, 0.5),
    ],
)
def test_nothing_is_said_where_the_area_is_right(free_surface, part, area):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulation = started(part, free_surface=free_surface)
    assert simulation.volume("water") == pytest.approx(area, rel=0.02)


@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
@pytest.mark.parametrize("across", [2, 3, 4, 6, 8])
def test_small_discs_are_warned_of_if_and_only_if_their_area_is_off(across, interface):
    radius = 0.05 * across
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        simulation = started({"disc": ((0.5, 0.5), radius)}, interface=interface)
    error = abs(simulation.volume("water") / (np.pi * radius**2) - 1)
    if not 0.015 < error < 0.025:  # sampled areas are right to some 0.1 %
        assert bool(found) == (error > 0.02)


def test_thin_empty_space_is_warned_of():
    with pytest.warns(UserWarning, match="'water' begins with"):
        started({"shape": [(0, 0), (1, 0), (1, 0.99), (0, 0.99)]}, free_surface=True, fitted=False)


def test_a_run_that_is_resumed_does_not_say_it_again(tmp_path):
    tank = tp.tank((1.0, 1.0), 0.1).fill(WATER, shape=[(0, 0), (1, 0), (1, 0.99), (0, 0.99)])
    tank.wall("right", velocity=(0.0, 0.5))
    case = tp.Case(tank, [WATER], (0, -9.81), free_surface=True)
    with pytest.warns(StartWarning) as found:
        tp.Simulation(case, out=tmp_path).run(until=1e-3, progress=False)
    assert len(found) == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tp.Simulation.resume(tmp_path).time == 1e-3


@pytest.mark.slow(but=("False",))
@pytest.mark.parametrize("free_surface", [False, True])
def test_a_coarse_ball_in_space_is_warned_of(free_surface):
    """Its faces are flat; of blocks, layers and a ball of ten spacings nothing is said."""

    def start(spacing, **part):
        tank = tp.tank((1.0, 1.0, 1.0), spacing, jitter=0.15)
        if not free_surface:
            tank.fill(AIR)
        fluids = [WATER] if free_surface else [WATER, AIR]
        return tp.Simulation(tp.Case(tank.fill(WATER, **part), fluids, (0, 0, -9.81), free_surface=free_surface))

    with pytest.warns(StartWarning, match=r"'water' begins with 0\.109 m\^3, but 0\.113 m\^3 are filled in"):
        start(0.1, disc=((0.5, 0.5, 0.5), 0.3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        start(0.0625, disc=((0.5, 0.5, 0.5), 0.3))
        start(0.1, box=((0, 0, 0), (0.5, 0.47, 0.4)))
        start(0.1, where=lambda x: x[:, 2] < 0.5 + 0.05 * np.cos(np.pi * x[:, 0]))


def test_a_few_points_in_each_of_many_cells_are_enough(monkeypatch):
    """The volume that is filled in is known to 1 % with 4 points in each cell, not 144."""
    monkeypatch.setattr(region, "SAMPLED", 1)
    tank = tp.tank((1.0, 1.0, 1.0), 0.1, jitter=0.15).fill(WATER, disc=((0.5, 0.5, 0.5), 0.3))
    with pytest.warns(StartWarning, match="'water' begins with") as found:
        tp.Simulation(tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True))
    asked = float(re.search(r"but (\S+) m\^3", str(found[0].message))[1])
    assert asked == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.01)

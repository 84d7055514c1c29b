"""Gaps between walls that particles cannot resolve, and notches of solid that are none: baffles, plates, gates."""

import numpy as np
import pytest

import tipfem as tp
from tipfem.geometry.plane.domain import domain_of
from tipfem.geometry.plane.shapes import Shape

H = 0.02
WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)


def baffle(thickness: float, at: float = 0.5, lean: float = 0.0) -> list[tuple[float, float]]:
    """A tank, 1 m by 0.5 m, with a baffle on its floor."""
    foot, tip = (at, at + thickness), (at + lean, at + lean + thickness)
    return [(0, 0), (foot[0], 0), (tip[0], 0.15), (tip[1], 0.15), (foot[1], 0), (1, 0), (1, 0.5), (0, 0.5)]


def slot(width: float, at: float = 0.35, turned: float = 0.0) -> list[tuple[float, float]]:
    """Two tanks, joined by a channel along the ceiling or, turned by 180 degrees, along the floor."""
    outline = [(0, 0), (at, 0), (at, 0.5 - width), (at + 0.2, 0.5 - width), (at + 0.2, 0), (1, 0), (1, 0.5), (0, 0.5)]
    c, s = np.cos(turned), np.sin(turned)
    return [(c * x - s * y, s * x + c * y) for x, y in outline]


@pytest.mark.parametrize("turned", [0.0, 0.4, np.pi])
@pytest.mark.parametrize("thickness", [0.1, 0.3, 0.5, 0.8, 1.0, 1.2, 1.4, 1.9])
def test_solids_thinner_than_a_spacing_are_no_gaps(thickness, turned):
    for at in np.linspace(0.45, 0.55, 5):
        for lean in (0.0, 0.03, -0.06):
            outline = np.array(baffle(thickness * H, at, lean)) @ [
                [np.cos(turned), np.sin(turned)],
                [-np.sin(turned), np.cos(turned)],
            ]
            domain_of(Shape.of(outline.tolist()), H).require_resolved(H)


@pytest.mark.parametrize("turned", [0.0, 0.4, np.pi])
@pytest.mark.parametrize("width", [0.5, 1.0, 1.5, 2.0, 2.5, 2.9])
def test_channels_narrower_than_three_spacings_are_refused_at_their_place(width, turned):
    for at in np.linspace(0.3, 0.4, 5):
        with pytest.raises(ValueError, match=r"the gap between two walls at .* spacings; it must be 3 or more"):
            domain_of(Shape.of(slot(width * H, at, turned)), H).require_resolved(H)
    domain_of(Shape.of(slot(3.01 * H, 0.35, turned)), H).require_resolved(H)


@pytest.mark.parametrize("free_surface", [True, False])
@pytest.mark.parametrize("thickness", [0.1, 0.6, 1.0])
def test_fluids_beside_a_baffle_stay_at_rest(thickness, free_surface):
    spacing = 0.05
    tank = tp.tank(shape=baffle(thickness * spacing), spacing=spacing)
    if not free_surface:
        tank = tank.fill(AIR)
    tank = tank.fill(WATER, box=((0, 0), (1, 0.3)))
    fluids = [WATER] if free_surface else [WATER, AIR]
    simulation = tp.Simulation(tp.Case(tank, fluids=fluids, gravity=(0, -9.81), free_surface=free_surface))
    for _ in range(10):
        simulation.step()
    assert np.abs(simulation.particles.velocity).max() < 1e-9
    assert simulation.volume("water") == pytest.approx(0.3 - 0.15 * thickness * spacing, rel=1e-12)

"""Wave gauges on lines through tetrahedra."""

import numpy as np
import pytest

import tipfem as tp

WATER, OIL = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("oil", 800.0, 1e-3)
SIZE = (1.0, 0.5, 0.8)


def level(x, y):
    """A tilted plane, on which the corners of all cells at the surface are [m]."""
    return 0.4 + 0.08 * (x - 0.5) - 0.1 * (y - 0.25)


def simulate(probes, up=2, **options):
    """Water below the plane, with oil above it or nothing, in a tank in which the axis ``up`` is vertical."""
    order = np.insert([0, 1], up, 2)  # of the coordinates x, y and height
    tank = tp.tank(np.array(SIZE)[order], 0.1, jitter=0.15)
    if not options:
        tank.fill(OIL)

    def below(x):
        return x[:, up] < level(*np.delete(x, up, axis=1).T)

    gravity = np.zeros(3)
    gravity[up] = -9.81
    fluids = [WATER] if options else [WATER, OIL]
    case = tp.Case(tank.fill(WATER, where=below), fluids, gravity, **options)
    return tp.Simulation(case, time_step=1e-6, probes=probes)


@pytest.mark.parametrize("up", [1, 2])
def test_heights_of_a_tilted_plane(up):
    """Inside, on walls and on edges of the tank, with nothing above and with oil, whose depth is the rest."""
    places = [(0.3, 0.2), (0.0, 0.31), (0.77, 0.5), (0.0, 0.0), (1.0, 0.5), (0.5, 0.25)]
    for options in ({"free_surface": True}, {}):
        probes = [tp.WaveGauge(name=f"w{k}", x=x, y=y, fluid="water") for k, (x, y) in enumerate(places)]
        if not options:
            probes += [tp.WaveGauge(name=f"o{k}", x=x, y=y, fluid="oil") for k, (x, y) in enumerate(places)]
        simulation = simulate(probes, up, **options)
        simulation.step()
        for k, (x, y) in enumerate(places):
            height, depth = (simulation.probes[f"w{k}"][name][-1] for name in ("height", "depth"))
            assert height == pytest.approx(level(x, y), abs=3e-3)
            assert depth == pytest.approx(height, abs=1e-6)
            if not options:
                assert simulation.probes[f"o{k}"]["depth"][-1] == pytest.approx(0.8 - depth, abs=1e-6)
                assert simulation.probes[f"o{k}"]["height"][-1] == pytest.approx(0.8, abs=1e-6)


def test_a_line_without_the_fluid_has_no_height():
    tank = tp.tank(SIZE, 0.1, jitter=0.15).fill(WATER, box=((0, 0, 0), (0.4, 0.5, 0.4)))
    probes = [tp.WaveGauge(name="g", x=0.7, y=0.25, fluid="water")]
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True), time_step=1e-6, probes=probes)
    simulation.step()
    assert np.isnan(simulation.probes["g"]["height"][-1])
    assert simulation.probes["g"]["depth"][-1] == 0.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"x": 0.3}, "y is None; in 3-D the line needs a second coordinate"),
        ({"x": 0.3, "y": 0.6}, "y is 0.6 m; it must lie between 0 and 0.5 m"),
        ({"x": 0.3, "y": 0.2, "width": 0.1}, "width is 0.1 m; in 3-D it must be 0"),
    ],
)
def test_what_does_not_fit_is_refused(given, words):
    with pytest.raises(ValueError, match=words):
        simulate([tp.WaveGauge(name="g", fluid="water", **given)], free_surface=True)

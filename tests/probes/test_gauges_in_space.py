"""Wave gauges, boxes and drops among tetrahedra."""

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


@pytest.mark.parametrize("options", [{"free_surface": True}, {}], ids=["free", "oil above"])
def test_the_volume_in_a_box_is_that_below_the_plane(options):
    """Boxes that cut the water, that hold it all, that are above it, and two that share it."""
    boxes = {
        "some": ((0.2, 0.1, 0.1), (0.63, 0.37, 0.7)),
        "all": ((-1.0, -1.0, -1.0), (2.0, 2.0, 2.0)),
        "none": ((0.0, 0.0, 0.5), (1.0, 0.5, 0.8)),
        "left": ((-1.0, -1.0, -1.0), (0.41, 2.0, 2.0)),
        "right": ((0.41, -1.0, -1.0), (2.0, 2.0, 2.0)),
    }
    simulation = simulate([tp.VolumeProbe(name=name, fluid="water", box=box) for name, box in boxes.items()], **options)
    simulation.step()
    found = {name: simulation.probes[name]["volume"][-1] for name in boxes}
    middle = level(0.415, 0.235)  # the plane is linear: the mean height is that in the middle
    assert found["some"] == pytest.approx(0.43 * 0.27 * (middle - 0.1), rel=3e-3)
    assert found["all"] == pytest.approx(simulation.volume("water"), rel=1e-12)
    assert found["none"] == 0.0
    assert found["left"] + found["right"] == pytest.approx(found["all"], rel=1e-12)


def test_drops_are_counted_and_measured():
    """Two balls that fall freely, and a pool that touches walls."""
    tank = tp.tank((1, 1, 1.2), 0.1, jitter=0.15).fill(WATER, box=((0, 0, 0), (1, 1, 0.2)))
    for centre, radius in (((0.3, 0.3, 0.8), 0.2), ((0.72, 0.72, 0.6), 0.15)):
        tank.fill(WATER, disc=(centre, radius))
    probes = [
        tp.DropProbe(name="large", fluid="water", off_walls=True),
        tp.DropProbe(name="small", fluid="water", off_walls=True, rank=2),
        tp.DropProbe(name="near", fluid="water", at=(0.7, 0.7, 0.7)),
    ]
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True), time_step=2e-3, probes=probes)
    for _ in range(20):
        simulation.step()
    large, small, near = (simulation.probes[probe.name] for probe in probes)
    t = simulation.time
    assert large["number"][-1] == 2
    assert near["number"][-1] == 3
    assert near["volume"][-1] == small["volume"][-1] < large["volume"][-1]
    for drop, start in ((large, (0.3, 0.3, 0.8)), (small, (0.72, 0.72, 0.6))):
        place = [drop[name][-1] for name in ("x", "y", "z")]
        np.testing.assert_allclose(place, np.add(start, (0, 0, -0.5 * 9.81 * t**2)), atol=0.012)
        assert drop["velocity_z"][-1] == pytest.approx(-9.81 * t, rel=0.05)
        assert abs(drop["velocity_x"][-1]) < 5e-3
        assert drop["diameter"][-1] == pytest.approx((6 * drop["volume"][-1] / np.pi) ** (1 / 3))
        assert 0.85 < drop["sphericity"][-1] < 1.0


def test_boxes_and_drops_need_places_with_three_numbers():
    tank = tp.tank(SIZE, 0.1, jitter=0.15).fill(WATER, box=((0, 0, 0), (1, 0.5, 0.4)))
    case = tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True)
    for probe in (
        tp.DropProbe(name="p", fluid="water", at=(0.5, 0.2)),
        tp.VolumeProbe(name="p", fluid="water", box=((0, 0), (1, 1))),
    ):
        with pytest.raises(ValueError, match="it must be 3 coordinates in m"):
            tp.Simulation(case, probes=[probe])


WALLS = ("left", "right", "bottom", "top", "back", "front")


@pytest.mark.parametrize("options", [{"free_surface": True}, {}], ids=["free", "oil above"])
def test_forces_on_sides_of_a_tank_at_rest(options):
    """Those of hydrostatic pressure, and their moments about a corner; "back" is the floor, at z = 0."""
    tank = tp.tank(SIZE, 0.1, jitter=0.15)
    tank = (tank if options else tank.fill(OIL)).fill(WATER, box=((0, 0, 0), (1, 0.5, 0.4)))
    probes = [tp.WallForce(name=side, wall=side) for side in WALLS]
    probes += [tp.WallForce(name="water", wall="right", fluid="water", about=(1.0, 0.0, 0.0))]
    case = tp.Case(tank, [WATER] if options else [WATER, OIL], (0, 0, -9.81), **options)
    simulation = tp.Simulation(case, time_step=1e-3, probes=probes)
    simulation.step()
    simulation.step()
    found = {p.name: [simulation.probes[p.name][name][-1] for name, _ in p.columns(case)] for p in probes}
    g, above = 9.81, 0.0 if options else 800.0 * 9.81 * 0.4
    level = (
        float(simulation.particles.pressure[simulation.particles.position[:, 2] > 0.79].mean()) if not options else 0.0
    )
    on_floor = above + level + 1000.0 * g * 0.4
    np.testing.assert_allclose(found["back"][:6], [0, 0, -on_floor * 0.5, 0, 0, 0], atol=1e-8 * on_floor)
    np.testing.assert_allclose(
        found["back"][6:], [-on_floor * 0.5 * 0.25, on_floor * 0.5 * 0.5, 0], atol=1e-8 * on_floor
    )
    wet = 0.5 * (0.4 * (above + level) + 1000.0 * g * 0.4**2 / 2)
    assert found["water"][0] == pytest.approx(wet, rel=1e-7)
    # about the lower edge: the arm of each height z
    moment = 0.5 * ((above + level) * 0.4**2 / 2 + 1000.0 * g * (0.4 * 0.4**2 / 2 - 0.4**3 / 3))
    assert found["water"][7] == pytest.approx(moment, rel=1e-7)
    if options:
        assert found["right"][0] == pytest.approx(wet, rel=1e-7)
        assert np.abs(found["front"]).max() < 1e-6
    np.testing.assert_allclose(np.add(found["left"], found["right"])[:6], 0.0, atol=1e-7 * on_floor)
    np.testing.assert_allclose(np.add(found["bottom"], found["top"])[:6], 0.0, atol=1e-7 * on_floor)


@pytest.mark.parametrize("law", ["layer", "slip", "no-slip"])
def test_forces_on_all_sides_are_what_the_flow_loses(law):
    """In a dam break: the sum on all sides is gravity less the change of momentum, by impulses."""
    tank = tp.tank((0.8, 0.4, 0.6), 0.1, jitter=0.15).fill(WATER, box=((0, 0, 0), (0.3, 0.4, 0.4)))
    for side in tank.sides:
        tank.wall(side, **({"slip": True} if law == "slip" else {"law": law}))
    probes = [tp.WallForce(name=side, wall=side, impulse=True) for side in WALLS]
    simulation = tp.Simulation(tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True), time_step=4e-3, probes=probes)
    for _ in range(20):
        simulation.step()
    kinds = [f"{kind}_force_{axis}_impulse" for kind in ("pressure", "viscous") for axis in "xyz"]
    impulse = sum(np.array([simulation.probes[side][name][-1] for name in kinds]) for side in WALLS)
    total, mass = impulse[:3] + impulse[3:], simulation.state.mass
    momentum = (mass[:, None] * simulation.particles.velocity).sum(axis=0)
    lost = np.array([0.0, 0.0, -9.81 * mass.sum() * simulation.time]) - momentum
    np.testing.assert_allclose(total, lost, atol=0.02 * np.abs(lost).max())
    assert np.abs(impulse[0]) > 0.1 * np.abs(lost).max()


def test_forces_in_space_need_a_side():
    tank = tp.tank(SIZE, 0.1, jitter=0.15).fill(WATER, box=((0, 0, 0), (1, 0.5, 0.4)))
    case = tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True)
    with pytest.raises(ValueError, match="there is no wall 'east' in this case; it has left, right, bottom, top"):
        tp.Simulation(case, probes=[tp.WallForce(name="p", wall="east")])


PLACES = {"left": (0.0, 0.2, 0.13), "right": (1.0, 0.5, 0.0), "back": (0.31, 0.22, 0.0), "top": (0.4, 0.5, 0.33)}
PLACES |= {"bottom": (0.7, 0.0, 0.6), "front": (0.4, 0.2, 0.8)}


@pytest.mark.slow(but=("free",))
@pytest.mark.parametrize("options", [{}, {"free_surface": True}], ids=["oil", "free"])
def test_pressures_on_sides_are_hydrostatic_and_go_with_the_tank(options):
    """On faces, edges and corners, with oil or nothing above; in a tank that sways they are those of points there."""
    for motion in (None, tp.Motion(translation=lambda t: (0.3 * t * t, -0.2 * t * t, 0.0))):
        tank = tp.tank(SIZE, 0.1, jitter=0.15)
        tank = (tank if options else tank.fill(OIL)).fill(WATER, box=((0, 0, 0), (1, 0.5, 0.4)))
        for side in tank.sides:
            tank.wall(side, slip=True)
        probes = [tp.WallPressure(name=side, wall=side, at=at) for side, at in PLACES.items()]
        probes += [tp.PointProbe(name=f"p_{side}", at=at, frame="tank") for side, at in PLACES.items()]
        case = tp.Case(tank, [WATER] if options else [WATER, OIL], (0, 0, -9.81), tank_motion=motion, **options)
        simulation = tp.Simulation(case, time_step=0.02, probes=probes)
        for _ in range(5):
            simulation.step()
        found, points = ({s: simulation.probes[kind + s]["pressure"][-1] for s in PLACES} for kind in ("", "p_"))
        wet = [side for side, at in PLACES.items() if not options or at[2] < 0.38]
        for side in wet:
            assert found[side] == pytest.approx(points[side], abs=0.5)
        assert all(found[side] == 0.0 for side in PLACES if side not in wet)
        if motion is None:
            level = found["back"] - (3924.0 if options else 7063.2)
            for side in wet:
                z = PLACES[side][2]
                above = 0.0 if options else 800.0 * 9.81 * (0.8 - max(z, 0.4))
                assert found[side] - level == pytest.approx(9810.0 * max(0.4 - z, 0.0) + above, abs=1e-4)


def test_a_pressure_on_a_piston_in_space_moves_with_it():
    tank = tp.tank(SIZE, 0.1, jitter=0.15).fill(WATER, box=((0, 0, 0), (1, 0.5, 0.4)))
    tank.wall("left", slip=True, motion=lambda t: 0.1 * t)
    probes = [
        tp.WallPressure(name="wall", wall="left", at=(0.0, 0.25, 0.1)),
        tp.WallForce(name="force", wall="left"),
    ]
    case = tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True)
    simulation = tp.Simulation(case, time_step=5e-3, probes=probes)
    for _ in range(20):
        simulation.step()
    place = np.array([0.1 * simulation.time, 0.25, 0.1])
    x, on = simulation.particles.position, simulation.particles.wall & simulation.mesh.used
    near = on & (np.abs(x - place).max(axis=1) < 0.11) & (np.abs(x[:, 0] - place[0]) < 1e-6)
    assert near.sum() > 3
    around = simulation.particles.pressure[near]
    assert around.min() < simulation.probes["wall"]["pressure"][-1] < around.max()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"wall": "left", "at": (0.1, 0.2, 0.1)}, r"which is not on the wall 'left', from \[0.0, 0.0, 0.0\] to"),
        ({"wall": "left", "at": (0.0, 0.6, 0.1)}, "which is not on the wall 'left'"),
        ({"wall": "east", "at": (0.0, 0.2, 0.1)}, "there is no wall 'east'"),
        ({"wall": "left", "at": (0.0, 0.2)}, "it must be 3 coordinates in m"),
    ],
)
def test_places_that_are_not_on_a_side_are_refused(given, message):
    tank = tp.tank(SIZE, 0.1, jitter=0.15).fill(WATER, box=((0, 0, 0), (1, 0.5, 0.4)))
    case = tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True)
    with pytest.raises(ValueError, match=message):
        tp.Simulation(case, probes=[tp.WallPressure(name="p", **given)])

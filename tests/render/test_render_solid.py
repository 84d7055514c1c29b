"""Pictures of flows in 3-D: the surface of the densest fluid, how a camera sees it, and light."""

from __future__ import annotations

from dataclasses import replace

import imageio.v3 as iio
import numpy as np
import pytest
from render_results import write_results
from render_volumes import SIZE, SPACING, volume, write_volumes
from tipfem.render import Results, ResultsError, View, animate, cli, render_frame, strip, surface, water
from tipfem.render.blocks import Blocks
from tipfem.render.camera import Camera, Room
from tipfem.render.runtime import ti
from tipfem.render.solid import SolidRenderer
from tipfem.render.surface import enclosed, fluid_surface
from tipfem.render.water import FAR, look_at

CORNERS = np.array([[k >> a & 1 for a in range(3)] for k in range(8)]) * SIZE
PICTURE = (480, 320)
VIEW = View(camera=(40, 50))
BLOCK = np.array([[[0.2, 0.2, 0.0], [0.4, 0.4, 0.3]]])
BOX = (20.0, 20.0, 460.0, 300.0)


def air(points):
    return points @ [0.3, 0.1, 1.0] > 0.55


def closed(faces):
    """Whether each side of a face is one of another face, in the other direction."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()
    return sorted(sides) == sorted([b, a] for a, b in sides)


@pytest.mark.parametrize("tank", [volume(level=0.5), volume(fluid=air)], ids=["free surface", "two fluids"])
def test_a_surface_is_closed_and_encloses_its_fluid(tank, monkeypatch):
    smooth = fluid_surface(tank, 0)
    monkeypatch.setattr(surface, "ROUNDS", 0)
    rough = fluid_surface(tank, 0)
    assert closed(rough.faces)
    assert (rough.faces == smooth.faces).all()
    other = enclosed(fluid_surface(tank, 1)) if len(tank.fluid_names) > 1 else SIZE[0] * SIZE[1] * (SIZE[2] - 0.5)
    assert enclosed(rough) + other == pytest.approx(SIZE.prod(), rel=1e-12)
    assert enclosed(smooth) == pytest.approx(enclosed(rough), rel=0.01)


def test_smoothing_leaves_the_walls_and_levels_waves():
    tank = volume(fluid=air)
    made = fluid_surface(tank, 0)
    assert (made.points >= -1e-12).all()
    assert (made.points <= SIZE + 1e-12).all()
    flat = made.points[made.faces[made.flat]]
    on = np.isclose(flat, 0, atol=1e-12) | np.isclose(flat, SIZE, atol=1e-12)
    assert on.all(axis=1).any(axis=1).all()
    # The surface is a plane up to the staircase of the particles, which smoothing takes down.
    away = np.abs(made.points[np.unique(made.faces[~made.flat])] @ [0.3, 0.1, 1.0] - 0.55)
    assert away.mean() < 0.25 * SPACING


def test_drops_are_balls_of_their_size():
    tank = volume(level=0.3)
    count = len(tank.position)
    tank = replace(
        tank,
        position=np.concatenate([tank.position, [[0.5, 0.3, 0.7]]]),
        fluid=np.zeros(count + 1, int),
        wall=np.append(tank.wall, False),
    )
    made, without = fluid_surface(tank, 0), fluid_surface(volume(level=0.3), 0)
    ball = made.points[len(without.points) :]
    assert np.linalg.norm(ball - [0.5, 0.3, 0.7], axis=1) == pytest.approx(0.4 * SPACING)
    assert closed(made.faces[len(without.faces) :])
    assert enclosed(made) > enclosed(without)


@pytest.mark.parametrize("angles", [(-25, 18), (40, 60), (0, 0), (200, -30), (10, 90)])
@pytest.mark.parametrize("up", [0, 1, 2])
def test_a_camera_sees_the_whole_tank(angles, up):
    camera = Camera.around(CORNERS, up, angles, BOX)
    seen = camera.seen(CORNERS)
    assert camera.axes @ camera.axes.T == pytest.approx(np.eye(3))
    assert np.linalg.det(camera.axes) == pytest.approx(1)  # right, down, forwards
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    room = np.array([BOX[2] - BOX[0], BOX[3] - BOX[1]])
    assert ((high - low) / room).max() == pytest.approx(1)
    assert (low + high) / 2 == pytest.approx([240, 160])
    assert (seen[:, 2] > 0).all()
    if abs(angles[1]) < 90:
        above = camera.seen([CORNERS.mean(axis=0), CORNERS.mean(axis=0) + 0.1 * np.eye(3)[up]])
        assert above[1, 1] < above[0, 1]


@pytest.mark.slow
def test_depth_and_thickness_are_those_of_rays_through_a_box(monkeypatch):
    """Against the slabs of a box, at every sample: no face is left out or counted twice."""
    monkeypatch.setattr(surface, "ROUNDS", 0)
    monkeypatch.setattr(water, "REACH", 0.0)
    camera = Camera.around(CORNERS, 2, (-25, 18), BOX)
    seen = look_at(fluid_surface(volume(level=0.5), 0), camera, PICTURE, 2, SPACING)
    columns, rows = (np.arange(2 * n) / 2 + 0.25 for n in PICTURE)
    x, y = np.meshgrid(columns - camera.centre[0], rows - camera.centre[1])
    rays = camera.axes[2] + x[..., None] / camera.focal * camera.axes[0] + y[..., None] / camera.focal * camera.axes[1]
    ends = np.sort(np.stack([(np.zeros(3) - camera.eye) / rays, ([*SIZE[:2], 0.5] - camera.eye) / rays]), axis=0)
    near, far = ends[0].max(axis=-1), ends[1].min(axis=-1)
    inside = far - near > 0.02
    assert inside.mean() > 0.2
    assert seen.thickness[inside] == pytest.approx((far - near)[inside], abs=2e-3)
    assert seen.depth[inside] == pytest.approx(near[inside], abs=5e-3)
    assert (seen.depth[far - near < -0.01] == FAR).all()
    assert abs(seen.thickness[far - near < -0.01]).max() == 0


def test_the_filter_is_its_formula():
    random = np.random.default_rng(5)
    depth = random.uniform(1, 1.3, (12, 17)).astype(np.float32)
    depth[3, 4] = FAR
    there = np.minimum(depth, 99)
    normal, flat = random.normal(size=(12, 17, 3)).astype(np.float32), (random.random((12, 17)) < 0.2).astype(np.int32)
    found = np.empty_like(depth), np.empty_like(normal)
    water._smooth(depth, normal, flat, ti.Vector([0, 16, 0, 11]), 3, 0.2, 1, *found)
    for y, x in np.ndindex(depth.shape):
        near = np.arange(max(x - 3, 0), min(x + 4, 17))
        off = (there[y, near] - there[y, x]) / 0.2
        weight = (1 - ((near - x) / 4) ** 2) * np.clip(1 - off**2, 0, None) ** 2 * (flat[y, near] == 0)
        kept = flat[y, x] or depth[y, x] == FAR
        assert found[0][y, x] == pytest.approx(depth[y, x] if kept else (weight @ there[y, near]) / weight.sum())
        mean = normal[y, x] if kept else weight @ normal[y, near] / weight.sum()
        assert found[1][y, x] == pytest.approx(mean, abs=1e-5)


def test_a_room_has_the_edges_and_walls_of_its_tank():
    tank = volume(level=0.5)
    room = Room(tank.position[tank.wall])
    assert len(room.planes) == 6
    assert (CORNERS @ room.planes[:, :3].T <= room.planes[:, 3] + 1e-12).all()
    total = np.linalg.norm(room.edges[:, 1] - room.edges[:, 0], axis=1).sum()
    assert total == pytest.approx(4 * SIZE.sum())
    before = room.before(Camera.around(room.corners, 2, (-25, 18), BOX))
    assert np.linalg.norm(room.edges[~before, 1] - room.edges[~before, 0], axis=1).sum() == pytest.approx(SIZE.sum())
    with pytest.raises(ValueError, match="enclose no space"):
        Room(np.eye(3))


def test_pictures_do_not_depend_on_how_the_tank_is_turned():
    """A quarter turn about the vertical, and the axes named anew with another one upwards."""
    tank = volume(level=0.5)
    with SolidRenderer(PICTURE, samples=2) as renderer:
        plain = renderer.frame(tank, View(camera=(-25, 18))).astype(int)
        quarter = replace(
            tank,
            position=tank.position[:, [1, 0, 2]] * [-1, 1, 1] + [SIZE[1], 0, 0],
            upper=SIZE[[1, 0, 2]],
        )
        turned = renderer.frame(quarter, View(camera=(65, 18))).astype(int)
        named = replace(tank, position=tank.position[:, [2, 0, 1]], upper=SIZE[[2, 0, 1]], up=0)
        again = renderer.frame(named, View(camera=(-25, 18))).astype(int)
    part = np.s_[40:270]  # without the text
    assert np.abs(turned - plain)[part].mean() < 0.3
    assert np.abs(again - plain)[part].mean() < 0.3


def test_water_is_seen_through_its_tank():
    full, low = (render_frame(volume(level=level), PICTURE, samples=1).astype(int) for level in (0.6, 0.2))

    def blue(picture):
        return (picture[..., 2] - picture[..., 0] > 25).sum()

    assert blue(full) > 1.5 * blue(low) > 2000
    with SolidRenderer(PICTURE, samples=1, dark=True) as renderer:
        dark = renderer.frame(volume(level=0.2))
    assert dark[2, 2].max() < 60 < full[2, 2].min()
    assert (render_frame(volume(level=0.2), PICTURE, samples=1) == low).all()
    orange = render_frame(volume(level=0.6), PICTURE, samples=1, fluid_colours={"water": "#e69f00"}).astype(int)
    assert (orange[..., 0] - orange[..., 2] > 25).sum() > 2000


def test_a_picture_does_not_depend_on_those_before_it():
    """The picture of the tank without fluid is kept while nothing of it changes."""
    low, high = volume(level=0.2), volume(level=0.6)
    dry = replace(low, cells=low.cells[:0], wall=np.ones(len(low.position), bool))
    others = replace(low, position=1.1 * low.position), replace(low, blocks=Blocks(SIZE, BLOCK, np.zeros(3)))
    with SolidRenderer(PICTURE, samples=1) as renderer:
        for tank, view in [(low, None), (high, None), (dry, None), *((other, None) for other in others), (low, VIEW)]:
            assert (renderer.frame(tank, view) == SolidRenderer(PICTURE, samples=1).frame(tank, view)).all()


def test_samples_that_are_much_alike_are_shaded_as_one(monkeypatch):
    tank = volume(level=0.5)
    both = []
    for level in (water.LEVEL, -1.0):  # with -1 none is
        monkeypatch.setattr(water, "LEVEL", level)
        both.append(render_frame(tank, PICTURE, samples=2).astype(int))
    apart = np.abs(both[1] - both[0])
    assert 0 < apart.mean() < 0.1
    assert apart.max() < 30


def test_a_results_folder_is_drawn_from_the_camera_asked_for(tmp_path, capsys):
    out = write_volumes(tmp_path / "out")
    words = ["--size", "480x320", "--samples", "1", "--azimuth", "40"]
    assert cli.main([str(out), *words]) == 0
    assert "3 frames, drawn with raster" in capsys.readouterr().out
    name = "camera_40_18_480x320"
    frames = [iio.imread(path) for path in sorted((out / f"frames_{name}").glob("*.png"))]
    assert len(iio.imread(out / f"animation_{name}.mp4")) == len(frames) == 3
    volume = replace(Results(out, solid=True).volume(1), title="A box")
    view = View(camera=(40, 18))
    again = SolidRenderer((480, 320), samples=1).frame(volume, view)
    assert (again == frames[1])[:270].all()  # above the words on the playback


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--field", "pressure"], "without a field"),
        (["--mesh"], "without the mesh"),
        (["--window", "0", "0", "1", "1"], "without window"),
        (["--streamlines"], "without streamlines"),
        (["--outlines", "mesh"], "without outlines"),
        (["--look", "flat"], "without flat look"),
        (["--elevation", "100"], "expected an azimuth and an elevation from -90 to 90 degrees"),
        (["--slice", "y=0.3", "--azimuth", "3"], "a camera looks at flows in 3-D without a slice"),
        (["--strip", "--no-movie"], "the results are in 3-D; choose a plane, for example slice y=0.3"),
        (["--svg"], "the results are in 3-D; choose a plane, for example slice y=0.3"),
    ],
)
def test_what_is_not_drawn_in_3d_is_refused(tmp_path, capsys, words, text):
    out = write_volumes(tmp_path / "out")
    assert cli.main([str(out), "--no-frames", *words]) == 2
    assert text in capsys.readouterr().err
    assert not list(out.glob("*.mp4"))


def test_other_refusals(tmp_path):
    with pytest.raises(ValueError, match="camera 'up': expected two numbers"):
        View(camera="up")
    with pytest.raises(ValueError, match="without transparent"):
        animate(write_volumes(tmp_path / "other"), movie=None, transparent=True)
    with pytest.raises(ValueError, match="a camera looks at flows in 3-D"):
        animate(write_results(tmp_path / "flat"), view=View(camera=(0, 0)))
    with pytest.raises(ResultsError, match="choose a plane"):
        strip(write_volumes(tmp_path / "out"), [0.0])
    three = replace(
        volume(fluid=air), fluid_names=("water", "oil", "air"), fluid_densities=(1000.0, 900.0, 1.0), fields={}
    )
    with pytest.raises(ValueError, match="flows of three fluids or more in 3-D are drawn as a slice only"):
        render_frame(three, PICTURE)


def test_a_bubble_is_drawn_instead_of_what_it_is_in():
    """A light fluid of little volume; of two layers the denser one."""
    tank = volume(level=0.3)
    tank = replace(tank, fluid_names=("water", "air"), fluid_densities=(1000.0, 1.0))
    middle = tank.position[tank.cells].mean(axis=1)
    bubble = replace(tank, cell_fluid=(np.linalg.norm(middle - middle.mean(axis=0), axis=1) < 0.15).astype(int))
    assert bubble.drawn == 1
    assert replace(bubble, cell_fluid=1 - bubble.cell_fluid).drawn == 0
    assert replace(tank, cell_fluid=(middle[:, 2] > np.median(middle[:, 2])).astype(int)).drawn == 0
    assert replace(tank, cell_fluid=None).drawn == 0

"""A results folder to frames and movies, from Python and from the command line."""

import itertools
import json
import re
import subprocess
import sys
import time

import imageio.v3 as imageio
import meshio
import numpy as np
import pytest
from PIL import Image, ImageSequence
from render_results import SIDE, sharp_tank, write_results
from tipfem.render import Renderer, Results, ResultsError, View, animate
from tipfem.render.movie import MovieError, MovieWriter

SIZE = (480, 320)


@pytest.fixture
def out(tmp_path):
    return write_results(tmp_path / "out")


def command(*arguments):
    line = [sys.executable, "-m", "tipfem.render", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, timeout=120)


def test_results_are_read(out):
    results = Results(out)
    assert len(results) == 3
    assert results.times == [0.0, 0.1, 0.2]
    scene = results.scene(-1)
    assert scene.time == 0.2
    assert scene.fluid_names == ("water", "air")
    computed = {"vorticity", "shear_rate"}
    assert set(scene.fields) == {"speed", "velocity_x", "velocity_y", "pressure", "density"} | computed
    assert scene.fields["speed"] == pytest.approx(np.linalg.norm(scene.position, axis=1))
    assert scene.wall.sum() == 4 * 24


def test_fluid_of_the_cells_is_read(tmp_path, out):
    folder = write_results(tmp_path / "sharp", sharp=True)
    scene = Results(folder).scene(1)
    _, cells, _, cell_fluid, _ = sharp_tank(0.1)
    assert (scene.cells == cells).all()
    assert (scene.cell_fluid == cell_fluid).all()
    # Each fluid has its own density up to the interface, whatever stands at the particles on it.
    assert (scene.cell_fields["density"] == np.array([998.2, 1.204])[cell_fluid]).all()
    assert list(scene.cell_fields) == ["density"]
    plain = Results(out).scene(1)
    assert plain.cell_fluid is None
    assert not plain.cell_fields


def test_bad_fluid_of_a_cell_is_named(tmp_path):
    folder = write_results(tmp_path / "sharp", sharp=True)
    path = folder / "fields" / "step_000001.vtu"
    mesh = meshio.read(path)
    mesh.cell_data["fluid"][0][7] = 2
    mesh.write(path)
    with pytest.raises(ResultsError, match=r"step_000001\.vtu: cell_fluid: indices from 0 to 2"):
        Results(folder).scene(1)


def run_on(out, monkeypatch, titled=False):
    """Store the times of a folder one by one, as a run does, while they are drawn; numbers of those that were drawn."""
    collection, drawn = out / "fields.pvd", []
    text = collection.read_text()
    entries = re.findall(r"<DataSet[^>]*/>", text)

    def store(count):
        collection.write_text(text.replace("".join(entries), "".join(entries[:count])))

    def under_way():
        stored = collection.read_text().count("DataSet")
        if stored == len(entries) - 1 and titled:
            case = json.loads((out / "case.json").read_text())
            (out / "case.json").write_text(json.dumps(case | {"title": "A title"}))
        store(min(stored + 1, len(entries)))
        return stored < len(entries)

    store(0)
    frame = Renderer.frame
    monkeypatch.setattr(Renderer, "frame", lambda *a: drawn.append((a[1].time, a[1].title)) or frame(*a))
    done = animate(out, size=SIZE, movie="a.gif", backend="raster", samples=1, under_way=under_way, name="run")
    monkeypatch.undo()
    return done, drawn


@pytest.mark.parametrize("titled", [False, True])
def test_a_run_under_way_is_drawn_as_it_goes_on(tmp_path, monkeypatch, titled):
    out = write_results(tmp_path / "out", times=(0.0, 0.1, 0.2, 0.3, 0.4))
    done, drawn = run_on(out, monkeypatch, titled)
    whole = animate(out, size=SIZE, movie="a.gif", backend="raster", samples=1, name="whole")
    assert [path.read_bytes() for path in done.frames] == [path.read_bytes() for path in whole.frames]
    assert done.movies[0].read_bytes() == whole.movies[0].read_bytes()
    all_times = [0.0, 0.1, 0.2, 0.3, 0.4]
    if titled:  # with the last time comes a title: all are drawn again
        assert drawn == [(t, "Sloshing") for t in all_times[:4]] + [(t, "A title") for t in all_times]
    else:
        assert [t for t, _ in drawn] == all_times


@pytest.mark.slow
def test_a_run_is_drawn_until_standard_input_ends(out):
    line = [sys.executable, "-m", "tipfem.render", str(out), "--size", "480x320", "--as-it-runs", "--strip", "0", "0.2"]
    process = subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    frame = out / "frames_480x320" / "frame_0002.png"
    for _ in range(1200):
        if frame.exists():
            break
        time.sleep(0.05)
    assert frame.exists()
    assert process.poll() is None
    assert not (out / "animation_480x320.mp4").exists()
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert said.splitlines()[0].endswith("strip.png")
    assert (out / "animation_480x320.mp4").exists()


def test_frames_and_mp4(out):
    (out / "frames_480x320").mkdir()
    (out / "frames_480x320" / "frame_0007.png").touch()
    (out / "frames_480x320" / "notes.txt").touch()
    done = animate(out, size=SIZE, backend="raster", view=View(look="flat"), name="480x320")
    assert [path.name for path in done.frames] == ["frame_0000.png", "frame_0001.png", "frame_0002.png"]
    assert sorted(path.name for path in (out / "frames_480x320").iterdir()) == [
        "frame_0000.png",
        "frame_0001.png",
        "frame_0002.png",
        "notes.txt",
    ]
    movie = imageio.imread(out / "animation_480x320.mp4", plugin="FFMPEG")
    assert movie.shape == (3, SIZE[1], SIZE[0], 3)
    frame = np.asarray(Image.open(done.frames[1])).astype(int)
    assert np.abs(frame - movie[1]).mean() < 3
    water = (frame == [0x00, 0x72, 0xB2]).all(axis=2)
    assert water.mean() > 0.1
    assert np.median(np.abs(movie[1][water] - frame[water]), axis=0).max() <= 4
    assert (np.asarray(Image.open(done.frames[0])) != np.asarray(Image.open(done.frames[2]))).any()


def test_gif_and_webp_of_a_field(out):
    done = animate(out, "pressure", False, ["slosh.gif", "slosh.webp"], 10, size=SIZE, backend="raster")
    assert [path.name for path in done.movies] == ["slosh_pressure_480x320.gif", "slosh_pressure_480x320.webp"]
    for path in done.movies:
        with Image.open(path) as image:
            assert image.n_frames == 3
            assert image.size == SIZE
            image.load()
            assert image.info["duration"] == 100
    assert done.frames == []
    assert done.field_range[0] == 0
    assert not (out / "frames_pressure_480x320").exists()
    assert not list(out.glob(".*"))


def test_unfinished_movie_is_an_error_and_leaves_nothing(out):
    writer = MovieWriter(out / "short.mp4", SIZE, 25)
    for _ in range(2):
        writer.append(np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    writer.count += 1
    with pytest.raises(MovieError, match=r"short\.mp4: 2 of 3 frames"):
        writer.finish()
    assert not list(out.glob("*short*"))
    assert not list(out.glob(".*"))


def test_failure_midway_leaves_no_movie(out):
    (out / "fields" / "step_000002.vtu").write_text("<VTKFile")
    with pytest.raises(ResultsError, match="step_000002"):
        animate(out, size=SIZE, backend="raster")
    assert not list(out.glob("*.mp4"))
    assert not list(out.glob(".*"))


@pytest.mark.slow
def test_command_line(out):
    done = command(
        out,
        "--field",
        "speed",
        "--range",
        "0",
        "0.5",
        "--mesh",
        "--particles",
        "--size",
        "480x320",
        "--backend",
        "raster",
        "--movie",
        "a.mp4",
        "--colour",
        "water=#005588",
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "[Taichi]" not in done.stdout
    assert len(list((out / "frames_speed_range_0_0.5_mesh_particles_480x320_water=005588").glob("frame_*.png"))) == 3
    assert (out / "a.mp4").is_file()  # as it was named


@pytest.mark.slow
def test_command_line_errors_are_one_line(tmp_path):
    done = command(tmp_path / "nowhere")
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert "nowhere" in done.stderr
    assert done.stderr.count("\n") == 1
    done = command(tmp_path, "--size", "640")
    assert done.returncode == 2
    assert "'640': expected WIDTHxHEIGHT" in done.stderr


def test_bad_folders(out, tmp_path):
    with pytest.raises(ResultsError, match="no such folder"):
        Results(tmp_path / "nowhere")
    with pytest.raises(ResultsError, match=r"it has no case\.json"):
        Results(tmp_path)
    pvd = (out / "fields.pvd").read_text()
    (out / "fields.pvd").write_text(pvd[: len(pvd) // 2])
    with pytest.raises(ResultsError, match=r"fields\.pvd: not a collection of ParaView"):
        Results(out)
    (out / "fields.pvd").unlink()
    with pytest.raises(ResultsError, match="no fields have been written yet"):
        Results(out)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"format": 1', '"format": 9', "format 9"),
        ('"dimension": 2', '"dimension": 4', "in 4 dimensions"),
        ('"spacing"', '"gap"', "'spacing' is missing"),
        ('"fluids": [', '"fluids": [[], ', r"case\.json"),
        ("{", "", "it cannot be read"),
    ],
)
def test_bad_case(out, old, new, message):
    case = (out / "case.json").read_text()
    (out / "case.json").write_text(case.replace(old, new, 1))
    with pytest.raises(ResultsError, match=message):
        Results(out)


@pytest.mark.parametrize("keep", [0.0, 0.1, 0.5, 0.99])
def test_truncated_step(out, keep):
    path = out / "fields" / "step_000001.vtu"
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(ResultsError, match=r"step_000001\.vtu"):
        Results(out).scene(1)


def test_missing_step_and_index(out):
    (out / "fields" / "step_000001.vtu").unlink()
    with pytest.raises(ResultsError, match="there is no such file"):
        Results(out).scene(1)
    with pytest.raises(IndexError, match="there are 3"):
        Results(out).scene(3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"movie": "animation.avi"}, r"animation\.avi.*\.mp4"),
        ({"movie": "../animation.mp4"}, "without folders"),
        ({"movie": None, "frames": False}, "nothing to write"),
        ({"playback_rate": 0}, "playback rate 0"),
        ({"frame_rate": 0}, "frame rate 0"),
        ({"field": "helicity"}, "helicity"),
        ({"field_range": (0, 1)}, "no field"),
        ({"field": "pressure", "field_range": (1, 0)}, "low below high"),
        ({"size": (481, 320)}, "481x320"),
    ],
)
def test_bad_requests(out, options, message):
    with pytest.raises(ValueError, match=message):
        animate(out, **({"backend": "raster"} | options))
    assert not list(out.glob(".*"))


def test_frame_that_cannot_be_written_is_named(out):
    (out / "frames_480x320" / "frame_0001.png").mkdir(parents=True)
    with pytest.raises(OSError, match=r"frame_0001\.png: the frame could not be written"):
        animate(out, size=SIZE, movie=None, backend="raster")


def test_flat_colours_stay_what_they_are_in_a_gif(out):
    """In all frames, also where little changes from one to the next."""
    [path] = animate(out, movie="flat.gif", size=SIZE, backend="raster").movies
    with Image.open(path) as image:
        frames = [np.asarray(frame.convert("RGB")).reshape(-1, 3) for frame in ImageSequence.Iterator(image)]
    flat = [
        {tuple(c) for c, n in zip(*np.unique(f, axis=0, return_counts=True), strict=True) if n > 0.01 * len(f)}
        for f in frames
    ]
    assert len(flat) > 2
    assert all(colours == flat[0] for colours in flat)


def test_between_stored_times_particles_go_on_and_no_cell_turns_over(tmp_path):
    """Along the velocity (y, -x), within the box; stored times are as stored."""
    results = Results(write_results(tmp_path / "out", times=(0.0, 0.1), sharp=True), keep=2)
    stored = results.scene(0)
    assert results.scene_at(0.0) is stored
    moved = results.scene_at(0.04)
    assert moved.time == 0.04
    wanted = stored.position + 0.04 * stored.position[:, ::-1] * [1, -1]
    inner = ((wanted > 0.01) & (wanted < SIDE - 0.01)).all(axis=1)
    assert moved.position[inner] == pytest.approx(wanted[inner], abs=1e-12)
    assert moved.position.min() >= 0
    assert moved.position.max() <= SIDE
    corners = moved.position[moved.cells], stored.position[stored.cells]
    areas, before = (np.linalg.det(at[:, 1:] - at[:, :1]) for at in corners)
    assert (areas * np.sign(before) > 0).all()
    assert (abs(areas - before) > 1e-3 * abs(before)).any()  # those at the walls are pressed
    back = 2 * stored.position - wanted  # from the time behind, in which particles are where they were
    inner &= ((back > 0.01) & (back < SIDE - 0.01)).all(axis=1)
    assert results.scene_at(0.06).position[inner] == pytest.approx(back[inner], abs=1e-12)


def test_movies_at_sixty_a_second_keep_the_pace(out):
    """From three times at 25 a second five pictures; those of the first time and the last are as stored."""
    options = {"size": SIZE, "backend": "raster", "movie": "even.mp4"}
    even = animate(out, frame_rate=60.0, name="even", **options)
    stored = animate(out, name="stored", **options)
    assert len(even.frames) == 5
    assert even.frames[0].read_bytes() == stored.frames[0].read_bytes()
    assert imageio.immeta(even.movies[0], plugin="FFMPEG")["fps"] == 60
    shown = [np.asarray(Image.open(path)).astype(int) for path in even.frames]
    steps = [abs(b - a).mean() for a, b in itertools.pairwise(shown)]
    assert min(steps) > 0
    case = json.loads((out / "case.json").read_text())
    (out / "case.json").write_text(json.dumps({**case, "period": [SIDE, 0]}))
    with pytest.raises(ResultsError, match="pictures between stored times are of flows in 2-D"):
        animate(out, frame_rate=60.0, **options)

"""A case written to a case file and read back has bitwise the same particles, and does the same."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tipfem as tp
from tipfem.casefile.describing import ARRAYS, describe, write_case
from tipfem.casefile.forms import (
    Constant,
    Limit,
    Limits,
    Polygon,
    Ramp,
    Side,
    Sine,
    SineCurve,
    Table,
    Uniform,
)
from tipfem.casefile.loading import load_case, read_case
from tipfem.casefile.problems import CaseFileError
from tipfem.casefile.record import case_from, case_record
from tipfem.probes import probe_record

WATER = tp.Fluid("water", 998.2, 1.002e-3)
AIR = tp.Fluid("air", 1.204, 1.825e-5)
OIL = tp.Fluid('heavy "oil"', 1261.0, 1.0 / 3.0)


def two_layers(**options):
    tank = tp.tank((0.3, 0.2), 0.02, jitter=0.1, seed=3).fill(AIR).fill(WATER, box=((0, 0), (0.3, 0.1)))
    return tp.Case(tank, [WATER, AIR], (0, -9.81), **options)


def with_disc():
    tank = tp.tank((1, 1 / 3), 1 / 30).fill(AIR).fill(OIL, disc=((0.5, 0.17), 1 / 9))
    return tp.Case(tank, [OIL, AIR], (0.1, -9.81), interface="interpolated", title='A "drop"')


def with_shapes():
    wave = SineCurve(form="cosine", height=0.1, amplitude=0.02, wavelength=0.3)
    tank = tp.tank((0.3, 0.2), 0.02).fill(AIR).fill(WATER, where=Side(curve=wave, above=False))
    tank.fill(OIL, where=Polygon(points=[[0.1, 0.12], [0.2, 0.12], [0.15, 0.18]]))
    return tp.Case(tank, [AIR, OIL, WATER], (0, -9.81))


def with_walls():
    swing = Sine(form="sine", amplitude=0.01, frequency=1.0, soft_start=0.2)
    tank = tp.tank((0.3, 0.2), 0.02).fill(WATER).wall("top", velocity=Ramp(form="ramp", end_value=(1, 0), end_time=1))
    tank.wall("left", slip=True).wall("right", slip_length=0.01)
    floor = tp.Wall("part of the floor", between=((0.1, 0), (0.2, 0)), velocity=(0.5, 0))
    return tp.Case(
        tank, [WATER], (0, -9.81), walls=[floor], tank_motion=tp.Motion(angle=swing, pivot=(0.15, 0)), title="Walls"
    )


def with_a_shape():
    """Arcs, a hole of corners, a circle, names, and a wall that turns."""
    bowl = tp.shapes.polygon(
        [(-1, 0), tp.shapes.arc((0, 0)), (1, 0), (1, 1), (-1, 1)],
        names=["bowl", "right", "top", "left"],
        holes=[[(-0.5, 0.2), (-0.2, 0.2), (-0.2, 0.5)], tp.shapes.circle((0.35, 0.1), 0.25, name="cylinder")],
    )
    tank = tp.tank(shape=bowl, spacing=0.1).fill(AIR).fill(WATER, shape=[(-1, -1), (1, -1), (1, -0.3), (-1, -0.4)])
    tank.wall("cylinder", velocity=0.2).wall("bowl", slip=True).wall("right", slip_length=0.1)
    return tp.Case(tank, [WATER, AIR], (0, -9.81))


def with_grading():
    tank = tp.tank((0.3, 0.2), 0.01).fill(AIR).fill(WATER, box=((0, 0), (0.1, 0.1)))
    limits = Limits(limits=[Limit(box=[[0, 0], [0.3, 0.02]], largest=0.01)])
    tank.wall("bottom", law="layer")
    return tp.Case(tank, [WATER, AIR], (0, -9.81), grading=tp.Grading({"air": 0.04}, 0.3, limits))


def with_surface():
    tank = tp.tank((0.3, 0.2), 0.02).fill(WATER, box=((0, 0), (0.1, 0.1)))
    numerics = tp.Numerics(largest_move=0.3, surface=tp.SurfaceRule(alpha=1.3))
    force = Uniform(Table(form="table", times=[0.0, 0.5, 1.0], values=[(0, 0), (1, 0), (0, 0)]))
    options = {"free_surface": True, "interface": "interpolated"}
    return tp.Case(tank, [WATER], (0, -9.81), numerics=numerics, body_force=force, **options)


def in_3d():
    tank = tp.tank((0.3, 0.2, 0.2), 0.04, jitter=0.1).fill(WATER).wall("back", velocity=(1, 0, 0))
    return tp.Case(tank, [WATER], (0, -9.81, 0), interface="interpolated")


def as_arrays():
    particles = tp.tank((0.3, 0.2), 0.02).fill(WATER).sample([WATER])
    particles.velocity[~particles.wall] = 1 / 3
    wall = tp.Wall("left", particles=np.flatnonzero(particles.position[:, 0] == 0), slip=True)
    return tp.Case(particles, [WATER], (0, -9.81), walls=[wall], interface="interpolated")


CASES = [two_layers, with_disc, with_shapes, with_walls, with_a_shape, with_grading, with_surface, in_3d, as_arrays]


@pytest.mark.parametrize("make", CASES, ids=lambda make: make.__name__)
def test_a_case_read_back_is_the_same(make, tmp_path):
    case = make()
    written = write_case(tmp_path / "case.toml", case, 1.0, largest_step=1 / 300, interval=0.1)
    assert not written.missing
    loaded = load_case(tmp_path / "case.toml")
    again = loaded.case()
    for name in ARRAYS:
        assert np.array_equal(getattr(again.particles, name), getattr(case.particles, name)), name
    assert again.particles.spacing == case.particles.spacing
    assert (loaded.end, loaded.table.time.largest_step, loaded.table.output.interval) == (1.0, 1 / 300, 0.1)
    assert again.fluids == case.fluids
    assert np.array_equal(again.gravity, case.gravity)
    assert (again.interface, again.free_surface, again.title) == (case.interface, case.free_surface, case.title)
    assert again.numerics == case.numerics
    assert [wall.name for wall in again.walls] == [wall.name for wall in case.walls]
    for one, other in zip(again.walls, case.walls, strict=True):
        assert (one.slip, one.slip_length, one.law) == (other.slip, other.slip_length, other.law)
        for time in (0.0, 0.3, 0.9):
            d = case.particles.dimension
            assert np.array_equal(one.sliding(time, d), other.sliding(time, d))
    for time in (0.0, 0.3, 0.9):
        x = case.particles.position
        assert np.array_equal(again.acceleration(x, time), case.acceleration(x, time))
        if case.tank_motion:
            assert again.tank_motion.angle(time) == case.tank_motion.angle(time)
    # And what is written of the one that was read is the same text.
    assert write_case(tmp_path / "again.toml", again, 1.0, largest_step=1 / 300, interval=0.1).text.replace(
        "again.npz", "case.npz"
    ) == (tmp_path / "case.toml").read_text("utf-8")


def lost_where():
    return tp.Case(
        tp.tank((0.3, 0.2), 0.02).fill(AIR).fill(WATER, where=lambda x: x[:, 1] < 0.1), [WATER, AIR], (0, -9.81)
    )


def lost_force():
    return two_layers(body_force=lambda x, t: np.zeros_like(x))


def lost_motion():
    return two_layers(tank_motion=tp.Motion(angle=lambda t: 0.1 * t * t))


def lost_target():
    return two_layers(grading=tp.Grading(where=lambda x: np.full(len(x), 0.02)))


def lost_velocity():
    tank = tp.tank((0.3, 0.2), 0.02).fill(WATER).wall("top", velocity=lambda t: (t, 0.0))
    return tp.Case(tank, [WATER], (0, -9.81))


@pytest.mark.parametrize(
    ("make", "part"),
    [
        (lost_where, "fill[1].where"),
        (lost_force, "body_force"),
        (lost_motion, "tank_motion.angle"),
        (lost_target, "grading.where"),
        (lost_velocity, "walls.top.velocity"),
    ],
)
def test_a_python_function_is_named_and_the_text_refused_at_its_place(make, part):
    described = describe(make(), 1.0)
    assert [what.split(":")[0] for what in described.missing] == [part]
    assert "lambda" in described.missing[0]
    assert f"#   {part}: " in described.text
    with pytest.raises(CaseFileError) as error:
        read_case(described.text, "case.toml")
    assert len(error.value.problems) == 1
    assert part in str(error.value)


def test_particles_changed_after_sampling_are_not_taken_for_those_of_the_tank(tmp_path):
    case = two_layers()
    case.particles.velocity[~case.particles.wall] = 0.1
    assert describe(case, 1.0).missing == ("particles: changed after they were sampled from the tank",)
    write_case(tmp_path / "case.toml", case, 1.0)
    again = load_case(tmp_path / "case.toml").case()
    assert np.array_equal(again.particles.velocity, case.particles.velocity)


def test_a_shape_around_a_body_is_not_left_out_in_silence():
    water = tp.Fluid("water", density=1000.0, viscosity=1e-3)
    tank = tp.tank(shape=tp.shapes.polygon([(0, 0), (1, 0.1), (1, 1), (0, 1)]), spacing=0.1).fill(water)
    case = tp.Case(tank.add(tp.Body(((0.3, 0.4), (0.7, 0.4), (0.7, 0.7), (0.3, 0.7)))), [water], (0.0, -9.81))
    assert not describe(case, 1.0).missing
    restored = case_from(case_record(case))
    assert restored.tank is None
    assert describe(restored, 1.0, particles_file="case.npz").missing == (
        "tank: particles with a shape, or around an axis",
    )


def test_a_constant_function_is_one_of_the_forms():
    case = two_layers(body_force=Uniform(Constant(form="constant", value=(1.0, 0.0))))
    assert 'body_force = {form = "constant", value = [1.0, 0.0]}' in describe(case, 1.0).text


def test_probes_and_checkpoints_are_kept(tmp_path):
    probes = [
        tp.PointProbe(name="point", at=(0.05, 0.05), quantities=("pressure", "velocity_x"), interval=0.01),
        tp.WallForce(name="force", wall="right", fluid="water", impulse=True, time_constant=2e-3),
        tp.EnergyProbe(name="energy"),
    ]
    options = {"checkpoint_interval": 0.5, "checkpoint_wall_interval": None, "probes": probes}
    assert not tp.write_case(tmp_path / "case.toml", two_layers(), 1.0, **options).missing
    file = tp.load_case(tmp_path / "case.toml")
    assert file.settings()["checkpoint_interval"] == 0.5
    assert file.settings()["checkpoint_wall_interval"] is None
    assert list(map(probe_record, file.parts.probes)) == list(map(probe_record, probes))
    assert list(file.simulation().probes.probes) == ["point", "force", "energy"]

    class Own(tp.EnergyProbe):
        pass

    described = tp.describe(two_layers(), 1.0, probes=[Own(name="mine")])
    assert "probes.mine: a class of Python's" in described.missing[0]
    with pytest.raises(tp.CaseFileError, match=r"probes\[0\].type"):
        read_case(described.text, "case.toml")


def test_a_case_file_is_replaced_in_one_piece(tmp_path, monkeypatch):
    """What cannot be written leaves the file that was there."""
    write_case(tmp_path / "case.toml", two_layers(), 1.0)
    before = (tmp_path / "case.toml").read_bytes()

    def full(self, data):
        with open(self, "wb") as file:
            file.write(data[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space"):
        write_case(tmp_path / "case.toml", two_layers(), 2.0)
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("case.toml", before)]


IN_A_C_LOCALE = """
import sys
import tipfem as tp
tp.init()
water = tp.Fluid("water", density=1000.0, viscosity=1.0)
case = tp.Case(tp.tank((0.4, 0.4), 0.1).fill(water), [water], (0, -9.81), title="l\\u00e4ufe")
tp.Simulation(case, sys.argv[1]).run(0.01, progress=False)
"""


@pytest.mark.slow
def test_in_a_c_locale_a_run_leaves_its_case_in_utf_8(tmp_path):
    """In a folder whose name is not ASCII, which Python does not decode there."""
    out = tmp_path / "läufe"
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    words = [sys.executable, "-c", IN_A_C_LOCALE, str(out)]
    done = subprocess.run(words, env=os.environ | plain, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    file = tp.load_case(out / "case.toml")
    assert (file.folder, file.case().title) == (out, "läufe")

"""Prescribed motions that have no room are refused before a run, with the time and the place."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest

import tipfem as tp
from tipfem.case.motion_sweep import require_room
from tipfem.remesh.choice import remesher_for

SYRUP = tp.Fluid("syrup", density=1400.0, viscosity=1.0)
H = 0.05


def case(*bodies, walls=(), free_surface=False, tank_motion=None):
    tank = tp.tank((1.0, 1.0), H).fill(SYRUP, **({"box": ((0, 0), (1, 0.5))} if free_surface else {}))
    for body in bodies:
        tank.add(body)
    for name, motion in walls:
        tank.wall(name, slip=True, motion=motion)
    return tp.Case(tank, [SYRUP], (0, -9.81), free_surface=free_surface, tank_motion=tank_motion)


def moved(name="gate", centre=(0.5, 0.5), contact="stop", **motion):
    box = tp.shapes.rectangle((centre[0] - 0.1, centre[1] - 0.1), (centre[0] + 0.1, centre[1] + 0.1))
    return tp.Body(box, name=name, contact=contact, motion=tp.Motion(**motion) if motion else None)


def test_a_body_that_reaches_a_wall_is_refused_with_the_time():
    """Its upper side is at 0.6 + 3 t; the gap is half a spacing at t = 0.375 / 3."""
    rising = case(moved(translation=lambda t: (0.0, 3 * t)))
    require_room(rising, 0.0, 0.124)
    with pytest.raises(ValueError, match=r"body 'gate': .* to the wall 'top' at t = 0.125 s, at \[0.\d+, 0.975\] m"):
        require_room(rising, 0.0, 10.0)
    simulation = tp.Simulation(rising)
    with pytest.raises(ValueError, match=r"the wall 'top' at t = 0\.125 s"):
        simulation.run(1.0, progress=False)
    assert simulation.step_number == 0


def test_a_body_that_jumps_out_of_the_tank_is_found_between_two_times():
    far = case(moved(translation=lambda t: (30 * t**3, 0.0)))
    reached = (0.375 / 30) ** (1 / 3)
    with pytest.raises(ValueError, match=rf"to the wall 'right' at t = {reached:.4g} s"):
        require_room(far, 0.0, 20.0)


def test_a_turning_body_meets_another():
    """The corner of a square of side 0.2 is 0.141 from its centre; the gap closes to half a spacing as it turns."""
    turning = moved(centre=(0.3, 0.5), angle=lambda t: t)
    obstacle = moved("post", (0.7, 0.5))
    with pytest.raises(ValueError, match=r"body 'gate': its motion takes it to body 'post' at t = 0.175 s"):
        require_room(case(moved(centre=(0.3, 0.5), translation=lambda t: (t, 0.0)), obstacle), 0.0, 0.2)
    require_room(case(turning, obstacle), 0.0, 2 * math.pi)


def test_what_holds_or_floats_is_left_to_the_run():
    require_room(case(moved(contact="hold", translation=lambda t: (0.0, 3 * t))), 0.0, 10.0)
    floating = tp.Body(tp.shapes.circle((0.5, 0.5), 0.15), density=500.0, name="ball")
    require_room(case(floating), 0.0, 10.0)


def test_a_tank_that_moves_over_a_body_is_found():
    motion = tp.Motion(translation=lambda t: (0.0, -t * t))
    with pytest.raises(ValueError, match=r"body 'gate': .* to the wall 'top' at t = 0.6124 s"):
        require_room(case(moved(translation=lambda t: (0.0, 0.0)), tank_motion=motion), 0.0, 1.0)


def test_walls_that_meet_are_found():
    closing = case(walls=[("right", lambda t: t)], free_surface=True)
    require_room(closing, 0.0, 0.8)
    with pytest.raises(
        ValueError, match=r"wall 'right': its motion leaves 0.1\d* m to the opposite wall at t = 0.8\d* s"
    ):
        require_room(closing, 0.0, 2.0)
    late = case(walls=[("right", lambda t: 0.1 * max(t - 2.0, 0.0) ** 3)])
    with pytest.raises(ValueError, match=r"at t = 2\.\d+ s the walls' motions change the volume of the closed tank"):
        require_room(late, 0.0, 5.0)


def test_a_piston_into_more_liquid_than_fits_is_refused():
    """0.5 m^2 in a tank that is 1 - t wide: there is no room from t = 0.5 s on; the top comes down to it at 0.5 m."""
    push = case(walls=[("left", lambda t: t)], free_surface=True)
    require_room(push, 0.0, 0.499, lambda: 0.5)
    with pytest.raises(ValueError, match=r"wall 'left': from t = 0\.5 s on its motion leaves .* their 0\.5 m\^2"):
        require_room(push, 0.0, 0.8, lambda: 0.5)
    simulation = tp.Simulation(push)
    with pytest.raises(ValueError, match=r"wall 'left': from t = 0\.5 s on"):
        simulation.run(0.7, progress=False)
    assert simulation.step_number == 0
    back = case(walls=[("left", lambda t: 0.4 * math.sin(t))], free_surface=True)
    require_room(back, 0.0, 30.0, lambda: 0.5)


def step_at(time, size, last=math.inf):
    return lambda t: size if time < t < last else 0.0


@pytest.mark.parametrize("last", [math.inf, 0.35])
def test_a_motion_that_jumps_is_refused_with_its_name_the_time_and_the_length(last):
    jump = step_at(0.3, 0.07, last)
    for jumping, name in (
        (case(tank_motion=tp.Motion(translation=lambda t: (jump(t), 0.0))), "Case: tank_motion"),
        (case(tank_motion=tp.Motion(angle=jump)), "Case: tank_motion"),
        (case(walls=[("top", jump)], free_surface=True), "Case: wall 'top': motion"),
        (case(moved(translation=lambda t: (0.0, jump(t)))), "body 'gate': motion"),
    ):
        require_room(jumping, 0.0, 0.29)
        with pytest.raises(ValueError, match=rf"{name} jumps by 0\.07 m at t = 0\.3 s"):
            require_room(jumping, 0.0, 1.0)


def test_a_fast_but_smooth_motion_is_no_jump():
    fast = case(tank_motion=tp.Motion(translation=lambda t: (0.3 * math.tanh(t / 1e-4), 0.0)))
    require_room(fast, 0.0, 10.0)


@pytest.mark.parametrize("kind", ["sharp", "interpolated", "two fluids", "spray", "box of 3-D"])
def test_the_first_volume_is_that_of_the_first_state(kind, water, air):
    size, options = (1.0, 0.8), {"free_surface": True}
    if kind == "box of 3-D":
        size = (1.0, 0.6, 0.8)
    tank = tp.tank(size, 0.1, jitter=0.1 if len(size) == 3 else 0.0)
    if kind == "two fluids":
        tank, options = tank.fill(air), {}
    tank.fill(water, box=((0,) * len(size), (*size[:-1], 0.3)))
    if kind == "spray":
        tank.fill(water, disc=((0.5, 0.6), 0.08))
    if kind == "interpolated":
        options["interface"] = "interpolated"
    made = tp.Case(
        tank, [water, air] if kind == "two fluids" else [water], (0,) * (len(size) - 1) + (-9.81,), **options
    )
    volume = remesher_for(made).first_volume(made.particles, made.boundary)
    assert volume == pytest.approx(tp.Simulation(made).state.volume.sum(), rel=1e-12)


MOVED = {
    "wall": """tank = { size = [1.0, 0.6], spacing = 0.05 }
walls.left.motion = { form = "waves", height = 0.02, period = 1.2, depth = 0.3 }""",
    "body": """tank = { size = [1.0, 0.6], spacing = 0.03 }
bodies = [{ name = "paddle", disc = { centre = [0.5, 0.3], radius = 0.1 }, motion.angle = SWING }]""",
    "tank": """tank = { size = [1.0, 0.6], spacing = 0.05 }
tank_motion.angle = SWING""",
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", MOVED)
def test_no_check_of_a_case_starts_taichi(kind, tmp_path):
    """So that `tipfem run --threads N` can start it as it is told to."""
    (tmp_path / "case.toml").write_text(
        MOVED[kind].replace("SWING", '{ form = "sine", amplitude = 0.3, frequency = 1.0, soft_start = 0.5 }')
        + """
gravity = [0, -9.81]
free_surface = true
fluids.water = { density = 998.2, viscosity = 1e-3 }
fill = [{ fluid = "water", box = [[0, 0], [1, 0.3]] }]
time.end = 0.02
"""
    )
    code = "import sys, tipfem as tp; from tipfem.backend import runtime; tp.load_case(sys.argv[1]).case(); "
    code += "assert not runtime.settings(); tp.init(threads=1)"
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "case.toml")], check=True)

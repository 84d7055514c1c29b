"""All that can be moved on a page, in random order, while a run goes on and while it is paused."""

from __future__ import annotations

import math
import random
import socket

import pytest

import tipfem as tp
from tipfem.run.liveview.control import WatchedControl
from tipfem.run.liveview.link import take_over
from tipfem.run.liveview.memory import StateMemory
from tipfem.run.liveview.source import LiveSource

WATER, AIR = tp.Fluid("water", 1000.0, 0.5), tp.Fluid("air", 1.2, 1e-2)
GRAVITY = (0.0, -9.81)


def half_full(tank, *fluids, height=0.3, **options):
    """Water to a height, below air or below nothing."""
    if len(fluids) > 1:
        tank.fill(fluids[1])
    tank.fill(WATER, box=((0, 0), (1, height)))
    return tp.Case(tank, list(fluids), GRAVITY, **options)


def open_tank(*fluids, **options):
    """A tank with an inlet and an outlet in its sides."""
    openings = [
        tp.Inlet(wall="left", between=((0, 0), (0, 0.3)), fluid=WATER, discharge=0.02, name="in"),
        tp.Outlet(wall="right", level=0.3, fluid="water", name="out"),
    ]
    return half_full(tp.tank((1, 0.6), 0.06), *fluids, openings=openings, **options)


def maker():
    """A wave maker in front of a floor that slides."""
    tank = tp.tank((1, 0.6), 0.08)
    tank.wall("left", slip=True, motion=lambda t: 0.02 * math.sin(t) ** 2).wall("bottom", velocity=0.0)
    return half_full(tank, WATER, free_surface=True)


def with_body():
    """A round tank with a body that floats."""
    tank = tp.tank(shape=tp.shapes.circle((0.5, 0.5), 0.5), spacing=0.08)
    tank.add(tp.Body(tp.shapes.rectangle((0.35, 0.5), (0.65, 0.7)), name="box", density=400.0))
    return half_full(tank, WATER, AIR, height=0.6)


# No room for a drop or a poke, nothing to undo, or a closed tank that an opening would fill.
MAY_BE_REFUSED = ("drop", "poke", "undo", "valve", "discharge")
TENSION = {"surface_tension": {("water", "air"): 1.0}, "numerics": tp.Numerics(sliding=False)}
CASES = {
    "two fluids": lambda: half_full(tp.tank((1, 0.6), 0.08), WATER, AIR),
    "interpolated": lambda: half_full(tp.tank((1, 0.6), 0.08), WATER, AIR, interface="interpolated"),
    "free surface": lambda: half_full(tp.tank((1, 0.6), 0.08), WATER, free_surface=True),
    "periodic": lambda: half_full(tp.tank((1, 0.6), 0.08, periodic="x"), WATER, AIR),
    "tension": lambda: half_full(tp.tank((1, 0.6), 0.08), WATER, AIR, **TENSION),
    "openings": lambda: open_tank(WATER, AIR),
    "openings at a free surface": lambda: open_tank(WATER, free_surface=True),
    "walls that move": maker,
    "round tank with a body": with_body,
}


def moves(facts, rng):
    """A function to a random command, as the controls of a page give it, for a run that says ``facts`` of itself."""
    fluids = [fluid["name"] for fluid in facts["fluids"]]

    def place():
        return [rng.uniform(0, 1), rng.uniform(0, 0.6)]

    def push():
        return [rng.uniform(-5, 5), rng.uniform(-5, 5)]

    made = {
        "gravity": lambda: {"value": [rng.uniform(-3, 3), rng.uniform(-12, -5)]},
        "poke": lambda: {"at": place(), "acceleration": push(), "radius": 0.2} if rng.random() < 0.7 else {"at": None},
        "drop": lambda: {"at": place(), "radius": 0.17, "fluid": rng.choice(fluids)},
        "undo": dict,
        "pause": dict,
        "go": dict,
        "step": lambda: {"count": rng.randint(1, 2)},
    }
    if facts["steered"]["viscosity"]:
        made["viscosity"] = lambda: {"fluid": rng.choice(fluids), "value": 10 ** rng.uniform(-2, 0.5)}
    if facts["steered"]["tension"]:
        made["tension"] = lambda: {
            "between": rng.choice(facts["steered"]["tension"])["between"],
            "value": rng.uniform(0, 2),
        }
    if names := [opening["name"] for opening in facts["steered"]["valve"]]:
        made["valve"] = lambda: {"opening": rng.choice(names), "open": rng.random() < 0.6}
        made["discharge"] = lambda: {"opening": "in", "value": rng.uniform(-0.02, 0.04)}
    if walls := [wall["name"] for wall in facts["steered"]["wall"]]:
        made["wall"] = lambda: {"wall": rng.choice(walls), "value": rng.uniform(0, 0.05), "ramp": 0.2}
    return made


@pytest.mark.slow(but=("two fluids", "interpolated"))
@pytest.mark.parametrize("kind", CASES)
def test_whatever_is_moved_is_carried_out_or_refused_and_the_run_goes_on(kind):
    rng = random.Random(kind)
    run = tp.Simulation(CASES[kind](), time_step=0.01)
    control = WatchedControl(run, rate=60, say=lambda text: pytest.fail(text))
    ours, theirs = socket.socketpair()
    control._connect(ours, {})
    page, told, descriptor = take_over(theirs)
    memory = StateMemory(descriptor)
    memory.wanted = True
    source = LiveSource(told["facts"], memory, lambda *_: None)
    made = moves(told["facts"], rng)
    assert set(made) <= {*source.commands, "undo"}
    once = [name for name in made if name not in ("pause", "go", "step", "undo")]
    order = ["go", *rng.sample(once, len(once)), "pause", *rng.sample(once, len(once)), *rng.choices(list(made), k=12)]
    for name in order:
        seen, state, forces = memory.published, run.state, run.forces
        page.send({"name": name, "values": made[name]()})
        for _ in range(2):
            if control.ready(run, run.steer):
                run.step()
                control.after_step(run, run.history[-1])
        refused = [line["message"] for line in page.read() if line.get("message")]
        assert not refused or name in MAY_BE_REFUSED, refused
        changed = run.state is not state or run.forces != forces
        assert changed or refused or name in ("poke", "pause", "go", "wall")
        paused, control._prompt = control.paused, True  # what has changed is published at once
        control.idle(run)
        assert memory.published > seen or not changed
        source.refresh()
        assert len(source.scene(0).position) >= len(run.particles)  # with images beyond periodic sides
        assert (control.paused, control.stopped) == (paused, False)
    step = run.step_number
    run.step()
    assert run.step_number == step + 1
    control.close()
    page.close()
    memory.close()

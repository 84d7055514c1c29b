"""A tank of water and oil to play with in a browser: tilt it, stir it, drag its box, add drops.

    python demos/play.py

It begins tilted, so that it moves. The page has a hand that drags the box, or pushes the fluids where there is
none, a pendulum that tilts gravity, drops, and a button that starts again. Nothing is compared with anything; what you
do is in out/play/steering.jsonl, and `--steering` repeats it. What was played for ten minutes is kept: the next
begins in out/play_2.
"""

import itertools
import math
from pathlib import Path

from tipfem.demos import harness
from tipfem.demos.support.options import Count, Positive

import tipfem as tp
from tipfem.app.options import Flag, Whole
from tipfem.errors import FolderRefused


def case(spacing: float, box: bool = False, piston: bool = False) -> tp.Case:
    """Water below a lighter oil that is a hundred times as viscous, in a tank 1.2 m wide and 0.9 m high.

    With a box that floats between them: it is held by a soft spring, for it stays where it touches a wall. It has no
    boundary layers, which take a third of a step and look the same. With a piston there is no oil, for what is pushed
    aside needs room: the water ends at a free surface.
    """
    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
    oil = tp.Fluid("oil", density=850.0, viscosity=0.1)
    tank = tp.tank(size=(1.2, 0.9), spacing=spacing)
    if piston:
        tank.wall("left", motion=lambda t: 0.0)
    else:
        tank.fill(oil)
    tank.fill(water, box=((0, 0), (1.2, 0.39)))
    if box:
        shape = tp.shapes.rectangle((0.5, 0.36), (0.72, 0.52))
        spring = (400.0, 0.0, 10.0)
        tank.add(tp.Body(shape, "box", density=900.0, stiffness=spring, contact="hold", law="no-slip"))
    title = f"Water and {'a piston' if piston else 'oil'} to play with"
    fluids = [water] if piston else [water, oil]
    return tp.Case(tank, fluids, gravity=(0, -9.81), free_surface=piston, title=title)


def main(
    *,
    spacing: Positive = 0.034,
    time_step: Positive = 0.04,
    end_time: float = math.inf,
    rate: Positive = 30.0,
    port: Whole | None = None,
    no_box: Flag = False,
    piston: Flag = False,
    no_browser: Flag = False,
    paused: Flag = False,
    steering: Path | None = None,
    tilt: float = 20.0,
    threads: Count = 1,
    out: Path = Path("out/play"),
) -> int:
    """Run until the page says stop, or Ctrl-C.

    Args:
        spacing: distance between particles [m]; 0.034 makes 950 of them.
        time_step: the largest [s]; with 40 ms a core keeps up with real time.
        end_time: simulated time to run to [s]; by default until stopped.
        rate: most states per second.
        port: of 127.0.0.1; by default 8800 or one of the next.
        no_box: leave out the box, which makes a step two thirds longer.
        piston: let the left wall be one that moves; the water has a free surface then.
        no_browser: open none; the address is printed in either case.
        paused: begin with a pause.
        steering: the steering.jsonl of an earlier run, to repeat what was done in it.
        tilt: of gravity at the start [degrees]; a steering file has its own.
        threads: of the simulation; the viewer has a core of its own.
        out: folder for the results; with _2, _3, ... at its end if there are others that are to stay.
    """
    tp.init(threads=threads)
    shown: list[tp.Simulation] = []

    # What was played for long stays, as does what still goes on: the next begins in a folder of its own.
    folders = itertools.chain([out], (out.with_name(f"{out.name}_{number}") for number in itertools.count(2)))
    folder = next(folders)

    def begun() -> tp.Simulation:
        nonlocal folder
        tank, simulation = case(spacing, not no_box, piston), None
        while simulation is None:
            try:
                anew = bool(shown) or None
                simulation = tp.Simulation(tank, folder, time_step=time_step, steering=steering, overwrite=anew)
            except FolderRefused:
                if shown or not folder.exists():
                    raise
                folder = next(folders)
        if steering is None and tilt:
            angle = math.radians(tilt)
            simulation.steer(tp.Gravity((9.81 * math.sin(angle), -9.81 * math.cos(angle))))
        shown.append(simulation)
        return simulation

    try:
        tp.live(
            begun(),
            end_time,
            port=port,
            rate=rate,
            browser=not no_browser,
            paused=paused,
            say=lambda line: print(line, flush=True),
            hand=True,
            pace=1.0,
            again=begun,
        )
    except KeyboardInterrupt:
        pass
    simulation = shown[-1]
    print(f"{simulation.step_number} steps to t = {simulation.time:.3g} s; results: {folder}")
    return 0


if __name__ == "__main__":
    harness.command(__name__)

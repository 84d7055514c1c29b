"""What all demos share on the command line: their arguments, and drawing their results."""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from tipfem.case.case import DEFAULT_INTERFACE
from tipfem.mesh.interface import INTERFACES
from tipfem.simulation import Simulation, SimulationError


def demo_arguments(
    description: str,
    *,
    spacing: float,
    end_time: float,
    time_step: float,
    out: str,
    frames_per_second: float,
    interface: str | None = DEFAULT_INTERFACE,
    further: Callable[[argparse.ArgumentParser], object] | None = None,
    arguments: Sequence[str] | None = None,
) -> argparse.Namespace:
    """Read a demo's command line; bad values end the program with one line that says what is wrong.

    Args:
        description: what --help starts with.
        spacing: default distance between particles [m].
        end_time: default end of the run [s].
        time_step: default largest time step [s].
        out: default results folder.
        frames_per_second: default number of pictures per second of simulated time [1/s].
        interface: default interface rule; None where there is no choice, as with a free surface.
        further: adds options of the demo's own to the parser.
        arguments: the words to read; those of the process by default.

    Returns:
        A namespace with spacing, end_time, time_step, arch, out, frames_per_second, frames, and interface if there is
        a choice.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    add = parser.add_argument
    add("--spacing", type=positive, default=spacing, metavar="H", help="distance between particles [m]")
    add("--end-time", type=positive, default=end_time, metavar="T", help="simulated time to run to [s]")
    add("--time-step", type=positive, default=time_step, metavar="DT", help="largest time step [s]; it adapts below")
    if interface is not None:
        add("--interface", choices=sorted(INTERFACES), default=interface, help="rule for the interface of two fluids")
    add("--arch", choices=["cpu", "cuda"], default="cpu", help="where the kernels run")
    add("--out", type=Path, default=Path(out), metavar="FOLDER", help="folder for the results")
    add(
        "--frames-per-second",
        type=positive,
        default=frames_per_second,
        metavar="F",
        help="states written, and pictures drawn, per second of simulated time [1/s]; movies show 25 of them a second",
    )
    parser.set_defaults(frames=True)
    add("--no-frames", dest="frames", action="store_false", default=argparse.SUPPRESS, help="draw no pictures")
    if further:
        further(parser)
    return parser.parse_args(arguments)


def run_demo(simulation: Simulation, until: float) -> None:
    """Run a demo's simulation; one that cannot go on says why and ends the program.

    Args:
        simulation: the simulation, at its start.
        until: end of the run [s].
    """
    try:
        simulation.run(until)
    except SimulationError as error:
        stop(f"{error}\nthe results up to there are in {_place(simulation)}")
    except KeyboardInterrupt:
        stop(f"interrupted at t = {simulation.time:g} s; the results up to there are in {_place(simulation)}")


def finish_demo(
    simulation: Simulation,
    arguments: argparse.Namespace,
    figures: Mapping[str, float],
    missed: Sequence[str],
    *,
    plot: Callable[[], object],
    strip: Sequence[float] = (),
) -> None:
    """End a demo of one run: its summary, its pictures, what it found; see `conclude` for the exit status.

    Args:
        simulation: at the end of the run.
        arguments: from `demo_arguments`.
        figures: what was measured, by name.
        missed: what the demo's check found wrong.
        plot: draws the demo's own figures.
        strip: times drawn side by side in strip.png [s].
    """
    simulation.write_summary({"status": "complete", "validation": dict(figures), "check": list(missed) or "passed"})
    plot()
    if arguments.frames:
        draw(arguments.out, strip)
    last = simulation.history[-1]
    print(f"{last['step']} steps to t = {last['time']:g} s in {last['wall_seconds']:.0f} s")
    for name, value in figures.items():
        print(f"  {name:24s} {value: .4g}")
    conclude(arguments.out, missed)


def conclude(out: Path, missed: Sequence[str]) -> None:
    """Say what a demo's check found and where its results are; the exit status is 1 if something was missed."""
    print("check: " + ("; ".join(missed) if missed else "passed"))
    print(f"results: {out.resolve()}")
    if missed:
        raise SystemExit(1)


def draw(out: Path, strip: Sequence[float] = ()) -> None:
    """Draw frames and movie of a results folder, and the states at the times of a ``strip`` [s] in one picture, in
    a process of its own: a graphics driver that fails cannot take the results with it.

    Raises:
        SystemExit: drawing failed; the results themselves are safe.
    """
    words = ["--strip", *map(repr, map(float, strip))] if strip else []
    try:
        done = subprocess.run([sys.executable, "-m", "tipfem.render", str(out), *words], check=False)
    except KeyboardInterrupt:
        stop(f"interrupted while drawing; the results are in {out}")
    if done.returncode:
        stop(f"the pictures could not be drawn (see above); the results are in {out}")


@contextmanager
def one_message() -> Iterator[None]:
    """What a demo's settings are refused for ends the program with one message."""
    try:
        yield
    except (ValueError, RuntimeError) as error:
        stop(str(error))


def above(figures: Mapping[str, float], limits: Mapping[str, float]) -> list[str]:
    """One line for each figure that is above its limit, or no number; limits without a figure are passed over."""
    return [
        f"{name} is {figures[name]:.4g}, above {limit:g}"
        for name, limit in limits.items()
        if name in figures and not figures[name] <= limit
    ]


def stop(message: str) -> NoReturn:
    """End the program with one message on the error output."""
    print(f"error: {message}", file=sys.stderr)
    raise SystemExit(1)


def _place(simulation: Simulation) -> str:
    return str(simulation.results.path) if simulation.results else "memory only: no folder was given"


def positive(text: str) -> float:
    """A number > 0 from the command line, as the type of an option.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number > 0")
    return value

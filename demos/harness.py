"""What all demos share: their options, and one call that runs a case, checks it and draws it.

A demo is a flat script of two calls into this module, with the case between them:

    options = harness.options(__doc__, spacing=0.005, end_time=0.4, out="out/mine")
    case = tp.Case(...)
    harness.run(case, options)

`options` reads the command line; `run` initialises Taichi, runs the simulation, says what the demo's `Check` found and
draws pictures. `load` gives tests and studies the case of a script without running it.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from tipfem.demos.support.options import ShowDefaults

import tipfem as tp
from tipfem.case.case import DEFAULT_INTERFACE, INTERFACES
from tipfem.casefile.options import Shown
from tipfem.casefile.running import COMMAND_FILE, open_log
from tipfem.checkpoint import CheckpointFolder

Probe = Callable[[tp.Simulation], float]


class Check:
    """What a demo measures in its run, what it expects there, and its own figures.

    A demo's check overrides what it needs; this one measures and expects nothing, and a run's summary says "none".
    """

    def columns(self) -> dict[str, Probe]:
        """Columns that the history needs for the measurement: functions of the simulation, by name."""
        return {}

    def begin(self, simulation: tp.Simulation, options: argparse.Namespace) -> None:
        """Look at the simulation before its first step."""

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """What was measured in a run that has ended, by name."""
        return {}

    def missed(self, figures: Mapping[str, float], options: argparse.Namespace) -> list[str]:
        """A line for each figure of a run with these options that is not as expected; empty when all are."""
        return []

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: argparse.Namespace) -> None:
        """Draw the demo's own figures into the folder ``options.out``."""


@dataclass(frozen=True)
class Option:
    """An option of one demo's own.

    Attributes:
        default: its value when it is not given.
        help: what --help says about it.
        kind: function that converts the word on the command line.
        choices: the values allowed, or None for any.
    """

    default: Any
    help: str
    kind: Callable[[str], Any] = str
    choices: Sequence[str] | None = None


@dataclass(frozen=True)
class Loaded:
    """A demo script that was read without being run; see `load`.

    Attributes:
        case: what it would simulate.
        options: its options.
        check: its check.
        strip: the times that strip.png would show [s].
    """

    case: tp.Case
    options: argparse.Namespace
    check: Check
    strip: tuple[float, ...]


class _Stop(Exception):
    """Ends a script at its call of `run` when it is only loaded."""


class _Loading:
    """What `load` and the script that it executes tell one another."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.settings = dict(settings)
        self.found: Loaded | None = None


_loading: _Loading | None = None


def options(
    description: str | None,
    *,
    spacing: float,
    end_time: float,
    time_step: float,
    frames_per_second: float,
    out: str,
    interface: str | None = DEFAULT_INTERFACE,
    **further: Option,
) -> argparse.Namespace:
    """Read a demo's command line; bad values end the program with one line that says what is wrong.

    Args:
        description: the script's docstring; --help starts with its first paragraph.
        spacing: default distance between particles [m].
        end_time: default end of the run [s].
        time_step: default largest time step [s].
        frames_per_second: default number of states written per second of simulated time [1/s].
        out: default results folder.
        interface: default interface rule; None where there is no choice, as with a free surface.
        further: options of the demo's own, by their name in Python: air_spacing becomes --air-spacing.

    Returns:
        A namespace with spacing, end_time, time_step, arch, out, frames_per_second, frames, the demo's own options, and
        interface if there is a choice; and resume, whether a run in the folder is to be gone on with.
    """
    parser = argparse.ArgumentParser(
        prog=sys.argv[0] if sys.argv[0].startswith("tipfem ") else None,
        description=(description or "").split("\n\n")[0],
        formatter_class=ShowDefaults,
    )
    add = parser.add_argument
    add("--spacing", type=positive, default=spacing, metavar="H", help="distance between particles [m]")
    add("--end-time", type=positive, default=end_time, metavar="T", help="simulated time to run to [s]")
    add("--time-step", type=positive, default=time_step, metavar="DT", help="largest time step [s]; it adapts below")
    if interface is not None:
        add("--interface", choices=sorted(INTERFACES), default=interface, help="rule for the interface of two fluids")
    add("--arch", choices=["cpu", "cuda", "vulkan"], default="cpu", help="where the kernels run; GPUs are untried")
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
    add("--overwrite", action="store_true", help="replace the results of a run of ten minutes or more in the folder")
    add("--log-json", type=Path, metavar="FILE", help="file for the log, a JSON object a line, every step among them")
    add("--resume", action="store_true", help="go on with the run in the results folder, if one has begun there")
    for name, option in further.items():
        metavar = None if option.choices else name.rpartition("_")[2].upper()
        words = {"type": option.kind, "default": option.default, "choices": option.choices, "help": option.help}
        add(f"--{name.replace('_', '-')}", metavar=metavar, **words)
    if _loading is None:
        sys.excepthook = _show_refusal
        return parser.parse_args()
    read = parser.parse_args([])
    unknown = set(_loading.settings) - set(vars(read))
    if unknown:
        raise TypeError(f"the demo has no option {', '.join(sorted(unknown))}")
    return argparse.Namespace(**{**vars(read), **_loading.settings})


def run(
    case: tp.Case,
    options: argparse.Namespace,
    *,
    check: Check | None = None,
    columns: Mapping[str, Probe] | None = None,
    strip: Sequence[float] = (),
) -> tp.Simulation:
    """Run a case to the end, with progress; check it; write a summary; draw its figures, frames and movie.

    The exit status of the program is 1 if the check finds something wrong, or if the run cannot go on.

    Args:
        case: what is simulated.
        options: from `options`.
        check: what is measured and expected.
        columns: further columns of the history, by name: functions of the simulation.
        strip: times drawn side by side in strip.png [s]; those after the run's end are left out.

    Returns:
        The simulation at its end.
    """
    check = check or Check()
    shown = tuple(time for time in strip if time <= options.end_time)
    if _loading is not None:
        _loading.found = Loaded(case, options, check, shown)
        raise _Stop
    with ExitStack() as log:
        with one_message():
            open_log(log, Shown(log_json=options.log_json))
            tp.init(arch=options.arch)
            simulation = _simulation(case, options, check, columns or {})
        if simulation.time < options.end_time:
            run_to_end(simulation, options.end_time)
    figures = check.figures(simulation)
    missed = check.missed(figures, options)
    passed = "none" if type(check) is Check else "passed"
    simulation.write_summary({"status": "complete", "validation": figures, "check": missed or passed})
    try:
        check.plot(simulation, figures, options)
    except ImportError as error:  # without matplotlib, which is an extra; the run and its check count all the same
        print(f"note: {error}", file=sys.stderr)
    if options.frames:
        draw(options.out, shown)
    last = simulation.history[-1]
    print(f"{last['step']} steps to t = {last['time']:g} s in {last['wall_seconds']:.0f} s")
    for name, value in figures.items():
        print(f"  {name:24s} {value: .4g}")
    conclude(options.out, missed, passed)
    return simulation


def _simulation(
    case: tp.Case, options: argparse.Namespace, check: Check, columns: Mapping[str, Probe]
) -> tp.Simulation:
    """The simulation of a demo: at its start, or at the newest checkpoint of a run that is gone on with."""
    if not (options.resume and CheckpointFolder(options.out).files()):
        simulation = tp.Simulation(
            case,
            out=options.out,
            time_step=options.time_step,
            output_interval=1.0 / options.frames_per_second,
            columns={**check.columns(), **columns},
            overwrite=options.overwrite or None,
        )
        check.begin(simulation, options)
        _keep_command(simulation)
        return simulation
    # What a check measures at the start it measures before its columns are used.
    check.begin(tp.Simulation(case, time_step=options.time_step), options)
    simulation = tp.Simulation.resume(options.out, case, columns={**check.columns(), **columns})
    for note in simulation.notes:
        print(f"note: {note}", file=sys.stderr)
    print(f"going on from step {simulation.step_number}, t = {simulation.time:g} s", file=sys.stderr)
    return simulation


def _keep_command(simulation: tp.Simulation) -> None:
    """Write the command that goes on with the run into the results folder, from where `tipfem resume` tells it."""
    program = sys.argv[0].split() if sys.argv[0].startswith("tipfem ") else ["python", sys.argv[0]]
    words = [*program, *(word for word in sys.argv[1:] if word != "--resume"), "--resume"]
    results = simulation.results
    assert results is not None
    results.list_file(COMMAND_FILE)
    (results.path / COMMAND_FILE).write_text(json.dumps(words) + "\n", encoding="utf-8")


def load(name: str, **settings: Any) -> Loaded:
    """The case of a demo script, which is executed up to its call of `run`.

    Args:
        name: of the script, such as "dam_break".
        settings: values of its options, by their names in Python.

    Raises:
        FileNotFoundError: there is no such demo.
        TypeError: the demo has no such option.
        ValueError: the case is refused, or the script does not call `run`.
    """
    global _loading
    path = Path(__file__).with_name(f"{name}.py")
    code = compile(path.read_text(encoding="utf-8"), str(path), "exec")
    _loading = current = _Loading(settings)
    try:
        exec(code, {"__name__": f"tipfem.demos.{name}", "__file__": str(path)})
    except _Stop:
        pass
    finally:
        _loading = None
    if current.found is None:
        raise ValueError(f"{path} does not call harness.run")
    return current.found


def run_to_end(simulation: tp.Simulation, until: float) -> None:
    """Run a simulation; one that cannot go on says why and ends the program.

    Args:
        simulation: the simulation, at its start.
        until: end of the run [s].
    """
    place = simulation.results.path if simulation.results else "memory only: no folder was given"
    try:
        simulation.run(until)
    except tp.SimulationError as error:
        stop(f"{error}\nthe results up to there are in {place}")
    except KeyboardInterrupt:
        print(f"interrupted at t = {simulation.time:g} s; the results up to there are in {place}", file=sys.stderr)
        raise SystemExit(128 + signal.SIGINT) from None


def conclude(out: Path, missed: Sequence[str], passed: str = "passed") -> None:
    """Say what a check found and where the results are; the exit status is 1 if something was missed."""
    print("check: " + ("; ".join(missed) or passed))
    print(f"results: {out.resolve()}")
    if missed:
        raise SystemExit(1)


def draw(out: Path, strip: Sequence[float] = ()) -> None:
    """Draw frames and movie of a results folder, and the states at the times of a ``strip`` [s] in one picture.

    They are drawn in a process of their own: a graphics driver that fails cannot take the results with it.

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
    """A ValueError or RuntimeError ends the program with its message alone."""
    try:
        yield
    except (ValueError, RuntimeError) as error:
        stop(str(error))


def above(figures: Mapping[str, float], limits: Mapping[str, float]) -> list[str]:
    """One line for each figure that is above its limit, or NaN; limits without a figure are passed over."""
    return [
        f"{name} is {figures[name]:.4g}, above {limit:g}"
        for name, limit in limits.items()
        if name in figures and not figures[name] <= limit
    ]


def stop(message: str) -> NoReturn:
    """End the program with one message on the error output."""
    print(f"error: {message}", file=sys.stderr)
    raise SystemExit(1)


def positive(text: str) -> float:
    """A number > 0 from the command line, as the kind of an option.

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


def _show_refusal(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Show a ValueError that tipfem raised as one line, with the script's line; all others with their traceback."""
    demos, package = Path(__file__).parent, Path(tp.__file__).parent
    # Generated code, such as that of dataclasses, has no file.
    frames = [frame for frame in traceback.extract_tb(trace) if not frame.filename.startswith("<")]
    # Installed, the demos are a folder of the package.
    inside = [Path(f.filename).is_relative_to(package) and not Path(f.filename).is_relative_to(demos) for f in frames]
    if not (kind is ValueError and inside and inside[-1] and not all(inside)):
        sys.__excepthook__(kind, error, trace)
        return
    script = [frame for frame, within in zip(frames, inside, strict=True) if not within][-1]
    print(f"error: {error} ({Path(script.filename).name}, line {script.lineno})", file=sys.stderr)

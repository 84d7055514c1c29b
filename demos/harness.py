"""The front door of the demos: a case, a check of its results, and pictures.

A demo is a module whose `main` is a `Demo`, made of a case file or of a function that returns the case, or a function
with typed keywords, as the studies in demos/validation are. `command` runs either from a command line.
"""

from __future__ import annotations

import inspect
import json
import math
import signal
import subprocess
import sys
import textwrap
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, NoReturn, get_type_hints

from cyclopts import App, Parameter
from tipfem.demos.support.options import Positive, Rule

import tipfem as tp
from tipfem.app.commands import call
from tipfem.app.options import Flag, Shown, Start
from tipfem.app.running import COMMAND_FILE, bad_input, begun, gone_on, open_log, run_to, viewer_of
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError
from tipfem.run.case_file import CaseFile, load_case
from tipfem.run.checkpoint import CheckpointFolder

Probe = Callable[[tp.Simulation], float]
Options = SimpleNamespace  # the values of a demo's options, by their names in Python

COMMON = """\
spacing: distance between particles [m].
end_time: simulated time to run to [s].
time_step: largest time step [s]; it adapts below.
frames_per_second: states written, and pictures drawn, per second of simulated time [1/s]; movies show 25 a second.
interface: rule for the interface of two fluids.
no_frames: draw no pictures.
resume: go on with the run in the results folder, if one has begun there.
"""
# The keys of a case file that options stand for, beside a demo's own.
KEYS = {
    "spacing": "tank.spacing",
    "end_time": "time.end",
    "time_step": "time.largest_step",
    "frames_per_second": "output.interval",
    "interface": "interface",
}


class Check:
    """What a demo measures in its run, what it expects there, and its own figures.

    A demo's check overrides what it needs; this one measures and expects nothing, and a run's summary says "none".
    """

    def columns(self) -> dict[str, Probe]:
        """Columns that the history needs for the measurement: functions of the simulation, by name."""
        return {}

    def begin(self, simulation: tp.Simulation, options: Options) -> None:
        """Look at the simulation before its first step."""

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Figures of a run that has ended, by name."""
        return {}

    def missed(self, figures: Mapping[str, float], options: Options) -> list[str]:
        """A line for each figure of a run with these options that is not as expected; empty when all are."""
        return []

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: Options) -> None:
        """Draw the demo's own figures into the folder ``options.out``."""


@dataclass(frozen=True)
class Prepared:
    """A demo with values for its options, before it runs.

    Attributes:
        file: the case file; of a function's case, one that describes it.
        case: made of it.
        options: the values of its own options, and of those that the case file has keys for.
        check: what is measured and expected.
        strip: times drawn side by side in strip.png [s].
    """

    file: CaseFile
    case: tp.Case
    options: Options
    check: Check
    strip: tuple[float, ...]


@dataclass(frozen=True)
class Demo:
    """A case, how long it runs, what is expected of it, and which of its times are drawn side by side.

    Attributes:
        source: a function that returns the case, whose arguments are options of the demo, ``spacing`` the first of
            them; or the name of a case file in demos/cases.
        end_time: default end of the run [s], of a function's case; a case file has its own, and so with the next two.
        time_step: default largest time step [s].
        frames_per_second: default number of states written per second of simulated time [1/s].
        check: what is measured and expected, or a function of the case that gives it.
        strip: times drawn side by side in strip.png [s]; those after the run's end are left out, infinity is the end.
        keys: further options of a case file: the dotted key of each, which is a number > 0, and what it is.
    """

    source: Callable[..., tp.Case] | str
    end_time: float = math.nan
    time_step: float = math.nan
    frames_per_second: float = math.nan
    check: Check | Callable[[tp.Case], Check] = field(default_factory=Check)
    strip: Sequence[float] = ()
    keys: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """The script or the case file that has the case."""
        if isinstance(self.source, str):
            return Path(__file__).parent / "cases" / self.source
        return Path(inspect.getfile(self.source))

    def defaults(self) -> dict[str, tuple[Any, Any]]:
        """Type and default of each option of its own, by its name in Python."""
        own: dict[str, tuple[Any, Any]] = {}
        if isinstance(self.source, str):
            file = load_case(self.path)
            own["spacing"] = Positive, file.data["tank"]["spacing"]
            if "interface" in file.data:
                own["interface"] = Rule, file.data["interface"]
            own.update(dict.fromkeys(self.keys, (Positive | None, None)))
            times = file.end, file.data["time"]["largest_step"], round(1.0 / file.data["output"]["interval"], 9)
        else:
            hints = get_type_hints(self.source, include_extras=True)
            for name, parameter in inspect.signature(self.source).parameters.items():
                own[name] = hints[name], parameter.default
            times = self.end_time, self.time_step, self.frames_per_second
        until = Annotated[Positive, Parameter(name=("--until", "--end-time"))]
        kinds = {"end_time": until, "time_step": Positive, "frames_per_second": Positive}
        return {
            "spacing": own.pop("spacing"),
            **{name: (kind, default) for (name, kind), default in zip(kinds.items(), times, strict=True)},
            **own,
        }

    def prepared(self, overrides: Sequence[str] = (), **given: Any) -> Prepared:
        """The demo with these options, and the defaults of all others.

        Args:
            overrides: values in place of those of its case file, see `tipfem.load_case`.
            given: options of its own.

        Raises:
            TypeError: the demo has no such option.
            ValueError: the case is refused.
        """
        usual = {name: default for name, (_, default) in self.defaults().items()}
        if unknown := set(given) - set(usual):
            raise TypeError(f"the demo has no option {', '.join(sorted(unknown))}")
        values = {**usual, **given}
        if isinstance(self.source, str):
            keys = {**KEYS, **{name: key for name, (key, _) in self.keys.items()}}
            changed = {name: value for name, value in given.items() if value not in (None, usual[name])}
            if "frames_per_second" in changed:
                changed["frames_per_second"] = 1.0 / changed["frames_per_second"]
            file = load_case(self.path, [*(f"{keys[name]}={value}" for name, value in changed.items()), *overrides])
        else:
            made = self.source(**{name: values[name] for name in inspect.signature(self.source).parameters})
            times = {"largest_step": values["time_step"], "interval": 1.0 / values["frames_per_second"]}
            text = tp.describe(made, values["end_time"], **times).text
            file = CaseFile(**vars(read_case(text, f"{self.path.stem}.toml", overrides=overrides)))
        case, table = file.case(), file.table
        values |= {"spacing": case.particles.spacing, "interface": case.interface, "end_time": file.end}
        values |= {"time_step": table.time.largest_step, "frames_per_second": 1.0 / (table.output.interval or math.inf)}
        check = self.check if isinstance(self.check, Check) else self.check(case)
        strip = (min(time, file.end) if math.isinf(time) else time for time in self.strip)
        return Prepared(file, case, Options(**values), check, tuple(time for time in strip if time <= file.end))

    def function(self, words: Sequence[str] = ()) -> Callable[..., int]:
        """A function of the options as keywords, which `command` reads the command line for.

        Args:
            words: the words of the command that goes on with the run.
        """

        def run(
            *,
            no_frames: Flag = False,
            resume: Flag = False,
            start: Start = Start(),  # noqa: B008 - it is frozen, as Shown is
            shown: Shown = Shown(),  # noqa: B008
            **given: Any,
        ) -> int:
            return _run(self.prepared(start.set or (), **given), start, shown, words, resume, not no_frames)

        keyword = inspect.Parameter.KEYWORD_ONLY
        common = {
            "no_frames": (Flag, False),
            "resume": (Flag, False),
            "start": (Start, Start()),
            "shown": (Shown, Shown()),
        }
        defaults = {**self.defaults(), **common}
        own = "".join(f"{name}: {text}\n" for name, (_, text) in self.keys.items())
        if callable(self.source):
            own = textwrap.dedent((inspect.getdoc(self.source) or "").partition("Args:\n")[2].partition("\n\n")[0])
        run.__annotations__ = {name: kind for name, (kind, _) in defaults.items()}
        run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [inspect.Parameter(n, keyword, default=value, annotation=kind) for n, (kind, value) in defaults.items()]
        )
        run.__doc__ = f"Run it.\n\nArgs:\n{textwrap.indent(COMMON + own, '    ')}"
        return run


def _run(demo: Prepared, start: Start, shown: Shown, words: Sequence[str], resume: bool, frames: bool) -> int:
    """Run a case to the end, check it, write a summary, and draw its figures and pictures; the exit code.

    Args:
        demo: what runs.
        start: how it is started.
        shown: how it is shown.
        words: of the command that goes on with the run.
        resume: whether to go on with a run in the folder.
        frames: whether pictures are drawn.
    """
    check, end = demo.check, demo.file.end
    demo.options.out = out = start.out or demo.file.folder
    with ExitStack() as log:
        with bad_input() as failed:
            if resume and CheckpointFolder(out).files():
                open_log(log, shown)
                simulation = gone_on(out, demo.file, threads=start.threads, columns=check.columns())
                # What a check measures at the start.
                check.begin(tp.Simulation(demo.case, time_step=demo.options.time_step), demo.options)
                for note in simulation.notes:
                    print(f"note: {note}", file=sys.stderr)
                print(f"going on from step {simulation.step_number}, t = {simulation.time:g} s", file=sys.stderr)
                control = viewer_of(simulation, shown)
            else:
                columns = check.columns()
                simulation, control = begun(demo.file, demo.case, start, shown, log, columns=columns, again=True)
                check.begin(simulation, demo.options)
                results = simulation.results
                assert results is not None
                # `tipfem resume` tells the command: the folder does not have the check's columns.
                results.list_file(COMMAND_FILE)
                (results.path / COMMAND_FILE).write_text(json.dumps(list(words)) + "\n", encoding="utf-8")
        if failed:
            return 2
        with Drawing(out, demo.strip) if frames else nullcontext() as drawing:
            if simulation.time < end:
                code = run_to(simulation, end, progress=shown.progress, control=control)
                if code or simulation.time < end:
                    return code
            if drawing:
                drawing.end()
            missed, passed = _checked(check, simulation, demo.options)
    return max(conclude(out, missed, passed), 1 if drawing and drawing.failed else 0)


def _checked(check: Check, simulation: tp.Simulation, options: Options) -> tuple[list[str], str]:
    """What a check misses, and the word for a run that misses nothing; its figures are told, kept and drawn."""
    figures = check.figures(simulation)
    missed = check.missed(figures, options)
    passed = "none" if type(check) is Check else "passed"
    simulation.write_summary({"status": "complete", "validation": figures, "check": missed or passed})
    try:
        check.plot(simulation, figures, options)
    except ImportError as error:  # without matplotlib, which is an extra; the run and its check count all the same
        print(f"note: {error}", file=sys.stderr)
    for name, value in figures.items():
        print(f"  {name:24s} {'none yet' if math.isnan(value) else format(value, ' .4g')}")
    return missed, passed


def command(module: str, words: Sequence[str] | None = None, program: str = "") -> int:
    """Run a demo from a command line; bad input ends with one sentence.

    Args:
        module: its name, in which ``main`` is a `Demo`, or a function whose typed keywords are the options.
        words: the command line; by default that of the process, which this ends.
        program: what the demo was called by, such as "tipfem demo dam_break"; by default the script's path.

    Returns:
        The exit code, see `tipfem.app.commands.EXIT_CODES`; 1 also where a check finds something wrong.

    Raises:
        SystemExit: with the exit code, without ``words``.
    """
    demo = sys.modules[module]
    given = sys.argv[1:] if words is None else list(words)
    called = program.split() or ["python", sys.argv[0]]
    about = " ".join((demo.__doc__ or "").split("\n\n")[0].split())
    app = App(name=" ".join(called), help=about, version_flags=[])
    if isinstance(demo.main, Demo):
        app.default(demo.main.function([*called, *(word for word in given if word != "--resume"), "--resume"]))
    else:
        app.default(demo.main)
    try:
        code = call(app, given)
    except (ValueError, RuntimeError, OSError) as error:
        if (message := _refusal(error)) is None:
            raise
        print(message, file=sys.stderr)
        code = 2
    except KeyboardInterrupt:  # outside of a run
        print("interrupted", file=sys.stderr)
        code = 128 + signal.SIGINT
    if words is None:
        raise SystemExit(code)
    return code


def _refusal(error: Exception) -> str | None:
    """One line for an error that tipfem or a demo raised, with the line of the demo; None for all others."""
    demos, package = Path(__file__).parent, Path(tp.__file__).parent
    # Generated code, such as that of dataclasses, has no file.
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<")]
    ours = [Path(frame.filename).is_relative_to(demos) for frame in frames]  # installed, they are in the package
    solver = [Path(frame.filename).is_relative_to(package) and not our for frame, our in zip(frames, ours, strict=True)]
    if not (solver[-1] or ours[-1] or isinstance(error, OSError)):
        return None
    if isinstance(error, CaseFileError):
        return str(error)
    caller = [frame for frame, within in zip(frames, solver, strict=True) if not within][-1]
    place = Path(caller.filename)
    return f"error: {error}" + ("" if place == Path(__file__) else f" ({place.name}, line {caller.lineno})")


def conclude(out: Path, missed: Sequence[str], passed: str = "passed") -> int:
    """Say what a check found and where the results are; the exit code, 1 if something was missed."""
    print("check: " + ("; ".join(missed) or passed))
    print(f"results: {out.resolve()}")
    return 1 if missed else 0


def report(out: Path, content: Mapping[str, Any], missed: Sequence[str]) -> int:
    """Write a study's summary.json with what its check missed, and say so; the exit code."""
    summary = {**content, "check": list(missed) or "passed"}
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return conclude(out, missed)


class Drawing:
    """Draws frames and movie of a run as it goes on, and then the states at some times in one picture.

    They are drawn in a process of their own, by what the run leaves of the processor: a graphics driver that fails
    cannot take the results with it.

    Args:
        out: results folder of the run, which has begun.
        strip: times [s] of the states in one picture.

    Attributes:
        failed: whether something could not be drawn, once all else is; the results themselves are safe.
    """

    def __init__(self, out: Path, strip: Sequence[float] = ()) -> None:
        words = ["--strip", *map(repr, map(float, strip))] if strip else []
        command = [sys.executable, "-m", "tipfem.render", str(out), "--as-it-runs", *words]
        self._out, self.failed = out, False
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def end(self) -> None:
        """Say that the run has ended."""
        if self._process.stdin:
            with suppress(OSError):
                self._process.stdin.close()
            self._process.stdin = None

    def __enter__(self) -> Drawing:
        return self

    def __exit__(self, *_: object) -> None:
        """Wait until all is drawn, and say what there is."""
        self.end()
        try:
            print(self._process.communicate()[0], end="")
        except KeyboardInterrupt:
            stop(f"interrupted while drawing; the results are in {self._out}")
        self.failed = bool(self._process.returncode)
        if self.failed:
            print(
                f"error: not all pictures could be drawn (see above); the results are in {self._out}", file=sys.stderr
            )


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

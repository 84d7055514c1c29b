"""The commands on case files and results: new, run, resume, check, info, compare, convert and more.

Each returns its exit code; see `EXIT_CODES`. Taichi is imported by those that need it, when they do.
"""

from __future__ import annotations

import json
import math
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from tipfem.app.comparing import compare
from tipfem.app.compiling import compile
from tipfem.app.options import FilePath, Flag, Overrides, Whole, printable, require_png
from tipfem.app.running import loaded, refusing, resume, run
from tipfem.arguments import meant
from tipfem.case.fluid import described_viscosity
from tipfem.casefile.registry import LISTED
from tipfem.errors import CaseDoubt

if TYPE_CHECKING:
    from tipfem.run.simulation import Simulation

EXIT_CODES = {
    0: "all went well",
    1: "the run stopped before its end (its results up to there are kept), or doctor found that something is missing",
    2: "bad input: the command line, the case file, or a folder; nothing was started",
    129: "the terminal was closed (SIGHUP); as for 130",
    130: "interrupted (Ctrl-C, SIGINT): the step was finished; last state, checkpoint and summary are written",
    143: "terminated (SIGTERM); as for 130",
}


# Words that are tried for commands, and the commands that do that.
MEANT = {
    "study": "sweep",
    "start": "run",
    "restart": "resume",
    "continue": "resume",
    "validate": "check",
    "plot": "render",
    "movie": "render",
    "show": "view",
}


def register(app: App) -> None:
    """Add the commands to an application."""
    codes = "Exit codes: " + "; ".join(f"{code}: {text}" for code, text in EXIT_CODES.items()) + "."
    app.help_epilogue = codes
    app.command(run, help_epilogue=codes)
    app.command(resume, help_epilogue=codes)
    for command in (new, check, info, compare, convert, compile, doctor, share, view, schema):
        app.command(command, help_epilogue="")
    app.command(render, help_flags=[], version_flags=[], help_epilogue="")

    @app.command(help_epilogue="")
    def completion(shell: Literal["bash", "zsh", "fish"], /) -> None:
        """Print the script that completes commands and options in a shell.

        Args:
            shell: bash, zsh or fish. In bash: eval "$(tipfem completion bash)".
        """
        print(app.generate_completion(shell=shell))


@refusing
def new(kind: str = "", out: FilePath | None = None, /) -> None:
    """Write a case file to begin with; without a kind, list all kinds.

    Args:
        kind: channel, sloshing, flume, drop, filling or separator.
        out: The file to write; by default the kind and .toml, in this folder.
    """
    kinds = {path.stem: path for path in sorted(Path(__file__).with_name("new").glob("*.toml"))}
    if not kind:
        for name, path in kinds.items():
            print(f"{name:10} {path.read_text(encoding='utf-8').splitlines()[0].removeprefix('# ').split(':')[0]}")
        return
    if kind not in kinds:
        raise ValueError(f"new: there is no kind {kind!r}; there are {', '.join(kinds)}{meant(kind, list(kinds))}")
    target = out or Path(f"{kind}.toml")
    try:
        with open(target, "x", encoding="utf-8") as file:
            file.write(kinds[kind].read_text(encoding="utf-8").replace(f"{kind}.toml", str(target)))
    except FileExistsError:
        raise ValueError(f"new: {str(target)!r} is there already; name another file") from None
    except OSError as error:
        raise ValueError(f"new: {str(target)!r} cannot be written ({error.strerror})") from error
    print(f"{target}: change its variables, then `tipfem check {target}` and `tipfem run {target}`")


@refusing
def check(case: FilePath, /, *, set: Overrides = None, picture: FilePath | None = None, no_mesh: Flag = False) -> None:
    """Check a case file and its first mesh: all mistakes, or what a run will take.

    Args:
        case: The case file, in TOML.
        set: A value in place of that of the file: fluids.water.viscosity=2e-3. Can be given several times.
        picture: A PNG file for a picture of the initial state.
        no_mesh: Do not make the first mesh; Taichi is not started then.
    """
    from tipfem.casefile.estimate import estimate
    from tipfem.casefile.fills import cut_fills
    from tipfem.casefile.hints import hints, scales
    from tipfem.casefile.walls import wall_lines

    require_png(picture, "initial.png")
    if picture is not None and no_mesh:
        raise ValueError("--picture draws the first mesh, and --no-mesh makes none; leave out one of them")
    file, made = loaded(case, set)
    table = file.table
    print(f"{case}: no mistakes found")
    if made.title:
        print(f"title       {printable(made.title)}")
    properties = [f"{f.name} ({f.density:g} kg/m^3, {described_viscosity(f.viscosity)})" for f in made.fluids]
    print(f"fluids      {printable(', '.join(properties))}")
    extent = made.extent
    around = ", radius and height of an axisymmetric flow" if made.period.axial else ""
    size = f"{' x '.join(f'{edge:g}' for edge in extent)} m{around}"
    print(f"size        {size}, spacing {made.particles.spacing:g} m")
    print(f"scales      {scales(made)}")
    for each in LISTED:
        for line in each.lines(made):
            print(f"{each.title:<12}{printable(line)}")
    needed = estimate(made, file.end, table.time.largest_step, table.output.interval, file.fields)
    for line in [*wall_lines(made), *needed.lines()]:
        print(printable(line))
    for hint in [*cut_fills(made), *hints(made, file.end, table.output.interval, file.parts.probes)]:
        print(f"note: {printable(hint)}")
    simulation = None if no_mesh else file.simulation(case=made)  # which makes the first mesh
    if picture is not None and simulation is not None:
        draw_state(simulation, picture)
        print(f"picture     {picture}")


def draw_state(simulation: Simulation, path: Path) -> None:
    """Draw the present state of a simulation, in 3-D its densest fluid; `ValueError` if it cannot be written."""
    import imageio.v3 as imageio

    from tipfem.render import Volume, render_frame
    from tipfem.run.liveview.control import describe, snapshot_of
    from tipfem.run.liveview.source import Scenes

    state = snapshot_of(simulation, math.nan)
    drawn = Scenes(describe(simulation.case, None)).of(state)
    solid = isinstance(drawn, Volume)
    image = render_frame(
        drawn, mesh=not solid and len(state.position) < 5000, **({} if solid else {"backend": "raster"})
    )
    try:
        imageio.imwrite(path, image)
    except OSError as error:
        raise ValueError(f"the picture {str(path)!r} cannot be written ({error.strerror})") from error


@refusing
def info(out: FilePath, /) -> None:
    """Show the contents of a results folder: the run and its end, figures, versions and size on disk.

    Args:
        out: The results folder.
    """
    from tipfem.app.inspection import describe_results

    print(printable("\n".join(describe_results(out))))


@refusing
def convert(
    out: FilePath,
    /,
    *,
    precision: Literal["double", "single"] = "double",
    compression: Whole = 4,
    quantities: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
) -> None:
    """Write the states of a results folder into one VTKHDF file there, fields.vtkhdf, which ParaView opens.

    Args:
        out: The results folder.
        precision: Of the numbers: double, or single, which takes half the space.
        compression: Level of zlib, from 0 (none) to 9.
        quantities: Names of fields that are computed and written besides, as vorticity, shear_rate and viscosity.
    """
    from tipfem.results.reader import to_vtkhdf

    path = to_vtkhdf(out, precision=precision, compression=compression, quantities=quantities)
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


def doctor() -> int:
    """Check that all that tipfem needs is there, and print the command that brings what is missing."""
    from tipfem.app.inspection import examine

    findings = examine()
    for finding in findings:
        print(finding)
    return 1 if any(finding.needed and not finding.fine for finding in findings) else 0


def render(*arguments: Annotated[str, Parameter(allow_leading_hyphen=True)]) -> int:
    """Draw a results folder as pictures and a movie; `tipfem render --help` lists the options.

    Args:
        arguments: The results folder, and options of the drawing.
    """
    from tipfem.render import cli

    return int(cli.main(arguments))


@refusing
def share(
    out: FilePath,
    beside: FilePath | None = None,
    /,
    *,
    to: FilePath | None = None,
    field: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = ("speed",),
    states: Whole | None = None,
    address: str | None = None,
) -> None:
    """Write results as one HTML file, which any browser plays without tipfem and without a server.

    Args:
        out: The results folder, in 3-D for the surface of the densest fluid, without fields; or a study in 2-D, its
            file or folder, for a slider for each value.
        beside: Another one in 2-D, shown at the same times beside a border that can be moved.
        to: The file; share.html in the results folder by default.
        field: Fields that can be looked at besides the fluids: speed, pressure and others, or none. The first is shown
            at first; each adds some 0.5 to 1 kB per stored time.
        states: Most stored times of each run in 2-D, evenly chosen, for a smaller file; all by default.
        address: Of the page on the web, https://..., if it will have one: links to it then show a picture, which is
            written beside the file as PNG.
    """
    from tipfem.render.viewer.share import share as shared

    if out.suffix == ".toml":
        from tipfem.app.study.study import load_study

        out = load_study(out).folder
    path = shared(out, to, fields=[] if field == ("none",) else field, beside=beside, states=states, address=address)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


@refusing
def view(
    out: Path,
    compared: FilePath | None = None,
    /,
    *,
    port: Whole | None = None,
    no_browser: Flag = False,
    stored: Flag = False,
) -> None:
    """Look at a results folder in a browser, or steer the run that is writing into it; or compare two at equal times.

    Args:
        out: The results folder.
        compared: Another one, shown beside it.
        port: Of 127.0.0.1, where the page is served; by default 8800, or one of the next. 0 takes any.
        no_browser: Open no browser; the address is printed in either case.
        stored: Show the stored times of a run that is going on, and follow them, instead of its present state.
    """
    from tipfem.render.viewer import ResultsSource, serve
    from tipfem.run.liveview.process import guest_of, serve_guest

    def say(line: str) -> None:
        print(line, flush=True)

    if port is not None and not 0 <= port <= 65535:
        raise ValueError(f"--port is {port}; it must be from 0 to 65535")
    run = None if stored or compared is not None else guest_of(out)
    if run is not None:
        serve_guest(run, port, not no_browser, say)
    else:
        sources = [ResultsSource(folder) for folder in (out, compared) if folder is not None]
        serve(sources, port, not no_browser, say)


@refusing
def schema(*, out: FilePath | None = None) -> None:
    """Print the JSON schema of case files, by which editors complete and check them.

    Args:
        out: A file to write it to.
    """
    from tipfem.casefile.schema import json_schema

    text = json.dumps(json_schema(), indent=2) + "\n"
    if out is None:
        print(text, end="")
        return
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ValueError(f"--out is {str(out)!r}, which cannot be written to ({error.strerror})") from error


def main(words: Sequence[str] | None = None) -> int:
    """Run the commands of this module alone; returns the exit code."""
    app = App(name="tipfem", result_action="return_value")
    register(app)
    return call(app, words)


def call(app: App, words: Sequence[str] | None = None) -> int:
    """Run an application on words, by default the command line; bad command lines end with exit code 2, not 1."""
    from cyclopts import CycloptsError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CaseDoubt)  # those are printed as notes
            result = app(words, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        given = list(sys.argv[1:] if words is None else words)
        if given and given[0] in MEANT:
            print(f"the command for that is `tipfem {MEANT[given[0]]}`", file=sys.stderr)
        return 2
    return result if isinstance(result, int) else 0

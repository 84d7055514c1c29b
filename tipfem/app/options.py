"""Options of the command line: what commands share, and numbers that are taken as they are written or refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from tipfem.logs import LogLevel


def _taken(kind: Callable[[str], Any], what: str) -> Callable[[Any, Sequence[Any]], Any]:
    """Converter of values of the command line by a function; a text that it refuses is not ``what`` it takes."""

    def converted(_type: Any, tokens: Sequence[Any]) -> Any:
        text = tokens[0].value
        try:
            return kind(text)
        except ValueError:
            raise ValueError(f"{text!r} is not {what}") from None

    return converted


def _path(_type: Any, tokens: Sequence[Any]) -> Path:
    """A file or folder of the command line; an empty name, as of a variable that is not set, is not the folder here."""
    text = tokens[0].value
    if not text:
        raise ValueError("it is empty; it must be the name of a file or folder, such as out")
    return Path(text)


def printable(text: str) -> str:
    """A text for the terminal: control characters, which can be in names and titles, are shown by their codes."""
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode("ascii") for c in text)


def require_png(picture: Path | None, example: str) -> None:
    """`ValueError` unless the value of --picture, if there is one, names a PNG file, as ``example``."""
    if picture is not None and picture.suffix.lower() != ".png":
        raise ValueError(f"--picture is {str(picture)!r}; it must be the name of a PNG file, such as {example}")


FilePath = Annotated[Path, Parameter(converter=_path)]
Whole = Annotated[int, Parameter(converter=_taken(int, "a whole number"))]
# Commands check ranges of numbers, which exclude nan and infinity.
Number = Annotated[float, Parameter(converter=_taken(float, "a number, such as 0.5 or 2e-3"))]
Flag = Annotated[bool, Parameter(negative=(), show_default=False)]  # without a form that begins with --no-
Overrides = Annotated[list[str] | None, Parameter(name="--set", negative=())]
Arch = Literal["cpu", "cuda", "vulkan"]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Start:
    """Options for the start of a run, of `tipfem run` and `tipfem demo`.

    Args:
        out: Folder for the results; by default that of the case file, or out/ and its name.
        set: A value in place of that of the file: fluids.water.viscosity=2e-3. Can be given several times.
        threads: Number of CPU threads; by default as many as there are cores.
        arch: cpu; cuda or vulkan, by which a GPU gives the same.
        overwrite: Replace results that are in the folder.
        steering: The steering.jsonl of a run: its commands are repeated at the same steps.
    """

    out: FilePath | None = None
    set: Overrides = None
    threads: Whole | None = None
    arch: Arch = "cpu"
    overwrite: Flag = False
    steering: FilePath | None = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Shown:
    """Options for the display and the log of a run, of the commands that run.

    Args:
        progress: Show a progress bar on a terminal; elsewhere print a line every 10 s.
        view: Show the run in a browser while it goes on, and let it be steered from there.
        port: Of 127.0.0.1, where the page of --view is served; by default 8800, or one of the next. 0 takes any.
        no_browser: Open no browser for --view; the address is printed in either case.
        log_json: A file for the log, one JSON object a line, every step among them; it is continued if it is there.
        log_level: What is printed where there is no progress bar: debug, info, warning or error.
    """

    progress: bool = True
    view: Flag = False
    port: Whole | None = None
    no_browser: Flag = False
    log_json: FilePath | None = None
    log_level: LogLevel = "info"

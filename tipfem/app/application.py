"""The command `tipfem`, which is also `python -m tipfem`.

What a command needs is imported when it runs: its help needs no Taichi.
"""

from __future__ import annotations

import ast
import difflib
import importlib
import importlib.util
import warnings
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

import tipfem
from tipfem.app.commands import call, register
from tipfem.app.running import said
from tipfem.app.study.commands import register as register_study

app = App(
    name="tipfem",
    suppress_keyboard_interrupt=False,  # it is told
    help="Immiscible incompressible fluids, of any number, by the position-based Particle Finite Element Method.",
    version=tipfem.__version__,
)
register(app)
register_study(app)

# Patterns of the demos' paths, and the headings they are listed under; a run.py goes by the name of its folder.
SECTIONS = {"*.py": "Demos", "validation/*/run.py": "Validation", "benchmarks/*.py": "Benchmarks"}


def demo_folder() -> Path:
    """The folder in which the demos are installed; `SystemExit` if they are not."""
    found = importlib.util.find_spec("tipfem.demos")
    if found is None or not found.submodule_search_locations:
        raise SystemExit("error: the demos are not installed with this tipfem")
    return Path(next(iter(found.submodule_search_locations)))


def find_demos() -> dict[str, dict[str, Path]]:
    """The scripts that can be run, by the headings of `SECTIONS` and the names that `tipfem demo` takes."""
    root = demo_folder()
    return {
        heading: {
            path.relative_to(root).as_posix().removesuffix("/run.py").removesuffix(".py"): path
            for path in sorted(root.glob(pattern))
            if _is_script(path)
        }
        for pattern, heading in SECTIONS.items()
    }


def _is_script(path: Path) -> bool:
    return "\nif __name__ == " in path.read_text(encoding="utf-8")


def headline(path: Path) -> str:
    """The first sentence of a script's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split()).rstrip(".")


def list_demos() -> str:
    """All demos with a line each, under headings."""
    sections = find_demos()
    width = max(len(name) for scripts in sections.values() for name in scripts)
    lines = []
    for heading, scripts in sections.items():
        lines += [f"{heading}:", *(f"  {name:{width}}  {headline(path)}" for name, path in scripts.items()), ""]
    return "\n".join([*lines, "Run one by `tipfem demo NAME`; its options are listed by `tipfem demo NAME --help`."])


@app.command(help_flags=[], version_flags=[], help_epilogue="")
def demo(
    name: Annotated[str, Parameter(allow_leading_hyphen=True)] = "",
    /,
    *options: Annotated[str, Parameter(allow_leading_hyphen=True)],
) -> int:
    """Run a demo; without a name, list all demos.

    Args:
        name: Of the demo, such as dam_break or validation/walls.
        options: Of the demo, such as --spacing 0.01; `tipfem demo NAME --help` lists them.
    """
    if name in ("-h", "--help"):
        app.help_print(["demo"])
        return 0
    if name in ("", "list", "--list"):
        print(list_demos())
        return 0
    paths = dict(item for scripts in find_demos().values() for item in scripts.items())
    name = name.removesuffix(".py")
    path = paths.get(name)
    if path is None:
        close = difflib.get_close_matches(name, list(paths), 1)
        hint = f" did you mean {close[0]!r}?" if close else ""
        return said(2, f"error: there is no demo {name!r};{hint} `tipfem demo` lists all of them")
    module = ".".join(("tipfem.demos", *path.relative_to(demo_folder()).with_suffix("").parts))
    importlib.import_module(module)
    from tipfem.demos import harness

    return int(harness.command(module, options, f"tipfem demo {name}"))


def command() -> int:
    """Run the command line of the process; returns the exit code, see `tipfem.app.commands.EXIT_CODES`."""
    warnings.formatwarning = lambda message, *_, **__: f"warning: {message}\n"  # without a line of the source
    return call(app)

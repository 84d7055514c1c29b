"""Every code block of the documentation runs: Python page by page, commands as far as their files and options go."""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import shlex
import sys
from functools import lru_cache
from pathlib import Path

import pytest
from blocks import Block, blocks, run_page

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES += sorted((ROOT / "demos").rglob("*.md"))
PYTHON = [page for page in PAGES if any(block.language == "python" for block in blocks(page.read_text("utf-8")))]
# A quick run stands for the one that is shown.
SHORTER = {"README.md": {"spacing=0.005": "spacing=0.02", "until=0.4": "until=0.02"}}
# What pages show is what their code makes: files that it must leave.
MADE = {
    "docs/tutorial.md": ["strip.png", "frames_pressure_mesh/frame_0002.png", "front.png"],
    "docs/howto/pictures.md": ["last.png", "strip.png", "animation_speed_mesh.gif"],
    "docs/howto/results.md": ["history.csv", "fields.pvd", "summary.json", "case.json"],
}
SHELL = {"sh", "bash", "console"}
# Commands that this repository has no say in; what they are given is not looked at.
OTHERS = {"apt-get", "git", "cd", ".", "open", "dask"}


def name(page: Path) -> str:
    """The path from the root, for messages and the names of the tests."""
    return page.relative_to(ROOT).as_posix()


@pytest.mark.slow(
    only=(
        "docs/first-drop.md",
        "docs/howto/interface-rules.md",
        "docs/howto/openings.md",
        "docs/howto/pictures.md",
        "docs/howto/probes.md",
        "docs/howto/results.md",
        "docs/howto/shapes.md",
        "docs/tutorial.md",
    )
)
@pytest.mark.parametrize("page", PYTHON, ids=name)
def test_python_blocks_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    run_page(page, SHORTER.get(name(page)))
    for made in MADE.get(name(page), []):
        assert list(tmp_path.glob(f"out/*/{made}")), f"{name(page)} does not make {made}"


def commands(text: str) -> list[str]:
    """The commands of a page: lines of shell blocks and of indented blocks, and code in a line that begins like one."""
    found = []
    for block in blocks(text):
        if block.language in SHELL:
            found += block.code.replace("\\\n", " ").splitlines()
    rest = re.sub(r"^ *```.*?^ *```$", "", text, flags=re.MULTILINE | re.DOTALL)
    found += re.findall(r"^ {4}((?:python3?|make|pytest|pip|tipfem) .*)$", rest, re.MULTILINE)
    found += re.findall(r"`((?:python3?|make|pytest|pip|tipfem)(?: [^`]+))`", rest.replace("\n", " "))
    return [line.strip() for line in found if line.strip() and not line.strip().startswith("#")]


COMMANDS = sorted({(name(page), line) for page in PAGES for line in commands(page.read_text("utf-8"))})


@pytest.mark.parametrize(("page", "command"), COMMANDS)
def test_commands_name_what_is_there(page, command, monkeypatch):
    for part in re.split(r"&&|;", re.sub(r"\s#.*", "", command)):
        words = shlex.split(part)
        while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):  # VARIABLE=value before a command
            words = words[1:]
        problem = wrong_with(words, monkeypatch)
        assert problem is None, f"{page}: {command}: {problem}"


def wrong_with(words: list[str], monkeypatch: pytest.MonkeyPatch) -> str | None:
    """What a command names that is not there, or None."""
    if not words or words[0] in OTHERS:
        return None
    program, rest = words[0], words[1:]
    if program == "make":
        targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
        return next((f"no target {word}" for word in rest if "=" not in word and word not in targets), None)
    if program == "pip" or rest[:2] == ["-m", "pip"]:
        extras = re.findall(r"\[([a-z,]+)\]", " ".join(rest))
        known = (ROOT / "pyproject.toml").read_text("utf-8")
        return next((f"no extra {e}" for es in extras for e in es.split(",") if f"\n{e} = [" not in known), None)
    if program == "pytest" or rest[:2] == ["-m", "pytest"]:
        files = [word for word in rest if word.startswith("tests/")]
        return next((f"no {file}" for file in files if not (ROOT / file).exists()), None)
    if program == "tipfem":
        return wrong_with_options(["-m", *words], monkeypatch)
    if program in ("python", "python3", ".venv/bin/python"):
        if rest[:1] == ["-V"] or rest[:2] in (["-m", "venv"], ["-m", "http.server"]):
            return None
        return wrong_with_options(rest, monkeypatch)
    if program.startswith("."):
        return None if (ROOT / program).exists() else f"no {program}"
    return f"{program} is no command that this test knows"


def wrong_with_options(rest: list[str], monkeypatch: pytest.MonkeyPatch) -> str | None:
    """Which option a Python program does not have, by its own --help; or None."""
    module = rest[0] == "-m"
    program = rest[1] if module else rest[0]
    rest = rest[2:] if module else rest[1:]
    if not module and not (ROOT / program).is_file():
        return f"no {program}"
    if (program, module) == ("tipfem", True):  # a command of its own, and for `demo` the name of one
        words = tuple(word for word in rest[: 1 + (rest[:1] == ["demo"])] if not word.startswith("-"))
    else:
        words = ()
    options = [word.split("=")[0] for word in rest if re.match(r"--?[a-z]", word)]
    if not options and not words:
        return None
    text = help_of(program, module, words)
    return next((f"no option {option}" for option in options if not re.search(rf"{option}\b", text)), None)


@lru_cache
def help_of(program: str, module: bool, words: tuple[str, ...]) -> str:
    """What a program says to --help."""
    argv, text, path = sys.argv, io.StringIO(), list(sys.path)
    sys.argv = [program, *words, "--help"]
    status: object = "it does not stop"
    try:
        with contextlib.redirect_stdout(text):
            if module:
                runpy.run_module(program, run_name="__main__", alter_sys=True)
            else:
                sys.path.insert(0, str((ROOT / program).parent))  # as Python does for a script
                runpy.run_path(str(ROOT / program), run_name="__main__")
    except SystemExit as stopped:
        status = stopped.code
    finally:
        sys.argv, sys.path[:] = argv, path
    assert not status, f"{program} {' '.join(words)} --help: {status}"
    return text.getvalue()


def test_the_checks_see_what_they_should(monkeypatch, tmp_path):
    """A command with a wrong option or file, a block that fails."""
    assert "no option" in str(wrong_with(shlex.split("python -m tipfem.render out --meshes"), monkeypatch))
    assert wrong_with(shlex.split("python -m tipfem.render out --mesh"), monkeypatch) is None
    assert "no demos" in str(wrong_with(["python", "demos/nothing.py"], monkeypatch))
    assert "no target" in str(wrong_with(["make", "coffee"], monkeypatch))
    page = tmp_path / "page.md"
    page.write_text("text\n\n```python\nx = 1\n```\n\n```python\nassert x == 2\n```\n")
    with pytest.raises(AssertionError) as failure:
        run_page(page)
    assert failure.traceback[-1].lineno == 7  # counted from zero
    assert blocks(page.read_text())[1] == Block("python", "assert x == 2\n", 8)

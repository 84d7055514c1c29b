"""Demos run as their users run them."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from tipfem.demos.harness import Prepared

from tipfem.app import application as commands

DEMOS = Path(__file__).resolve().parents[1] / "demos"


def python(*words: str | Path) -> subprocess.CompletedProcess[str]:
    """A process of Python with these arguments, which has ended."""
    return subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, check=False)


def typed(script: str, out: Path, *words: str) -> dict:
    """summary.json of a script in demos/ that was run in a process of its own; it must pass its check."""
    done = python(DEMOS / script, "--out", out, *words)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "check: passed" in done.stdout
    assert str(out) in done.stdout
    return json.loads((out / "summary.json").read_text())


def called(name: str, out: Path, *words: str, code: int = 0) -> dict:
    """summary.json of a demo that was run in this process by the function behind `tipfem demo`.

    Args:
        name: of the demo.
        out: folder for the results.
        words: further words of the command line.
        code: the exit code that it must have; 1 where it misses its check.
    """
    assert commands.demo(name, "--out", str(out), *words) == code
    return json.loads((out / "summary.json").read_text())


def load(name: str, **settings: Any) -> Prepared:
    """A demo with values for its options, which does not run."""
    return import_module(f"tipfem.demos.{name}").main.prepared(**settings)

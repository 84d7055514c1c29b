"""The command on a terminal that ends it, and with an output that is closed, full, or takes no control characters."""

from __future__ import annotations

import fcntl
import os
import re
import signal
import struct
import subprocess
import sys
import termios
import time
from contextlib import suppress

import pytest

from tipfem.app.options import printable

CASE = """
title = "a \\u001b[31mred title\\u0007"
gravity = [0, -9.81]
free_surface = true
fluids.water = { density = 998.2, viscosity = 1e-3 }
tank = { size = [0.5, 0.3], spacing = 0.05 }
fill = [{ fluid = "water", box = [[0, 0], [0.5, 0.15]] }]
time = { end = 0.004 }
"""


@pytest.fixture
def folder(tmp_path):
    """A folder with a case file."""
    (tmp_path / "case.toml").write_text(CASE)
    return tmp_path


def shell(folder, words, **options):
    """The command in a shell, where its output can be led elsewhere."""
    line = f"{sys.executable} -m tipfem {words}"
    return subprocess.run(["sh", "-c", line], cwd=folder, capture_output=True, text=True, check=False, **options)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", ["run case.toml --threads 1 --no-progress", "demo", "schema", "check case.toml --no-mesh", "--help"]
)
def test_an_output_that_is_closed_or_full_ends_in_a_line(folder, words):
    closed = shell(folder, f"{words} >&-")
    assert closed.returncode == 0
    full = shell(folder, f"{words}{' --overwrite' if 'run' in words else ''} >/dev/full")
    assert full.returncode == 1
    assert full.stderr.splitlines()[-1] == "error: the output cannot be written: No space left on device"
    for said in (closed, full):
        assert "Traceback" not in said.stderr
        assert "Exception" not in said.stderr
    if "run" in words:
        assert '"status": "complete"' in (folder / "out" / "case" / "summary.json").read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", ["demo", "doctor", "check case.toml", "check none.toml", "run case.toml --steering none"]
)
def test_lines_are_broken_between_words_at_the_width_of_the_terminal(folder, words):
    """80 columns: no line is longer unless it is one word; the text is that of a pipe; errors have a colour."""
    plain = shell(folder, words)
    leader, follower = os.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    line = [sys.executable, "-m", "tipfem", *words.split()]
    environment = {key: value for key, value in os.environ.items() if key not in ("COLUMNS", "NO_COLOR")}
    process = subprocess.Popen(
        line, cwd=folder, stdin=follower, stdout=follower, stderr=follower, env=environment | {"TERM": "xterm"}
    )
    os.close(follower)
    seen = b""
    with suppress(OSError):  # the other end has closed
        while part := os.read(leader, 4096):
            seen += part
    os.close(leader)
    assert process.wait() == plain.returncode
    text = seen.decode().replace("\r\n", "\n")
    begins = any(row.startswith("error:") for row in plain.stderr.splitlines())
    assert ("\x1b[31merror:\x1b[0m" in text) == begins
    shown = re.sub(r"\x1b\[\d+m", "", text)
    assert all(len(row) <= 80 or len(row.split()) == 1 for row in shown.splitlines())
    if words != "doctor":  # which looks at the terminal
        assert shown.split() == (plain.stdout + plain.stderr).split()


def test_a_notebook_shows_no_line_of_taichi():
    """Where the standard output is another one than that of the process, as in notebooks."""
    code = "import io, sys; sys.stdout = io.StringIO(); import tipfem as tp; tp.init()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.slow
def test_a_reader_that_has_seen_enough_ends_the_command_without_a_word(folder):
    found = shell(folder, "schema | head -1")
    assert (found.stdout, found.stderr) == ("{\n", "")


@pytest.mark.slow
def test_control_characters_of_names_reach_no_terminal(folder):
    shell(folder, "run case.toml --threads 1 --no-progress --out kept")
    for words in ("check case.toml --no-mesh", "info kept", "info 'a\x1b[2Jb'", "run case.toml --set 'title=\"\x07\"'"):
        found = shell(folder, words)
        assert not {"\x1b", "\x07"} & set(found.stdout + found.stderr), words
    assert "a \\x1b[31mred title\\x07" in shell(folder, "info kept").stdout
    assert printable("water\n\tµ \udcff\x9b") == "water\n\tµ \\udcff\\x9b"


@pytest.mark.slow
def test_names_that_are_no_text_are_written_to_and_shown(folder):
    name = os.fsdecode(b"a\xff")
    done = subprocess.run(
        [sys.executable, "-m", "tipfem", "run", "case.toml", "--out", name, "--threads", "1", "--no-progress"],
        cwd=folder,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert b"results: a\\udcff" in done.stdout


@pytest.mark.slow(but=("check ''",))
@pytest.mark.parametrize(
    "words",
    [
        "run case.toml --out ''",
        "run ''",
        "check ''",
        "check case.toml --picture ''",
        "info ''",
        "share ''",
        "resume ''",
    ],
)
def test_an_empty_name_is_not_the_folder_here(folder, words):
    found = shell(folder, words)
    assert found.returncode == 2
    assert "it is empty; it must be the name of a file or folder" in found.stderr
    assert [path.name for path in folder.iterdir()] == ["case.toml"]


# A process that is started in the background ignores SIGINT; one on a terminal has Python's own handler.
ON_A_TERMINAL = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.argv[0] = "tipfem"
from tipfem.app.main import main
print("begun", flush=True)
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.0, 0.1, 0.2, 0.4, 0.6, 0.8])
def test_ctrl_c_while_it_starts_ends_it_in_a_word(folder, part):
    words = [sys.executable, "-X", "faulthandler", "-c", ON_A_TERMINAL, "check", "case.toml"]
    begun = time.monotonic()
    subprocess.run(words, cwd=folder, stdout=subprocess.DEVNULL, check=True)
    whole = time.monotonic() - begun
    process = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.readline()
    time.sleep(part * whole)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=100)
    assert "Traceback" not in said
    assert (process.returncode, said) in ((130, "interrupted\n"), (0, ""))

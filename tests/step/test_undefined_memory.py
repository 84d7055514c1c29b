"""Results do not depend on what is in memory where values are undefined."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


def digests(seed: int) -> dict[str, str]:
    """Digests of the runs of `garbage`, in a process of its own."""
    command = [sys.executable, str(Path(__file__).with_name("garbage.py")), str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_runs_do_not_read_what_nobody_wrote():
    expected = digests(0)
    for seed in (1, 2, 3):
        assert digests(seed) == expected

"""What a step allocates, launches and hands to and fro, counted without a clock: limits that only fall."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from ledger import Allocations

# Of a step of the dam break in `ledger`: lines that allocate a byte a particle or more, and all bytes a particle they
# allocate; kernels on the host, which may take the place of such lines; arrays of NumPy that kernels are given beside
# device arrays, each of which a GPU would be sent and would send back, but for the period's; what goes to device arrays
# and comes from them, with bytes a particle; on Vulkan, how often the host waits.
LIMITS = {
    "cpu": {
        "lines": 12,  # two of them for the text of a kernel, once
        "bytes": 25,
        "kernels on the host": 71,
        "kernels on the device": 73,
        "arrays of NumPy on the device": 20,
        "arrays up": 37,
        "bytes up": 149,
        "arrays down": 23,
        "bytes down": 36,
        "preparations": 0,
    },
    "vulkan": {
        "kernels on the host": 71,
        "kernels on the device": 104,  # iterations are queued ahead, and some do nothing
        "arrays of NumPy on the device": 0,
        "arrays up": 39,
        "bytes up": 204,
        "copies up": 3,
        "waits": 6,
        "arrays down": 16,
        "bytes down": 55,
        "preparations": 0,
    },
}


def ledger(arch, seed):
    """The figures of a step, in a process of its own."""
    command, environment = [sys.executable, str(Path(__file__).with_name("ledger.py")), arch], {"PYTHONHASHSEED": seed}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **environment})
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


def require_no_more(arch, figures, lines):
    """Compare with the limits; ``lines`` says where bytes are allocated."""
    assert figures["newton_iterations"] <= 2
    found = {name: figures.get(name, 0) for name in LIMITS[arch]}
    assert all(found[name] <= most for name, most in LIMITS[arch].items()), f"{found}, limits {LIMITS[arch]}\n{lines}"


@pytest.mark.slow
def test_a_step_costs_no_more_than_it_did_and_the_same_at_every_run():
    one, other = (ledger("cpu", seed) for seed in ("1", "2"))
    assert one[0] == other[0]
    require_no_more("cpu", *one)


@pytest.mark.vulkan
@pytest.mark.slow
def test_a_step_costs_no_more_than_it_did_on_vulkan():
    done = subprocess.run([sys.executable, "-c", "import tipfem as tp; tp.init('vulkan')"], check=False)
    if done.returncode:
        assert os.environ.get("TIPFEM_REQUIRE_VULKAN") != "1"
        pytest.skip("no Vulkan driver")
    require_no_more("vulkan", *ledger("vulkan", "1"))


def test_one_more_copy_of_positions_is_seen():
    position = np.ones((20_000, 2))

    def step(more):
        speed = np.sqrt(position[:, 0])
        return (position.copy() if more else position)[0, 0] + speed[0]

    found = []
    for more in (False, True):
        found.append(Allocations(len(position)))
        found[-1].of(lambda more=more: step(more))
    assert [len(each.lines) for each in found] == [1, 2]
    assert [sum(each.lines.values()) for each in found] == [8, 24]

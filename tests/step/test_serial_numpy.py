"""What NumPy does in a step is done by one thread: those of BLAS would keep cores busy that kernels want."""

import os
import sys
from pathlib import Path
from subprocess import run

import pytest

CASES = Path(__file__).parents[2] / "demos" / "cases"
CODE = """
import sys, time
import tipfem as tp
tp.init(threads=1)
simulation = tp.load_case(sys.argv[1], sys.argv[2:]).simulation()
for _ in range(2):
    simulation.step()
used, own = time.process_time(), time.thread_time()
for _ in range(5):
    simulation.step()
print(len(simulation.mesh.cells), (time.process_time() - used) / (time.thread_time() - own))
"""


@pytest.mark.slow
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="BLAS has one thread here")
@pytest.mark.parametrize("case", ["floating", "dam_break"])
def test_no_other_thread_works_in_a_step(case):
    """With more than 10 000 cells, as many as OpenBLAS shares a scalar product of."""
    spacing = {"floating": 0.0105, "dam_break": 0.007}[case]
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", CODE, str(CASES / f"{case}.toml"), f"tank.spacing={spacing}"]
    done = run(command, capture_output=True, text=True, check=True, env=environment)
    cells, ratio = map(float, done.stdout.split()[-2:])
    assert cells > 10_000
    assert ratio < 1.1

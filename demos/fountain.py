"""Fountain: a jet of water rises from a nozzle in the floor of a closed tank, and the air leaves by a vent.

    tipfem demo fountain --spacing 0.01 --until 1

The volumes of water and air follow what has passed the nozzle and the vent to round-off, which the check holds. The
case is demos/cases/fountain.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness
from tipfem.demos.support.passing import Balance

main = harness.Demo("fountain.toml", check=Balance(), strip=(0.1, 0.3, 0.6, 1.0))

if __name__ == "__main__":
    harness.command(__name__)

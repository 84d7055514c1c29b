"""A drop of water falls into a pool, in two dimensions: a crown and a crater, shaped by surface tension.

    tipfem demo splash --spacing 0.0003

The check holds that the fluids keep their volumes, that all energy together never rises, and that the crater is open,
and not larger than the drop's energy allows. The case is demos/cases/splash.toml; `tipfem run` runs it without check.
"""

from tipfem.demos import harness
from tipfem.demos.support.splashing import Crater

main = harness.Demo("splash.toml", check=Crater, strip=(0.0, 0.0006, 0.0012, 0.0024, 0.0036, 0.006, 0.009, 0.0135))

if __name__ == "__main__":
    harness.command(__name__)

"""A bubble of air bursts at the surface of water, in two dimensions: a film breaks, and a jet rises.

    tipfem demo bursting_bubble --spacing 0.0002

The check holds that the fluids keep their volumes, that all energy together never rises, that the bubble is gone once
a film has broken, and that the ends of the film run as Taylor and Culick have it. The case is
demos/cases/bursting_bubble.toml; `tipfem run` runs it without check.
"""

from tipfem.demos import harness
from tipfem.demos.support.splashing import Burst

main = harness.Demo("bursting_bubble.toml", check=Burst, strip=(0.0, 0.01, 0.02, 0.0225, 0.02325, 0.025, 0.0275, 0.035))

if __name__ == "__main__":
    harness.command(__name__)

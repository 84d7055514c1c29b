"""Pictures and movies of two-phase flow results.

`animate` turns a results folder into PNG frames and a movie, `strip` some of its times into one picture;
`render_frame` draws one `Scene`, built from a results folder by `Results` or from plain arrays. The package reads
results and never imports the solver.
"""

from .animation import Animation, animate
from .renderer import Renderer, render_frame
from .results import Results, ResultsError
from .scene import Scene
from .strips import strip
from .vector import draw_vectors
from .view import View
from .volume import Volume

__all__ = [
    "Animation",
    "Renderer",
    "Results",
    "ResultsError",
    "Scene",
    "View",
    "Volume",
    "animate",
    "draw_vectors",
    "render_frame",
    "strip",
]

"""A viewer of results and of running simulations, in a browser or a notebook.

The viewer draws with `tipfem.render`, serves a page to this machine alone, and never imports the solver: what it shows
is a `Source`, such as the stored times of a results folder.
"""

from .server import serve
from .source import ResultsSource, Source

__all__ = ["ResultsSource", "Source", "serve"]

"""A figure of lines over a common axis, as the demos leave it in their results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from numpy.typing import ArrayLike

# Okabe and Ito's colours, distinct under colour blindness; dashes tell the series apart too.
STYLES = [("#000000", "--"), ("#0072B2", "-"), ("#D55E00", "-."), ("#CC79A7", ":")]


def plot_lines(
    path: str | Path, series: Mapping[str, tuple[ArrayLike, ArrayLike]], x_label: str, y_label: str, *, title: str = ""
) -> Path:
    """Draw series, label -> (x (K,), y (K,)), and return the picture's path; its ending is the format.

    Raises ImportError without matplotlib. Opens no window.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("plot_lines needs matplotlib; it comes with the extra tipfem[plot]") from error
    figure = Figure(figsize=(8.0, 5.0), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)  # draws into memory, whatever the user's backend
    axes = figure.add_subplot()
    for number, (label, (x, y)) in enumerate(series.items()):
        colour, dash = STYLES[number % len(STYLES)]
        axes.plot(x, y, color=colour, linestyle=dash, linewidth=2.0, label=label)
    axes.set_title(title, fontsize=15)
    axes.set_xlabel(x_label, fontsize=14)
    axes.set_ylabel(y_label, fontsize=14)
    axes.tick_params(labelsize=12)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=11)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return Path(path)

"""Figures of the demos: one that draws into memory whatever the user's back end is, and lines over a common axis."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, distinct under colour blindness; dashes and markers tell the series apart too.
BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE)
DASHES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D")
Curves = tuple[str, dict[str, tuple[ArrayLike, ArrayLike]]]  # label of values, and times and values by name
EXACT = ("theory", "reference", "plane")  # curves in black dashes
LINES = [("#000000", "--"), (BLUE, "-"), (VERMILION, "-."), (PURPLE, ":")]


def new_figure(width: float, height: float, *, dpi: int = 150) -> Figure:
    """An empty figure of a width and height [inches]. Opens no window.

    Raises:
        ImportError: there is no matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("the figure needs matplotlib; it comes with the extra tipfem[plot]") from error
    figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure to a file, whose ending is the format; make its folder. Returns the path."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def with_legend(axes: Axes) -> None:
    """Add a grid, and a legend where lines have labels."""
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7)


def table(figures: Mapping[str, Mapping[str, float]]) -> str:
    """The figures of several runs as a table in Markdown, a row each."""
    lines = ["| run | figures |", "|---|---|"]
    lines += [f"| {name} | {', '.join(f'{k} {v:.3g}' for k, v in row.items())} |" for name, row in figures.items()]
    return "\n".join(lines) + "\n"


def plot_flows(path: Path, curves: Mapping[str, Curves]) -> None:
    """Draw the curves of several flows, side by side.

    Raises:
        ImportError: there is no matplotlib.
    """
    across, rows = (len(curves), 1) if len(curves) < 4 else (-(-len(curves) // 2), 2)
    figure = new_figure(3.0 * across, 3.0 * rows)
    for number, (flow, (label, lines)) in enumerate(curves.items(), 1):
        axes = figure.add_subplot(rows, across, number)
        for (name, (time, values)), colour in zip(lines.items(), COLOURS, strict=False):
            style = {"color": "black", "linestyle": "--"} if name in EXACT else {"color": colour}
            axes.plot(time, values, linewidth=1.2, label=name, **style)
        axes.set_xlabel("t [s]")
        axes.set_ylabel(label)
        axes.set_title(flow, fontsize=9)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    save(figure, path)


def plot_differences(path: Path, found: Mapping[str, tuple[float, float]]) -> None:
    """Draw what figures differ by from their references, and what they may differ by [%], a line each.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(7.0, 0.6 + 0.3 * len(found))
    axes = figure.add_subplot()
    differences, allowed = zip(*found.values(), strict=True)
    axes.barh(list(found), [2 * value for value in allowed], left=[-value for value in allowed], color=SKY, alpha=0.35)
    axes.plot(differences, list(found), "o", color=BLUE)
    axes.axvline(0, color="black", linewidth=0.8)
    axes.invert_yaxis()
    axes.set_xlabel("difference from the reference, and what is allowed [%]")
    axes.grid(alpha=0.3, axis="x")
    save(figure, path)


def plot_lines(
    path: str | Path, series: Mapping[str, tuple[ArrayLike, ArrayLike]], x_label: str, y_label: str, *, title: str = ""
) -> Path:
    """Draw lines over a common axis.

    Args:
        path: of the picture; its ending is the format.
        series: label -> (x (K,), y (K,)).
        x_label: of the axis.
        y_label: of the axis.
        title: above the figure.

    Returns:
        The picture's path.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(8.0, 5.0)
    axes = figure.add_subplot()
    for number, (label, (x, y)) in enumerate(series.items()):
        colour, dash = LINES[number % len(LINES)]
        axes.plot(x, y, color=colour, linestyle=dash, linewidth=2.0, label=label)
    axes.set_title(title, fontsize=15)
    axes.set_xlabel(x_label, fontsize=14)
    axes.set_ylabel(y_label, fontsize=14)
    axes.tick_params(labelsize=12)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=11)
    return save(figure, path)

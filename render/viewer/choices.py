"""Choices that the pages of a viewer share."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Mapping
from typing import Any

from tipfem.render import View
from tipfem.render.scales import MUTED_FIELD
from tipfem.render.viewer.protocol import LAYERS

Window = tuple[float, float, float, float]
_MARGIN = 0.035  # of the domain, kept free around it when all of it is shown
_SMALLEST_WINDOW = 1e-6  # of the domain's width
_LARGEST_WINDOW = 50.0


@dataclasses.dataclass
class Choices:
    """Choice of view, and its size."""

    lower: tuple[float, ...]  # (d,) lower corner of the domains [m]
    upper: tuple[float, ...]  # (d,) upper corner of the domains [m]
    camera: tuple[float, float] | None = None  # azimuth and elevation of one in 3-D [degrees]; None in 2-D
    field: str | None = None  # name of the field that colours, or None for the fluids
    range_mode: str = "fixed"  # of its colours: "fixed", "frame" or "given"
    given: tuple[float, float] = (0.0, 1.0)  # (low, high) for "given"
    colour_map: str | None = None  # name, or None for the usual one of the field
    # what is drawn besides, by the names of `protocol.LAYERS`
    layers: dict[str, Any] = dataclasses.field(
        default_factory=lambda: {
            **dict.fromkeys(LAYERS, False),
            **{"fill": True, "contours": None, "tracers": 0, "smooth": True},
        }
    )
    window: Window | None = None  # the part shown [m], or None for all of it
    follow: str | None = None  # what the window follows, as in `View.follow`, or None
    width: int = 960  # of a picture [CSS px]
    height: int = 600  # of it [CSS px]
    dark: bool = False  # whether to draw on a dark background

    @property
    def plain(self) -> bool:
        """Whether nothing is seen that follows the mesh, so that outlines may be smoothed."""
        layers = self.layers
        beside = self.field is not None or any(layers[name] for name in ("mesh", "particles", "contours"))
        return bool(layers["fill"]) and not beside

    @property
    def bare(self) -> bool:
        """Whether nothing but the fluids is seen, for which their outlines do."""
        beside = self.follow or any(self.layers[name] for name in ("arrows", "streamlines", "tracers"))
        return self.plain and not beside

    @property
    def smooth(self) -> bool:
        """Whether the outlines of the fluids are smoothed."""
        return self.plain and bool(self.layers["smooth"])

    @property
    def shown(self) -> Window:
        """The part shown [m], of the shape of the picture."""
        if self.window is not None:
            x0, y0, x1, y1 = self.window
        else:
            (x0, y0), (x1, y1) = self.lower[:2], self.upper[:2]
            margin = _MARGIN * max(x1 - x0, y1 - y0)
            x0, y0, x1, y1 = x0 - margin, y0 - margin, x1 + margin, y1 + margin
        scale = min(self.width / (x1 - x0), self.height / (y1 - y0))
        x, y, half_width, half_height = (x0 + x1) / 2, (y0 + y1) / 2, self.width / scale / 2, self.height / scale / 2
        return x - half_width, y - half_height, x + half_width, y + half_height

    def show(self, window: Window | None) -> None:
        """Show a part of the domain [m], or all of it; `ValueError` if it is too small or too large."""
        if window is not None:
            share = (window[2] - window[0]) / (self.upper[0] - self.lower[0])
            if not _SMALLEST_WINDOW <= share <= _LARGEST_WINDOW:
                raise ValueError(
                    f"window: {share:.3g} times as wide as the domain, expected {_SMALLEST_WINDOW:g} to "
                    f"{_LARGEST_WINDOW:g} times"
                )
        self.window = window

    def view(self, framed: bool = False) -> View:
        """View that `tipfem.render` is to draw; ``framed`` with axes, all of the domain needs no window."""
        layers = self.layers
        return View(
            window=self.window if framed or self.follow else self.shown,
            follow=self.follow,
            fill=layers["fill"],
            arrows=layers["arrows"],
            streamlines=layers["streamlines"],
            contours=layers["contours"],
            tracers=layers["tracers"],
            colour_map=self.colour_map,
            muted=() if layers["colour_all"] else None,
            smooth=self.smooth,
        )

    def command(self, out: str) -> str:
        """The command that draws a results folder in this manner."""
        words = ["tipfem render", shlex.quote(out)]
        if self.camera is not None:
            words += [f"--azimuth {self.camera[0]:.4g}", f"--elevation {self.camera[1]:.4g}"]
        if self.field is not None:
            words += ["--field", shlex.quote(self.field)]
            if self.range_mode == "given":
                words += ["--range", *(f"{value:g}" for value in self.given)]
            if self.colour_map is not None:
                words += ["--colour-map", self.colour_map]
        words += [f"--{name}" for name in ("mesh", "particles", "arrows", "streamlines") if self.layers[name]]
        if not self.layers["fill"]:
            words.append("--no-fill")
        if self.layers["contours"]:
            words += ["--contours", shlex.quote(self.layers["contours"])]
        if self.layers["tracers"]:
            words += ["--tracers", str(self.layers["tracers"])]
        if self.window is not None:
            words += ["--window", *(f"{value:.4g}" for value in self.window)]
        if self.follow is not None:
            words += ["--follow", shlex.quote(self.follow)]
        if self.plain and not self.layers["smooth"]:
            words += ["--outlines", "mesh"]
        if self.layers["colour_all"] and MUTED_FIELD in (self.field, self.layers["contours"]):
            words.append("--colour-all")
        return " ".join(words)

    def report(self) -> Mapping[str, Any]:
        """Choices as pages receive them."""
        return {
            "field": self.field,
            "range": {"mode": self.range_mode, "low": self.given[0], "high": self.given[1]},
            "map": self.colour_map,
            "layers": dict(self.layers),
            "plain": self.plain,
            "window": self.window,
            "follow": self.follow,
            "size": [self.width, self.height],
            "camera": self.camera,
        }

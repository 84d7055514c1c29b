"""The pictures of every demo, of a run of a few steps: frames, movie, and as many times side by side as by default."""

from __future__ import annotations

import importlib

import imageio.v3 as iio
import numpy as np
import pytest
from demo_runs import called
from tipfem.render import cli

from tipfem.app import application as commands

SPACINGS = {
    "bursting_bubble": 0.0005,
    "dam_break": 0.04,
    "dam_break_3d": 0.2,
    "dam_break_free_surface": 0.04,
    "dam_break_container": 0.11,
    "dam_break_gate": 0.05,
    "floating": 0.03,
    "fountain": 0.025,
    "hydraulic_jump": 0.02,
    "jet": 0.0002,
    "layer_inversion": 0.01,
    "layers_at_rest": 0.01,
    "obstacle": 0.02,
    "mud_slump": 0.0125,
    "oil_on_water": 0.04,
    "resting_box": 0.04,
    "rising_bubble": 0.0026,
    "rising_bubble_3d": 0.2,
    "sinking_drop": 0.005,
    "sloshing": 0.05,
    "sloshing_3d": 0.15,
    "sluice_gate": 0.0125,
    "splash": 0.0005,
    "splash_3d": 0.15,
    "splash_round": 0.001,
}


def test_no_demo_is_left_out():
    assert {*SPACINGS, "play"} == set(commands.find_demos()["Demos"])


@pytest.mark.slow(but=("sloshing",))
@pytest.mark.parametrize("name", SPACINGS)
def test_a_demo_is_drawn(name, tmp_path):
    words = ["--spacing", str(SPACINGS[name]), "--end-time", "0.004", "--time-step", "0.001"]
    called(name, tmp_path, *words, "--frames-per-second", "1000", "--no-frames")
    strip = np.linspace(0.0, 0.004, min(len(importlib.import_module(f"tipfem.demos.{name}").main.strip), 5))
    options = ["--strip", *map(str, strip)] if len(strip) else []
    assert cli.main([str(tmp_path), *options, "--backend", "raster"]) == 0
    assert len(list((tmp_path / "frames").glob("*.png"))) == 5
    assert len(iio.imread(tmp_path / "animation.mp4")) == 5
    assert not options or iio.imread(tmp_path / "strip.png").std() > 5


def test_a_strip_that_does_not_fit_costs_no_other_picture_and_a_movie_has_the_name_given(tmp_path, capsys):
    called("dam_break", tmp_path, "--spacing", "0.04", "--end-time", "0.001", "--no-frames")  # one step: no front
    assert (
        cli.main([str(tmp_path), "--strip", "9", "--size", "320x320", "--movie", "a.mp4", "--backend", "raster"]) == 2
    )
    assert "\nerror: times of a strip are [9.0] s; 9 s is not among" in capsys.readouterr().err
    assert iio.imread(tmp_path / "frames_320x320" / "frame_0000.png").shape == (320, 320, 3)
    assert (tmp_path / "a.mp4").stat().st_size > 0
    assert not list(tmp_path.glob("a_*"))

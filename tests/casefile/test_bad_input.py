"""Every mistake ends in one clear error that names place, value and what would be right, before any time is spent."""

import re

import numpy as np
import pytest

from tipfem.app.commands import main
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError

GOOD = """\
title = "Two layers"
gravity = [0, -9.81]
interface = "sharp"

[fluids.water]
density = 998.2
viscosity = 1.002e-3

[fluids.air]
density = 1.204
viscosity = 1.825e-5

[tank]
size = [0.3, 0.2]
spacing = 0.02

[[fill]]
fluid = "air"

[[fill]]
fluid = "water"
box = [[0, 0], [0.3, 0.1]]

[walls.top]
velocity = [1, 0]

[grading]
largest = { air = 0.04 }

[numerics]
largest_move = 0.5

[time]
end = 1.0
largest_step = 1e-3

[output]
interval = 0.1

[[probes]]
type = "wave gauge"
name = "gauge"
x = 0.15
fluid = "water"

[checkpoint]
interval = 0.2
"""
MOTION = "[tank_motion]\nangle = { form = "

# What is replaced in the file, by what, the key that the error names, and further words that it must have.
MISTAKES = {
    "negative density": ("998.2", "-998.2", "fluids.water.density", "-998.2 kg/m^3", "> 0"),
    "density as text": ("998.2", '"998.2"', "fluids.water.density", "'998.2'", "a number > 0"),
    "density as truth value": ("998.2", "true", "fluids.water.density", "is true", "a number"),
    "infinite density": ("998.2", "inf", "fluids.water.density", "inf", "a number > 0 in kg/m^3"),
    "density that is no number": ("998.2", "nan", "fluids.water.density", "nan", "a number"),
    "negative viscosity": ("1.825e-5", "-1", "fluids.air.viscosity", "-1 Pa s", ">= 0"),
    "fluid without viscosity": ("viscosity = 1.825e-5", "", "fluids.air.viscosity", "missing", "Pa s"),
    "misspelt viscosity": ("1.825e-5", "1.8e-5\nviscosty = 1", "fluids.air.viscosty", "did you mean 'viscosity'?"),
    "fluids in a list": ("[fluids.air]", "[[fluids.air]]", "fluids.air", "a table"),
    "misspelt title": ("title =", "titel =", "titel", "did you mean 'title'?"),
    "key in the wrong place": ("title =", "spacing = 1\ntitle =", "spacing", "there is one in tank"),
    "title as number": ('"Two layers"', "3", "title", "is 3", "a text in quotes"),
    "three accelerations in 2-D": ("[0, -9.81]", "[0, 0, -9.81]", "gravity", "[0.0, 0.0, -9.81] m/s^2", "2 numbers"),
    "one acceleration": ("[0, -9.81]", "-9.81", "gravity", "-9.81 m/s^2", "a list of 2 or 3 numbers in m/s^2"),
    "accelerations as texts": ("[0, -9.81]", '[0, "g"]', "gravity", "[0, 'g']", "a list of 2 or 3 numbers"),
    "no gravity": ("gravity = [0, -9.81]", "", "gravity", "missing", "m/s^2"),
    "unknown interface": ('"sharp"', '"shrap"', "interface", "'shrap'", "did you mean 'sharp'?"),
    "grading with the interpolated interface": ('"sharp"', '"interpolated"', "grading", "it needs 'sharp'"),
    "free surface as text": ('interface = "sharp"', 'free_surface = "no"', "free_surface", "'no'", "true or false"),
    "tank without spacing": ("spacing = 0.02", "", "tank.spacing", "missing", "a number > 0 in m"),
    "spacing zero": ("spacing = 0.02", "spacing = 0", "tank.spacing", "is 0 m", "> 0"),
    "spacing far too small": (
        "spacing = 0.02",
        "spacing = 1e-7",
        "tank.spacing",
        "1e-07 m",
        "6e+12 particles",
        "it must be",
    ),
    "spacing too large": ("[0.3, 0.2]", "[0.3, 0.03]", "tank.spacing", "0.02 m", "at most half", "0.015 m"),
    "spacing too large for a layer": ("[0.3, 0.1]", "[0.3, 0.02]", "tank", "0.02 m is thinner than", "smaller spacing"),
    "negative size": ("[0.3, 0.2]", "[0.3, -0.2]", "tank.size", "[0.3, -0.2] m", "> 0"),
    "four sizes": ("[0.3, 0.2]", "[0.3, 0.2, 1, 1]", "tank.size", "a list of 2 or 3 numbers > 0 in m"),
    "jitter too large": ("spacing = 0.02", "spacing = 0.02\njitter = 0.5", "tank.jitter", "is 0.5", "from 0 to 0.4"),
    "seed with a fraction": ("spacing = 0.02", "spacing = 0.02\nseed = 1.5", "tank.seed", "1.5", "a whole number"),
    "no tank": ("[tank]\nsize = [0.3, 0.2]\nspacing = 0.02", "", "tank", "missing", "or particles"),
    "tank and particles": (
        "[tank]",
        '[particles]\nfile = "p.npz"\n[tank]',
        "particles",
        "beside tank",
        "one of the two",
    ),
    "fill with no such fluid": ('fluid = "water"', 'fluid = "watre"', "fill[1].fluid", "did you mean 'water'?"),
    "fill without a fluid": ('fluid = "water"', "", "fill[1].fluid", "missing", "name of a fluid"),
    "box as four numbers": ("[[0, 0], [0.3, 0.1]]", "[0, 0, 0.3, 0.1]", "fill[1].box", "a list of 2 lists"),
    "box with its corners exchanged": ("[[0, 0], [0.3, 0.1]]", "[[0.3, 0.1], [0, 0]]", "fill[1].box", "lower < upper"),
    "box of the wrong dimension": ("[[0, 0], [0.3, 0.1]]", "[[0, 0, 0], [1, 1, 1]]", "fill[1].box", "2 coordinates"),
    "box outside the tank": ("[[0, 0], [0.3, 0.1]]", "[[1, 1], [2, 2]]", "fill[1].box", "outside the tank"),
    "two shapes": ("box = ", "polygon = [[0, 0], [1, 0], [0, 1]]\nbox = ", "fill[1]", "has box, polygon", "one shape"),
    "disc without radius": (
        "box = [[0, 0], [0.3, 0.1]]",
        "disc = { centre = [0, 0] }",
        "fill[1].disc.radius",
        "missing",
    ),
    "disc too small, of a fluid that has other fills": (
        "box = [[0, 0], [0.3, 0.1]]",
        'box = [[0, 0], [0.3, 0.1]]\n[[fill]]\nfluid = "water"\ndisc = { centre = [0.15, 0.15], radius = 1e-4 }',
        "fill[2].disc",
        "no particle off the walls",
    ),
    "disc too small": (
        "box = [[0, 0], [0.3, 0.1]]",
        "disc = { centre = [0.15, 0.1], radius = 1e-4 }",
        "fill[1].disc",
        "0.0001",
        "no particle off the walls",
        "0.02 m",
    ),
    "half-space without direction": (
        "box = [[0, 0], [0.3, 0.1]]",
        "half_space = { point = [0, 0], normal = [0, 0] }",
        "fill[1].half_space.normal",
        "a direction",
    ),
    "curve of unknown form": (
        "box = [[0, 0], [0.3, 0.1]]",
        'below = { form = "cosin", height = 1 }',
        "fill[1].below.form",
        "'cosin'",
        "did you mean 'cosine'?",
    ),
    "polyline that turns back": (
        "box = [[0, 0], [0.3, 0.1]]",
        'below = { form = "polyline", points = [[0, 0.1], [0.2, 0.1], [0.1, 0.1]] }',
        "fill[1].below.points",
        "x must ascend",
    ),
    "tank filled in part": ('fluid = "air"\n', 'fluid = "air"\nbox = [[0, 0], [0.1, 0.1]]\n', "fill[0]", "whole tank"),
    "nothing filled": ('[[fill]]\nfluid = "air"\n', "", "fill[0]", "whole tank"),
    "fill as a table": ('[[fill]]\nfluid = "air"\n\n[[fill]]', "[fill]", "fill", "a table", "a list of tables"),
    "unknown wall": ("[walls.top]", "[walls.tpo]", "walls.tpo", "no wall of the tank", "did you mean 'top'?"),
    "wall of a 3-D tank": ("[walls.top]", "[walls.back]", "walls.back", "left, right, bottom, top"),
    "wall with nothing to say": ("velocity = [1, 0]", "", "walls.top", "slip_length", "leave the table out"),
    "wall that slips and slides": (
        "velocity = [1, 0]",
        "velocity = [1, 0]\nslip = true",
        "walls.top.velocity",
        "no effect",
    ),
    "wall velocity of 3": (
        "velocity = [1, 0]",
        "velocity = [1, 0, 0]",
        "walls.top.velocity",
        "[1.0, 0.0, 0.0] m/s",
        "2",
    ),
    "wall velocity as number": ("velocity = [1, 0]", "velocity = 1", "walls.top.velocity", "1 m/s", "or a table"),
    "law that is no law": ("velocity = [1, 0]", 'law = "slip"', "walls.top.law", "without friction say slip = true"),
    "number with another unit": ("998.2", '"1 g/cm3"', "fluids.water.density", "no unit: give 1 g/cm3 in kg/m^3"),
    "number with its unit": ("998.2", '"998.2kg/m3"', "fluids.water.density", "no quotes and no unit, as 998.2"),
    "ends as a range": ("velocity = [1, 0]", "slip = true\nfrom = 0", "walls.top.from", "between = [[x, y], [x, y]]"),
    "walls in a list": ("[walls.top]", "[[walls]]", "walls", "it must be a table: walls that slip, slide or move, by"),
    "grading by a number": ("{ air = 0.04 }", "0.04", "grading.largest", "it must be a table: by a fluid's name"),
    "box as a list of four": ("[[0, 0], [0.3, 0.1]]", "[0, 0, 0.3, 0.1]", "fill[1].box", "mean [[0, 0], [0.3, 0.1]]?"),
    "negative slip length": ("velocity = [1, 0]", "slip_length = -1", "walls.top.slip_length", "-1 m", "> 0"),
    "form missing": ("velocity = [1, 0]", "velocity = { amplitude = 1 }", "walls.top.velocity.form", "'sine'"),
    "form misspelt": ("[1, 0]", '{ form = "sinus" }', "walls.top.velocity.form", "'sinus'", "did you mean 'sine'?"),
    "sine without frequency": (
        "[1, 0]",
        '{ form = "sine", amplitude = [1, 0] }',
        "walls.top.velocity.frequency",
        "missing",
        "Hz",
    ),
    "amplitude of 1 for 2": (
        "[1, 0]",
        '{ form = "sine", amplitude = 1, frequency = 1 }',
        "walls.top.velocity.amplitude",
        "2 numbers",
    ),
    "ramp that ends before it starts": (
        "[1, 0]",
        '{ form = "ramp", end_value = [1, 0], start_time = 2, end_time = 1 }',
        "walls.top.velocity.end_time",
        "1.0 s",
        "later than start_time",
    ),
    "motion that does not begin at zero": (
        "[grading]",
        MOTION + '"sine", amplitude = 1, frequency = 1, phase = 1 }\n[grading]',
        "tank_motion.angle",
        "t = 0",
    ),
    "motion with a misspelt key": (
        "[grading]",
        MOTION + '"sine", amplitude = 1, freqency = 1, frequency = 1 }\n[grading]',
        "tank_motion.angle.freqency",
        "did you mean 'frequency'?",
    ),
    "motion without functions": ("[grading]", "[tank_motion]\npivot = [0, 0]\n[grading]", "tank_motion", "translation"),
    "wall that changes the volume": (
        "velocity = [1, 0]",
        'motion = { form = "ramp", end_value = 0.01, end_time = 1 }',
        "walls",
        "volume",
    ),
    "table without a file": ("[1, 0]", '{ form = "table", file = "no.csv" }', "walls.top.velocity.file", "no.csv"),
    "table of two kinds": ("[1, 0]", '{ form = "table" }', "walls.top.velocity", "neither a file nor times"),
    "table too short": (
        "[1, 0]",
        '{ form = "table", times = [0, 0.5], values = [[0, 0], [1, 0]] }',
        "walls.top.velocity.times",
        "from 0.0 to 0.5 s",
        "from 0 to 1.0 s",
    ),
    "table whose times fall": (
        "[1, 0]",
        '{ form = "table", times = [0, 2, 1], values = [[0, 0], [1, 0], [1, 0]] }',
        "walls.top.velocity.times",
        "1.0 s after 2.0 s",
        "ascend",
    ),
    "grading of no fluid": ("air = 0.04", "aire = 0.04", "grading.largest.aire", "did you mean 'air'?"),
    "grading below the spacing": ("air = 0.04", "air = 0.01", "grading.largest.air", "0.01 m", "0.02 m"),
    "growth out of range": ("air = 0.04 }", "air = 0.04 }\ngrowth = 1", "grading.growth", "is 1", "from 0.02 to 0.5"),
    "largest move out of range": (
        "largest_move = 0.5",
        "largest_move = 5",
        "numerics.largest_move",
        "from 0.01 to 2",
    ),
    "half an iteration": (
        "largest_move = 0.5",
        "newton_iterations = 0.5",
        "numerics.newton_iterations",
        "whole number",
    ),
    "unknown triangulation": ("largest_move = 0.5", 'triangulation = "rebuid"', "numerics.triangulation", "'rebuild'"),
    "rule in the wrong table": ("largest_move = 0.5", "too_close = 0.5", "numerics.too_close", "is not a known key"),
    "rules that undo each other": (
        "largest_move = 0.5",
        "relocation.long_edge = 0.9",
        "numerics.relocation.long_edge",
        "is 0.9, below twice too_close",
    ),
    "no end": ("end = 1.0", "", "time.end", "missing", "a number > 0 in s"),
    "negative end": ("end = 1.0", "end = -1.0", "time.end", "-1.0 s", "> 0"),
    "end as date": ("end = 1.0", "end = 2024-01-01", "time.end", "a number > 0"),
    "largest step zero": ("largest_step = 1e-3", "largest_step = 0", "time.largest_step", "0 s", "> 0"),
    "outputs closer than steps": ("interval = 0.1", "interval = 1e-6", "output.interval", "1e-06 s", "0.001 s"),
    "unknown kind of fields": ("interval = 0.1", 'fields = "hdf"', "output.fields", "'hdf'", "'vtu', 'vtkhdf', 'both'"),
    "compression out of range": ("interval = 0.1", "compression = 10", "output.compression", "10", "from 0 to 9"),
    "unknown quantity": ("interval = 0.1", 'quantities = ["vortex"]', "output.quantities", "'vortex'", "vorticity"),
    "quantity of other fluids": (
        "interval = 0.1",
        'quantities = ["viscosity"]',
        "output.quantities",
        "'viscosity', which this flow has not",
    ),
    "folder without a name": ("interval = 0.1", 'folder = ""', "output.folder", "''", "not empty"),
    "probe of no type": ('type = "wave gauge"', "", "probes[0].type", "missing", "'wave gauge'"),
    "probe of unknown type": ('"wave gauge"', '"wave gage"', "probes[0].type", "did you mean 'wave gauge'?"),
    "probe without a name": ('name = "gauge"', "", "probes[0].name", "missing"),
    "probe whose name is a path": ('"gauge"', '"../gauge"', "probes[0].name", "'../gauge'", "letters, digits"),
    "probe outside": ("x = 0.15", "x = 3", "probes[0].x", "is 3.0 m", "between 0 and 0.3 m"),
    "probe without its place": ("x = 0.15", "", "probes[0].x", "missing", "a number in m: place of the line"),
    "probe with a foreign key": ("x = 0.15", "x = 0.15\naxis = 0", "probes[0].axis", "is no key of", "x, fluid"),
    "probe with a misspelt key": ("x = 0.15", "x = 0.15\nintervall = 1", "probes[0].intervall", "'interval'?"),
    "probe of no fluid": ('x = 0.15\nfluid = "water"', 'x = 0.15\nfluid = "oil"', "probes[0].fluid", "'oil'", "'air'"),
    "probe interval zero": ("x = 0.15", "x = 0.15\ninterval = 0", "probes[0].interval", "> 0 in s"),
    "two probes of one name": (
        "[checkpoint]",
        '[[probes]]\ntype = "energy"\nname = "gauge"\n[checkpoint]',
        "probes[1].name",
        "'gauge', the name of an earlier probe",
    ),
    "probe at no wall": (
        "[checkpoint]",
        '[[probes]]\ntype = "wall force"\nname = "f"\nwall = "lid"\n[checkpoint]',
        "probes[1].wall",
        "'lid'; it must be one of the walls 'left', 'right', 'bottom', 'top'",
    ),
    "filter without a time": (
        "[checkpoint]",
        '[[probes]]\ntype = "wall force"\nname = "f"\nwall = "left"\ntime_constant = 0\n[checkpoint]',
        "probes[1].time_constant",
        "> 0 in s",
    ),
    "impulse of no load": (
        "[checkpoint]",
        '[[probes]]\ntype = "energy"\nname = "e"\nimpulse = true\n[checkpoint]',
        "probes[1].impulse",
        "no key of the type 'energy'; its keys are type, name, interval",
    ),
    "probe of an unknown quantity": (
        "[checkpoint]",
        '[[probes]]\ntype = "point"\nname = "p"\nat = [0.1, 0.1]\nquantities = ["speed"]\n[checkpoint]',
        "probes[1].quantities",
        "'speed'",
        "velocity_x",
    ),
    "probes as a table": ("[[probes]]", "[probes]", "probes", "a list of tables"),
    "checkpoint interval zero": ("interval = 0.2", "interval = 0", "checkpoint.interval", "> 0 in s"),
    "negative wall interval": ("interval = 0.2", "wall_interval = -1", "checkpoint.wall_interval", ">= 0 in s"),
    "no TOML": ("end = 1.0", "end = ", "", "not valid TOML", "Invalid value"),
    "a text without quotes": ('fluid = "water"', "fluid = water", "", "not valid TOML", "quotes, as 'water'"),
    "a step": ("end = 1.0", "end = 1.0\nstep = 1e-3", "time.step", "the longest step is time.largest_step"),
    "a key twice": ("end = 1.0", "end = 1.0\nend = 2.0", "", "not valid TOML", "Cannot overwrite a value"),
}


def errors_of(text, folder=".", overrides=()):
    """What loading a text and making its case is refused for, as lines."""
    with pytest.raises(CaseFileError) as error:
        read_case(text, "case.toml", folder, overrides).case()
    return str(error.value).splitlines()


def test_the_good_file_is_good():
    assert len(read_case(GOOD, "case.toml").case().particles) > 50


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_clear_error(name):
    old, new, key, *words = MISTAKES[name]
    assert old in GOOD
    text = GOOD.replace(old, new, 1)
    lines = errors_of(text)
    assert len(lines) == 1, lines
    found = re.match(r"case\.toml(?::(\d+))?: (\S+)", lines[0])
    assert found is not None
    if key:
        assert found[2].rstrip(":") == key
        assert found[1], "no line"
        last = key.rpartition(".")[2].partition("[")[0]
        assert "missing" in lines[0] or re.search(
            rf"\b({last}|{key.split('.')[0].partition('[')[0]})\b", text.splitlines()[int(found[1]) - 1]
        )
    for word in words:
        assert word in lines[0], lines[0]


def test_there_are_many():
    assert len(MISTAKES) + len(COMMAND_LINES) + len(OVERRIDES) >= 80


def test_all_mistakes_stand_in_one_report_in_the_order_of_the_file():
    text = GOOD
    chosen = ["misspelt title", "three accelerations in 2-D", "negative density", "spacing too large", "no end"]
    chosen += ["fill with no such fluid", "unknown wall", "grading of no fluid", "rules that undo each other"]
    for name in chosen:
        old, new, *_ = MISTAKES[name]
        text = text.replace(old, new, 1)
    lines = errors_of(text)
    assert sorted(re.match(r"\S+ (\S+?):? ", line)[1] for line in lines) == sorted(MISTAKES[name][2] for name in chosen)
    numbers = [int(line.split(":")[1]) for line in lines]
    assert numbers == sorted(numbers)


# An override, the key that the error names, and words of it.
OVERRIDES = {
    "no value": ("fluids.water.viscosity", "", "must be a dotted key, = and a value"),
    "empty value": ("fluids.water.viscosity=", "", "no value after ="),
    "no key": ("=3", "", "must be a dotted key"),
    "bad key": ("fluids..water=3", "", "must be a dotted key"),
    "unknown fluid's key": ("fluids.water.colour=3", "fluids.water.colour", "is not a known key"),
    "out of range": ("fluids.water.viscosity=-1", "fluids.water.viscosity", "-1 Pa s; it must be a number >= 0"),
    "a text for a number": ("time.end=long", "time.end", "'long'", "a number > 0"),
    "no such item": ("fill.2.fluid=air", "", "'2' is no item of fill; they are 0 to 1"),
    "below a number": ("time.end.more=1", "", "time.end is 1.0"),
    "unknown choice": ("interface=shrp", "interface", "did you mean 'sharp'?"),
}


@pytest.mark.parametrize("name", OVERRIDES)
def test_a_bad_override_is_named(name):
    given, key, *words = OVERRIDES[name]
    lines = errors_of(GOOD, overrides=[given])
    assert len(lines) == 1, lines
    assert lines[0].startswith(f"--set {given}: {key}")
    for word in words:
        assert word in lines[0]


# Words of a command line, and words that the error must have. CASE is a good file, OUT a folder with results.
COMMAND_LINES = {
    "no command": (["rnu", "CASE"], 'Unknown command "rnu"', "run"),
    "no case": (["run"], "CASE"),
    "no such file": (["run", "csae.toml"], "csae.toml", "No such file", "did you mean 'case.toml'?"),
    "a folder for a file": (["check", "FOLDER"], "Is a directory", "give a case file in TOML"),
    "a picture for a file": (["check", "PICTURE"], "not text in UTF-8"),
    "unknown option": (["run", "CASE", "--thread", "1"], "--thread"),
    "threads as text": (["run", "CASE", "--threads", "two"], "--threads", "two"),
    "threads below 1": (["run", "CASE", "--threads", "0"], "threads is 0", ">= 1"),
    "unknown processor": (["run", "CASE", "--arch", "gpu"], '"gpu" for --arch', '"cpu"'),
    "until as text": (["run", "CASE", "--until", "noon"], "--until", "noon"),
    "until in the past": (["run", "CASE", "--until", "-1"], "--until is -1.0 s", "> 0"),
    "until never": (["run", "CASE", "--until", "nan"], "--until is nan s", "> 0"),
    "a folder with results": (["run", "CASE", "--out", "OUT"], "holds results (history.csv)", "--overwrite"),
    "a file for a folder": (["run", "CASE", "--out", "CASE"], "case.toml", "cannot be written to"),
    "a bad override": (["run", "CASE", "--set", "time.end=-1"], "--set time.end=-1: time.end", "> 0"),
    "picture of another kind": (["check", "CASE", "--picture", "a.jpg"], "'a.jpg'", "PNG"),
    "info on nothing": (["info", "nowhere"], "nowhere", "no such folder"),
    "info on another folder": (["info", "FOLDER"], "no case.json", "results folder"),
    "info on damaged results": (["info", "OUT"], "case.json"),
    "render nothing": (["render", "nowhere"], "nowhere", "no such folder"),
    "threads with a fraction": (["run", "CASE", "--threads", "2.5"], "--threads", "'2.5' is not a whole number"),
    "end that is no number": (["run", "CASE", "--until", "soon"], "--until", "'soon' is not a number"),
    "port with a fraction": (["view", "OUT", "--port", "1.5"], "--port", "'1.5' is not a whole number"),
    "compression with a fraction": (["convert", "OUT", "--compression", "1.5"], "'1.5' is not a whole number"),
    "compression out of range": (["convert", "OUT", "--compression", "10"], "compression is 10", "from 0 to 9"),
    "precision that is none": (["convert", "OUT", "--precision", "f32"], '"f32"', '"double", "single"'),
    "schema where nothing can be written": (["schema", "--out", "nowhere/schema.json"], "nowhere/schema.json"),
}


@pytest.mark.parametrize("name", COMMAND_LINES)
def test_a_bad_command_line_exits_with_2_and_one_message(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(GOOD)
    (tmp_path / "picture.toml").write_bytes(b"\x89PNG\r\n\xff\xfe")
    for folder in ("out", "folder"):
        (tmp_path / folder).mkdir()
    (tmp_path / "out" / "history.csv").write_text("step,time\n")
    if name == "info on damaged results":
        (tmp_path / "out" / "case.json").write_text("{")
    places = {"CASE": "case.toml", "OUT": "out", "FOLDER": "folder", "PICTURE": "picture.toml"}
    arguments, *words = COMMAND_LINES[name]
    code = main([places.get(word, word) for word in arguments])
    said = capsys.readouterr()
    text = " ".join((said.out + said.err).replace("│", " ").split())
    assert code == 2, text
    assert "Traceback" not in text
    for word in words:
        assert word in text, text
    assert not (tmp_path / "out" / "summary.json").exists()


def test_a_table_file_is_checked_line_by_line(tmp_path):
    table = '{ form = "table", file = "lid.csv" }'
    text = GOOD.replace("[1, 0]", table, 1)
    for content, words in {
        "": ["0 rows"],
        "0,0,0\n": ["1 rows"],
        "time,u,v\n0,0,0\n1,x,0\n": ["line 3", "'1,x,0'", "finite numbers"],
        "0,0,0\n1,1\n": ["line 2", "'1,1'"],
        "t;u;v\n0;0;0\n1;0,5;0\n": ["line 2", "'0;0;0'", "with commas between them and a point in decimals"],
        "0,0,0\n1,nan,0\n": ["line 2"],
        "0,0\n1,1\n": ["2 numbers"],
        "0.1,0,0\n1,1,0\n": ["from 0.1 to 1.0 s"],
        "0,0,0\n0.5,1,0\n": ["from 0.0 to 0.5 s"],
        "0,0,0\n0,1,0\n1,1,0\n": ["0.0 s after 0.0 s", "ascend"],
    }.items():
        (tmp_path / "lid.csv").write_text(content)
        (line,) = errors_of(text, tmp_path)
        assert "walls.top.velocity.file" in line
        for word in words:
            assert word in line
    (tmp_path / "lid.csv").write_text("# m/s\ntime,u,v\n0,0,0\n1,1,0\n")
    assert read_case(text, "case.toml", tmp_path).case().walls[0].velocity(1.0) == pytest.approx([1, 0])
    renamed = text.replace('"lid.csv"', '"lid.csv", columns = ["time", "w"]')
    assert "no column 'w'" in errors_of(renamed, tmp_path)[0]


def test_a_particles_file_is_checked(tmp_path):
    text = GOOD[: GOOD.index("[tank]")] + '[particles]\nfile = "p.npz"\n' + GOOD[GOOD.index("[numerics]") :]
    x = np.stack(np.meshgrid(np.arange(6.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
    wall = ((x == 0) | (x == 5)).any(axis=1)
    good = {"position": x, "fluid": np.zeros(36, int), "wall": wall}
    for arrays, word in (
        ({"position": x, "fluid": good["fluid"]}, "lacks the arrays 'wall'"),
        ({**good, "colour": x}, "unknown arrays 'colour'"),
        ({**good, "fluid": np.zeros(3, int)}, "fluid has shape (3,)"),
        ({**good, "position": np.zeros((36, 2))}, "duplicates"),
        ({**good, "fluid": np.full(36, 7)}, "fluid 7"),
        ({**good, "position": np.array([{}, {}])}, "cannot be read"),
    ):
        np.savez(tmp_path / "p.npz", **arrays)
        (line,) = errors_of(text, tmp_path)
        assert word in line
    np.savez(tmp_path / "p.npz", **good)
    assert len(read_case(text, "case.toml", tmp_path).case().particles) == 36


SHAPED = """
gravity = [0, -9.81]
[fluids.water]
density = 998.2
viscosity = 1e-3
[tank]
spacing = 0.05
{tank}
[[fill]]
fluid = "water"
[time]
end = 1.0
"""


@pytest.mark.parametrize(
    ("tank", "path", "text"),
    [
        ("size = [1.0, 1.0]\nshape = {corners = [[0, 0], [1, 0], [1, 1]]}", "tank", "has both size and shape"),
        ("jitter = 0.1", "tank", "has neither size nor shape"),
        ("shape = {corners = [[0, 0], [1, 0]]}", "tank.shape", "it needs 3 or more"),
        ("shape = {corners = [[0, 0], [1, 1], [1, 0], [0, 1]]}", "tank.shape", "crosses or touches"),
        (
            "shape = {circle = {centre = [0, 0], radius = 1}, corners = [[0, 0], [1, 0]]}",
            "tank.shape",
            "either corners",
        ),
        (
            "shape = {corners = [[0, 0], [1, 0], [1, 1]], holes = [{corners = [[2, 2], [3, 2], [3, 3]]}]}",
            "tank.shape",
            "is not inside the outline",
        ),
        (
            "shape = {corners = [[0, 0], [1, 0], [1, 0.1], [0, 0.1]]}",
            "tank",
            "0.1 m wide, 2 spacings",
        ),
        (
            "shape = {corners = [[0, 0], [1, 0], [1, 1]], names = ['floor', 'wall', 'roof']}\n"
            "[walls.left]\nslip = true",
            "walls.left",
            "must be one of floor, wall, roof",
        ),
    ],
)
def test_bad_shapes_are_refused_at_their_place(tank, path, text):
    with pytest.raises(CaseFileError) as caught:
        read_case(SHAPED.replace("{tank}", tank), "case.toml")
    assert path in str(caught.value)
    assert text in str(caught.value)


@pytest.mark.parametrize(
    ("probe", "fits"),
    [
        ('type = "point"\nat = [0.5, 0.1]', False),
        ('type = "point"\nat = [0.5, 0.2]', True),
        ('type = "point"\nat = [0.3, 0.1]', True),
        ('type = "line"\nstart = [0.1, 0.1]\nend = [0.5, 0.1]\ncount = 5', False),
    ],
)
def test_a_probe_in_a_baffle_is_refused(probe, fits):
    corners = "[[0, 0], [0.4, 0], [0.4, 0.2], [0.6, 0.2], [0.6, 0], [1, 0], [1, 0.5], [0, 0.5]]"
    names = ["a", "b", "c", "d", "e", "f", "g", "h"]
    text = SHAPED.replace("{tank}", f"shape = {{corners = {corners}, names = {names}}}")
    text += f'\n[[probes]]\nname = "p"\n{probe}\n'
    if fits:
        read_case(text, "case.toml").case()
        return
    with pytest.raises(CaseFileError, match=r"lies outside of the tank, 0\.1 m behind '[bcd]'") as caught:
        read_case(text, "case.toml").case()
    assert "case.toml:" in str(caught.value)


def test_mistakes_of_probes_that_need_the_particles_are_told_at_once():
    more = '[[probes]]\ntype = "point"\nname = "p"\nat = [9, 0.1]\n[checkpoint]'
    lines = errors_of(GOOD.replace("x = 0.15", "x = 3", 1).replace("[checkpoint]", more, 1))
    assert ["probes[0].x is 3.0 m" in lines[0], "probes[1].at is [9.0, 0.1] m" in lines[1]] == [True, True]


@pytest.mark.parametrize("periodic", ['"x"', '"xy"'])
@pytest.mark.parametrize(
    ("table", "path"),
    [
        ('[[fill]]\nfluid = "oyl"', "fill[1].fluid is 'oyl'; it must be one of the fluids"),
        ('[[probes]]\ntype = "volume"\nname = "v"\nfluid = "oyl"', "'oyl'"),
    ],
)
def test_names_are_checked_in_periodic_tanks_too(periodic, table, path):
    text = f"""
gravity = [0, 0]
fluids.water = {{ density = 1000, viscosity = 1e-3 }}
tank = {{ size = [0.4, 0.3], spacing = 0.03, periodic = {periodic} }}
time.end = 0.1
[[fill]]
fluid = "water"
{table}
"""
    with pytest.raises(CaseFileError) as error:
        read_case(text, "case.toml")
    assert path in str(error.value)

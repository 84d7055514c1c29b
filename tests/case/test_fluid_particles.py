"""tipfem/fluid.py and tipfem/particles.py: what they accept, what they refuse and in which words."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

NAN, INF = float("nan"), float("inf")
SQUARE = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
ARRAYS = ("position", "fluid", "wall", "velocity", "acceleration", "pressure")


def square(**changes) -> tp.Particles:
    """Four particles at the corners of a square of 0.1 m."""
    arguments = {"position": SQUARE, "fluid": [0, 1, 0, 1], "wall": [True, False, True, True], **changes}
    return tp.Particles(**arguments)


def test_a_fluid_keeps_what_it_is_given_and_is_a_value():
    oil = tp.Fluid("oil", 900.0, 0.0)
    assert (oil.name, oil.density, oil.viscosity) == ("oil", 900.0, 0.0)
    assert oil == tp.Fluid("oil", 900, 0)
    assert len({oil, tp.Fluid("oil", 900, 0), tp.Fluid("oil", 900, 1e-3)}) == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("oil", -900.0, 1.0), ["'oil'", "density", "-900.0", "> 0"]),
        (("oil", 0.0, 1.0), ["'oil'", "density", "0.0", "> 0"]),
        (("oil", NAN, 1.0), ["'oil'", "density", "nan"]),
        (("oil", INF, 1.0), ["'oil'", "density", "inf"]),
        (("oil", 900.0, -1e-9), ["'oil'", "viscosity", "-1e-09", ">= 0"]),
        (("oil", 900.0, NAN), ["'oil'", "viscosity", "nan"]),
        (("", 900.0, 1.0), ["name", "''"]),
        ((3, 900.0, 1.0), ["name", "3"]),
        (("w", None, 1), ["'w'", "density", "None", "> 0"]),
        (("w", "1000", 1), ["'w'", "density", "'1000'"]),
        (("w", True, 1), ["'w'", "density", "True"]),
        (("w", 10**400, 1), ["'w'", "density"]),
        (("w", 1, [1]), ["'w'", "viscosity", "[1]"]),
        ((None, 1, 1), ["name", "None"]),
        ((np.ones(2), 1, 1), ["name"]),
    ],
)
def test_a_fluid_refuses_impossible_properties(arguments, words):
    with pytest.raises(ValueError, match=r"^Fluid") as refusal:
        tp.Fluid(*arguments)
    assert all(word in str(refusal.value) for word in words), refusal.value


def test_arrays_left_out_are_zero_and_types_are_the_house_s():
    p = square()
    assert len(p) == 4
    assert p.dimension == 2
    for name, shape, dtype in (
        ("position", (4, 2), np.float64),
        ("fluid", (4,), np.int32),
        ("wall", (4,), np.bool_),
        ("velocity", (4, 2), np.float64),
        ("acceleration", (4, 2), np.float64),
        ("pressure", (4,), np.float64),
    ):
        assert getattr(p, name).shape == shape
        assert getattr(p, name).dtype == dtype
    assert not p.velocity.any()
    assert not p.acceleration.any()
    assert not p.pressure.any()
    assert tp.Particles(np.eye(3), [0, 0, 0], [0, 0, 0]).dimension == 3


@pytest.mark.parametrize("dimension", [2, 3])
def test_default_spacing_is_the_median_distance_to_the_nearest_neighbour(dimension):
    x = np.random.default_rng(3).uniform(size=(60, dimension))
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    p = tp.Particles(x, np.zeros(60, int), np.zeros(60, bool))
    assert p.spacing == pytest.approx(np.median(distance.min(axis=1)), rel=1e-14)
    assert tp.Particles(x, np.zeros(60, int), np.zeros(60, bool), spacing=0.25).spacing == 0.25


def test_particles_own_their_arrays():
    given = {
        "position": SQUARE.copy(),
        "fluid": np.array([0, 1, 0, 1], np.int32),
        "wall": np.ones(4, bool),
        "velocity": np.ones((4, 2)),
        "acceleration": np.ones((4, 2)),
        "pressure": np.ones(4),
    }
    p = tp.Particles(**given)
    for name, array in given.items():
        assert not np.shares_memory(getattr(p, name), array), name


def test_a_copy_is_independent_and_takes_changes():
    p = square(velocity=np.arange(8.0).reshape(4, 2), acceleration=np.ones((4, 2)), pressure=[1, 2, 3, 4], spacing=0.2)
    q = p.copy(pressure=np.full(4, 7.0))
    assert q.spacing == 0.2
    assert (q.pressure == 7.0).all()
    for name in ARRAYS:
        if name != "pressure":
            np.testing.assert_array_equal(getattr(q, name), getattr(p, name))
    before = {name: getattr(p, name).copy() for name in ARRAYS}
    for name in ARRAYS:
        getattr(q, name)[...] = 1 - getattr(q, name).astype(float)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(p, name), before[name])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"position": np.zeros(4)}, ["position", "(4,)", "(N, 2) or (N, 3)"]),
        ({"position": np.zeros((4, 1))}, ["position", "(4, 1)"]),
        ({"position": np.zeros((4, 4))}, ["position", "(4, 4)"]),
        ({"position": np.zeros((0, 2))}, ["position", "(0, 2)"]),
        ({"fluid": [0, 0, 0]}, ["fluid", "(3,)", "(4,)"]),
        ({"wall": True}, ["wall", "()", "(4,)"]),
        ({"velocity": np.zeros((4, 3))}, ["velocity", "(4, 3)", "(4, 2)"]),
        ({"acceleration": np.zeros(4)}, ["acceleration", "(4,)", "(4, 2)"]),
        ({"pressure": np.zeros((4, 1))}, ["pressure", "(4, 1)", "(4,)"]),
        ({"spacing": -0.1}, ["spacing", "-0.1", "> 0"]),
        ({"spacing": NAN}, ["spacing", "nan"]),
        ({"spacing": INF}, ["spacing", "inf"]),
        ({"spacing": "a"}, ["spacing", "'a'", "> 0"]),
        ({"position": "here"}, ["position", "numbers"]),
        ({"position": [[0, 0], [1]]}, ["position", "numbers"]),
        ({"fluid": ["a", "b", "c", "d"]}, ["fluid", "(4,)", "numbers"]),
        ({"fluid": [0, 0.7, 0, 0]}, ["fluid of particle 1", "0.7", "whole number"]),
        ({"fluid": [0, 0, NAN, 0]}, ["fluid of particle 2", "nan", "whole number"]),
        ({"fluid": [0, 0, 0, 2**31]}, ["fluid of particle 3", "whole number"]),
        ({"wall": [1, 0, 2, 1]}, ["wall of particle 2", "True or False"]),
        ({"pressure": [None] * 4}, ["pressure", "numbers"]),
    ],
)
def test_wrong_shapes_and_spacings_are_refused(changes, words):
    with pytest.raises(ValueError, match=r"^Particles: ") as refusal:
        square(**changes)
    assert all(word in str(refusal.value) for word in words), refusal.value


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("name", ["position", "velocity", "acceleration", "pressure"])
def test_values_that_are_not_finite_are_refused_with_their_place(name, value):
    array = SQUARE.copy() if name == "position" else np.zeros(4 if name == "pressure" else (4, 2))
    array[(2, 1) if array.ndim == 2 else 2] = value
    with pytest.raises(ValueError, match=f"{name} of particle 2 is .*{value}.*finite"):
        square(**{name: array})


def test_a_changed_state_shares_what_is_not_changed():
    p, velocity = square(spacing=0.2), np.array([[3.0, 4.0], [0.0, 0.0], [-6.0, 8.0], [1.0, 1.0]])
    q = p.shallow_copy(velocity=velocity)
    assert q.velocity is velocity
    assert q.position is p.position
    assert q.spacing == 0.2
    assert not p.velocity.any()
    assert q.max_speed == 10.0


def test_duplicates_are_refused_with_both_numbers_and_the_place():
    x = np.concatenate([SQUARE, [[0.1, 0.1 + 1e-9]]])
    with pytest.raises(ValueError, match=r"2 and 4 are duplicates at \[0\.1, 0\.1") as refusal:
        tp.Particles(x, np.zeros(5, int), np.zeros(5, bool))
    assert "position of its own" in str(refusal.value)
    with pytest.raises(ValueError, match="2 and 4 are duplicates"):
        tp.Particles(x, np.zeros(5, int), np.zeros(5, bool), spacing=0.1)
    x[4, 1] += 1e-6
    close = tp.Particles(x, np.zeros(5, int), np.zeros(5, bool), spacing=0.1)
    assert 0 < close.require_distinct() <= 0.1  # 1e-5 spacings apart: close, but two places
    # A copy is a step of a run, in which particles may meet; relocation parts them.
    x[4] = x[2]
    with pytest.raises(ValueError, match="2 and 4 are duplicates"):
        close.copy(position=x).require_distinct()


def test_a_copy_refuses_what_is_no_part_of_a_state():
    p = square()
    with pytest.raises(TypeError, match="there is no colour"):
        p.copy(colour=1)
    with pytest.raises(ValueError, match=r"spacing is 0\.0"):
        p.copy(spacing=0.0)
    with pytest.raises(ValueError, match=r"velocity of particle 1 is .*finite"):
        p.copy(velocity=[[0, 0], [0, NAN], [0, 0], [0, 0]])


def test_all_on_one_place_and_a_single_particle_have_no_spacing():
    with pytest.raises(ValueError, match=r"0 and [123] are duplicates"):
        tp.Particles(np.zeros((4, 2)), np.zeros(4, int), np.zeros(4, bool))
    with pytest.raises(ValueError, match="a single particle has no spacing"):
        tp.Particles(np.zeros((1, 2)), [0], [False])
    assert tp.Particles(np.zeros((1, 2)), [0], [False], spacing=0.1).spacing == 0.1

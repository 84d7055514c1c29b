"""Named timers: paths of nested ones, what they add up to, and that they cost nothing where none are active."""

from __future__ import annotations

import time

import pytest

import tipfem as tp
from tipfem.timers import Timings, timer


def test_nested_timers_have_the_path_of_those_around_them():
    timings = Timings()
    with timings.active():
        for _ in range(3):
            with timer("outer"):
                with timer("inner"):
                    time.sleep(2e-3)
                time.sleep(1e-3)
        with timer("inner"):
            pass
    assert timings.calls == {"outer/inner": 3, "outer": 3, "inner": 1}
    assert timings.seconds["outer/inner"] >= 6e-3
    assert timings.seconds["outer"] >= timings.seconds["outer/inner"] + 3e-3
    assert timings.seconds["inner"] < 1e-3


def test_a_function_is_timed_at_every_call_and_through_errors():
    @timer("work")
    def work(fails):
        if fails:
            raise ZeroDivisionError

    timings = Timings()
    work(False)  # outside: not counted
    with timings.active():
        work(False)
        with pytest.raises(ZeroDivisionError):
            work(True)
        with timer("after"):  # not inside "work"
            pass
    assert timings.calls == {"work": 2, "after": 1}


def test_timings_do_not_mix_and_are_reset():
    outer, inner = Timings(), Timings()
    with outer.active(), timer("a"):
        with inner.active(), timer("b"):
            pass
        with timer("c"):
            pass
    assert set(outer.seconds) == {"a", "a/c"}
    assert set(inner.seconds) == {"b"}
    outer.reset()
    assert not outer.seconds
    assert not outer.calls


def test_a_device_is_waited_for_before_the_clock_is_read():
    waited = []
    timings = Timings(synchronise=lambda: waited.append(1))
    with timings.active(), timer("launch"):
        assert len(waited) == 1
    assert len(waited) == 2


def test_a_step_says_where_its_time_went(water, air):
    """The parts are there, are called as often as the history says, and make up most of the step."""
    tank = tp.tank((1, 1), 0.05).fill(air).fill(water, box=((0, 0), (0.4, 0.6)))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81)), time_step=2e-3)
    for _ in range(2):
        simulation.step()
    simulation.timings.reset()
    for _ in range(4):
        simulation.step()
    seconds, calls = simulation.timings.seconds, simulation.timings.calls
    assert calls["step"] == calls["step/solve"] == calls["step/remeshing"] == 4
    newton = sum(row["newton_iterations"] for row in simulation.history[-4:])
    assert calls["step/solve/krylov"] == newton
    assert calls["step/solve/residual"] == newton + 4
    for part in ("set-up", "set-up/preconditioner", "residual", "jacobian", "krylov"):
        assert 0 < seconds[f"step/solve/{part}"] < seconds["step/solve"]
    parts = sum(value for path, value in seconds.items() if path.count("/") == 1)
    assert 0.9 * seconds["step"] < parts <= seconds["step"]

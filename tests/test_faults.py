"""Faults put into a run: it takes a shorter step, or stops with its results and a checkpoint that is good."""

from __future__ import annotations

import csv

import numpy as np
import pytest

import tipfem as tp
from tipfem.linalg import fgmres
from tipfem.mesh.delaunay import TriangulationError
from tipfem.run import checkpoint

END, WHEN = 0.03, 0.011


@pytest.fixture
def start(water, air):
    """Makes a simulation with a results folder, and a column if one is given."""
    tank = tp.tank((0.5, 0.5), 0.05).fill(air).fill(water, box=((0, 0), (0.2, 0.3)))
    case = tp.Case(tank, [water, air], (0, -9.81))

    def start(out, column=None):
        columns = None if column is None else {"fault": column}
        times = {"time_step": 2e-3, "output_interval": 0.008, "checkpoint_interval": 0.004}
        return tp.Simulation(case, out, columns=columns, **times)

    return start


def rows(out):
    with open(out / "history.csv", newline="") as file:
        return [row[:-1] for row in csv.reader(file)]


def finite_checkpoints(out, case):
    """Times of the checkpoints, all of whose states must be finite."""
    states = [checkpoint.read_file(path, case)["state"] for path in sorted(out.glob("checkpoints/*.h5"))]
    for state in states:
        for name in ("position", "velocity", "acceleration", "pressure"):
            assert np.isfinite(getattr(state.particles, name)).all()
    return [state.time for state in states]


def put_not_a_number(simulation):
    simulation.particles.velocity[17] = np.nan


def put_infinite_pressure(simulation):
    simulation.particles.pressure[17] = np.inf


def put_two_particles_in_one_place(simulation):
    inside = np.flatnonzero(~simulation.particles.wall)
    simulation.particles.position[inside[0]] = simulation.particles.position[inside[-1]]


@pytest.mark.slow(but=("put_two_particles_in_one_place-halving the time step down to",))
@pytest.mark.parametrize(
    ("corrupt", "message"),
    [
        (put_not_a_number, "velocity of particle 17 at"),
        (put_infinite_pressure, "pressure of particle 17 at"),
        (put_two_particles_in_one_place, "halving the time step down to"),
    ],
)
def test_a_corrupt_state_stops_the_run_and_reaches_no_checkpoint(corrupt, message, start, tmp_path):
    done = []

    def column(simulation):
        if simulation.time > WHEN and not done:
            done.append(simulation.time)
            corrupt(simulation)
        return 0.0

    whole = start(tmp_path / "whole", lambda _: 0.0)
    whole.run(END, progress=False)
    broken = start(tmp_path / "broken", column)
    with pytest.raises(tp.SimulationError, match=message):
        broken.run(END, progress=False)
    times = finite_checkpoints(tmp_path / "broken", broken.case)
    out = tmp_path / "broken"
    summary = tp.read_results(out).summary
    assert message in summary["status"]
    if corrupt is put_two_particles_in_one_place:  # all values are finite: the state at the stop is kept
        assert times[-1] == done[0]
        return
    assert 0.004 < times[-1] <= WHEN
    resumed = tp.Simulation.resume(out, columns={"fault": lambda _: 0.0})
    resumed.run(END, progress=False)
    assert rows(out) == rows(tmp_path / "whole")


def test_a_run_from_a_corrupt_state_writes_no_checkpoint_of_it(start, tmp_path):
    simulation = start(tmp_path)
    simulation.run(0.008, progress=False)
    before = finite_checkpoints(tmp_path, simulation.case)
    put_not_a_number(simulation)
    with pytest.raises(tp.SimulationError, match="no checkpoint is written, for velocity of particle 17 at"):
        simulation.run(END, progress=False)
    assert finite_checkpoints(tmp_path, simulation.case) == before


def break_krylov_vector(real, self, *arguments):
    columns = real(self, *arguments)
    return [[np.nan] * len(column) for column in columns]


def break_down_at_once(real, self, *arguments):
    """No new direction is found, and the system is not solved."""
    return [[0.0] * len(column) for column in real(self, *arguments)]


@pytest.mark.parametrize("fault", [break_krylov_vector, break_down_at_once])
@pytest.mark.parametrize("lasting", [False, True])
def test_a_breakdown_of_krylovs_method_is_retried_or_stops_the_run(fault, lasting, start, tmp_path, monkeypatch):
    real, faults = fgmres.KrylovSpace.extend_at_once, []
    simulation = start(tmp_path)
    simulation.run(0.008, progress=False)

    def extend(self, *arguments):
        if lasting or not faults:
            faults.append(True)
            return fault(real, self, *arguments)
        return real(self, *arguments)

    monkeypatch.setattr(fgmres.KrylovSpace, "extend_at_once", extend)
    after_fault(simulation, lasting, tmp_path)
    assert faults


@pytest.mark.parametrize("lasting", [False, True])
def test_a_mesh_that_cannot_be_repaired_is_retried_or_stops_the_run(lasting, start, tmp_path, monkeypatch):
    simulation = start(tmp_path)
    simulation.run(0.008, progress=False)
    real, faults = simulation.remesher.remesh, []

    def remesh(solved):
        if lasting or not faults:
            faults.append(True)
            raise TriangulationError("a triangle was inverted before it could be repaired")
        return real(solved)

    monkeypatch.setattr(simulation.remesher, "remesh", remesh)
    after_fault(simulation, lasting, tmp_path)
    assert faults


def after_fault(simulation, lasting, out):
    """Run on with a fault in the next step, or in all."""
    if not lasting:
        simulation.run(END, progress=False)
        refused = [row["refused_steps"] for row in simulation.history]
        assert sum(refused) == 1
        assert simulation.history[refused.index(1)]["time"] > 0.008
        assert simulation.time == END
        return
    with pytest.raises(tp.SimulationError, match=r"the run stops at t = 0\.008 s"):
        simulation.run(END, progress=False)
    assert finite_checkpoints(out, simulation.case)[-1] == 0.008
    results = tp.read_results(out)
    assert results.summary["status"].startswith("the run stops at t = 0.008 s")
    assert results.times.tolist() == [0.0, 0.008]
    assert results.history["time"][-1] == 0.008


def test_a_state_between_outputs_is_gone_when_the_run_goes_on(start, tmp_path):
    def stop(simulation):
        if simulation.time > WHEN:
            raise KeyboardInterrupt
        return 0.0

    whole = start(tmp_path / "whole", lambda _: 0.0)
    whole.run(END, progress=False)
    out = tmp_path / "stopped"
    with pytest.raises(KeyboardInterrupt):
        start(out, stop).run(END, progress=False)
    assert tp.read_results(out).times[-1] > WHEN  # until then the last state can be looked at
    resumed = tp.Simulation.resume(out, columns={"fault": lambda _: 0.0})
    assert resumed.time > WHEN
    resumed.run(END, progress=False)
    assert (out / "fields.pvd").read_text() == (tmp_path / "whole" / "fields.pvd").read_text()
    names = [sorted(path.name for path in (folder / "fields").iterdir()) for folder in (out, tmp_path / "whole")]
    assert names[0] == names[1]


def test_a_checkpoint_is_written_once_a_step(start, tmp_path, monkeypatch):
    written = []
    real = checkpoint.write_file
    monkeypatch.setattr(
        checkpoint, "write_file", lambda path, content: (written.append(path.name), real(path, content))
    )
    simulation = start(tmp_path)
    simulation.run(0.008, progress=False)  # it ends when one is due
    assert len(written) == len(set(written)) == 3


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_particle_that_is_nowhere_stops_the_run_at_once(start, tmp_path, value):
    simulation = start(tmp_path)
    simulation.step()
    simulation.particles.position[30] = value
    with pytest.raises(tp.SimulationError, match=rf"position of particle 30 at \[{value}, {value}\] is"):
        simulation.step()
    assert simulation.step_number == 1

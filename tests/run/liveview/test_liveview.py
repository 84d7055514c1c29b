"""tipfem/run/liveview: the state in shared memory, and a run that a page watches and steers."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from tipfem.render import Results
from tipfem.render.viewer import protocol
from tipfem.render.viewer.choices import Choices
from tipfem.render.viewer.pane import Pane
from websockets.sync.client import connect

import tipfem as tp
from tipfem.app.commands import draw_state, main
from tipfem.results.folder_lock import FolderLock
from tipfem.run.live import KernelRun
from tipfem.run.liveview.control import RATE, LiveControl, describe, snapshot_of
from tipfem.run.liveview.link import Link
from tipfem.run.liveview.memory import Snapshot, StateMemory
from tipfem.run.liveview.process import guest_of, serve_guest
from tipfem.run.liveview.source import LiveSource
from tipfem.run.steering import FILE, command_from

PATIENCE = 240.0  # longest wait for what must happen [s]


def snapshot(count, value, owned=True):
    """A state whose numbers all say ``value``."""
    return Snapshot(
        step=value,
        time=float(value),
        gravity=(0.0, -float(value)),
        speed=1.0,
        pace=0.5,
        position=np.full((count, 2), float(value)),
        velocity=np.full((count, 2), float(value)),
        pressure=np.full(count, float(value)),
        fluid=np.full(count, value, dtype=np.int32),
        wall=np.zeros(count, dtype=bool),
        cells=np.full((2 * count, 3), value, dtype=np.int32),
        cell_fluid=np.full(2 * count, value, dtype=np.int32) if owned else None,
        poses=np.full((2, 3), float(value)),
    )


@pytest.mark.parametrize("owned", [True, False])
def test_the_latest_state_is_read_as_it_was_written(owned):
    memory = StateMemory()
    assert memory.latest() is None
    other = StateMemory(os.dup(memory.descriptor))
    for value in (1, 2, 3):
        memory.publish(snapshot(10, value, owned))
    found = other.latest()
    assert (found.step, found.time, found.gravity) == (3, 3.0, (0.0, -3.0))
    for name in ("position", "velocity", "pressure", "fluid", "cells", "poses"):
        assert (getattr(found, name) == 3).all()
    assert (found.cell_fluid is None) is not owned
    memory.publish(snapshot(1000, 4, owned))  # more than there was room for
    assert len(other.latest().position) == 1000
    assert other.published == 4
    other.wanted = True
    assert memory.wanted


@pytest.mark.benchmark
def test_to_publish_states_takes_a_run_less_than_a_fiftieth_of_a_core():
    memory, state, times = StateMemory(), snapshot(14_000, 1), []
    for _ in range(30):
        begun = time.thread_time()
        memory.publish(state)
        times.append(time.thread_time() - begun)
    assert RATE * np.median(times) < 0.02


@pytest.mark.slow
def test_no_state_is_read_while_it_is_written():
    """Another process reads as fast as it can; all numbers of a state are the same in every copy."""
    memory = StateMemory()
    memory.publish(snapshot(3000, 1))
    code = (
        "import sys\nfrom tipfem.run.liveview.memory import StateMemory\n"
        "memory, seen = StateMemory(int(sys.argv[1])), set()\n"
        "memory.wanted = True\n"
        "while not memory.ended:\n"
        "    s = memory.latest()\n"
        "    if s is None: continue\n"
        "    seen.add(s.step)\n"
        "    memory.wanted = len(seen) <= 10\n"  # tells the writer that there are enough
        "    for a in (s.position, s.velocity, s.pressure, s.fluid, s.cells, s.cell_fluid, s.poses):\n"
        "        assert (a == s.step).all() and s.time == s.step\n"
        "print(len(seen))\n"
    )
    reader = subprocess.Popen(
        [sys.executable, "-c", code, str(memory.descriptor)], pass_fds=[memory.descriptor], stdout=subprocess.PIPE
    )
    while not memory.wanted:
        time.sleep(0.01)
    begun, value = time.monotonic(), 1
    while time.monotonic() < begun + PATIENCE and (memory.wanted or time.monotonic() < begun + 1.0 or value <= 50):
        value += 1
        memory.publish(snapshot(3000, value))
        assert reader.poll() is None
    memory.ended = True
    assert int(reader.communicate(timeout=PATIENCE)[0]) > 10
    assert reader.returncode == 0
    assert value > 50


def layers(spacing=0.05):
    """Oil on water in a unit tank."""
    water = tp.Fluid("water", density=1000.0, viscosity=1.0)
    oil = tp.Fluid("oil", density=800.0, viscosity=2.0)
    tank = tp.tank((1.0, 1.0), spacing).fill(oil).fill(water, box=((0, 0), (1.0, 0.3)))
    return tp.Case(tank, [water, oil], (0.0, -9.81))


class Client(threading.Thread):
    """A page in a thread: it runs a script of messages beside the simulation, which is in the main thread."""

    def __init__(self, address, script):
        super().__init__(daemon=True)
        self.host, self.port, self.token = re.fullmatch(r"http://([\d.]+):(\d+)/#(.*)", address).groups()
        self.script, self.error = script, None
        self.frames, self.status, self.hello, self.errors, self.bye = 0, {}, {}, [], None
        self.file = b""

    def run(self):
        """Talk to the viewer until the script ends."""
        try:
            with connect(
                f"ws://{self.host}:{self.port}/socket?token={self.token}",
                origin=f"http://{self.host}:{self.port}",
                max_size=None,
                compression=None,
            ) as self.socket:
                self.script(self)
        except BaseException as error:
            self.error = error
            if not self.bye:
                self.failed()

    def failed(self):
        """The script has failed, and nobody is left to end what it watches."""

    def command(self, name, **values):
        """Send a command."""
        self.socket.send(json.dumps({"type": "command", "name": name, **values}))

    def until(self, condition, seconds=PATIENCE):
        """Take messages until a condition holds."""
        end = time.monotonic() + seconds
        while not condition():
            message = self.socket.recv(timeout=max(end - time.monotonic(), 0.01))
            if isinstance(message, bytes):
                head, rest = protocol.unpack(message)
                if head["type"] == "file":
                    self.file = rest
                if head["type"] == "frame":
                    self.frames += 1
                    self.head = head
                    self.socket.send(json.dumps({"type": "ack", "frame": head["frame"]}))
                continue
            found = json.loads(message)
            if found["type"] == "status":
                self.status = found["runs"][0]
            elif found["type"] == "hello":
                self.hello = found
            elif found["type"] == "error":
                self.errors.append(found["text"])
            elif found["type"] == "bye":
                self.bye = found["text"]


def shown(simulation, script=None, **options):
    """The control of a run with a viewer at any port, and a page that runs a script."""
    said = []
    control = LiveControl(simulation, port=0, browser=False, say=said.append, **options)
    assert said[0] == f"Open {control.address}"
    client = Client(control.address, script) if script else None
    if client:
        client.failed = lambda: setattr(control, "stopped", True)  # so that the run ends, and the test tells why
        client.start()
    return control, client


@pytest.mark.slow
def test_a_page_watches_and_steers_a_run_that_is_repeated_to_the_bit(tmp_path):
    def script(page):
        page.until(lambda: page.frames >= 2)
        assert page.hello["live"]
        assert {"pause", "go", "step", "stop", "gravity", "poke", "drop"} <= set(page.hello["commands"])
        page.command("pause")
        page.until(lambda: page.status.get("state") == "paused")
        step = page.status["step"]
        page.command("step", count=2)
        page.until(lambda: page.status["step"] == step + 2)
        page.command("gravity", value=[2.0, -9.6])
        page.until(lambda: page.status["gravity"] == [2.0, -9.6])
        page.command("drop", at=[0.5, 0.95], radius=0.12, fluid="water")
        page.until(lambda: "too close to a wall" in page.status.get("message", ""))
        page.command("drop", at=[0.5, 0.65], radius=0.12, fluid="water")
        page.until(lambda: "message" not in page.status)
        page.command("gravity", value=[0.0, -500.0])
        page.until(lambda: any("at most 98" in text for text in page.errors))
        page.command("poke", at=[0.3, 0.15], acceleration=[30.0, 0.0], radius=0.2)
        page.command("go")
        frames = page.frames
        page.until(lambda: page.frames >= frames + 5)
        page.command("poke", at=None)
        page.until(lambda: page.status["step"] > step + 40)
        page.command("stop")
        page.until(lambda: page.bye)

    simulation = tp.Simulation(layers(), tmp_path / "live", time_step=0.01)
    control, page = shown(simulation, script, rate=20)
    simulation.run(1000.0, progress=False, control=control)
    page.join(PATIENCE)
    assert page.error is None or page.bye, page.error
    assert page.bye == "the run has ended"
    assert json.loads((tmp_path / "live" / "summary.json").read_text())["status"] == "stopped by a command"
    lines = [json.loads(line) for line in (tmp_path / "live" / FILE).read_text().splitlines()]
    assert [line["command"] for line in lines] == ["gravity", "drop", "poke", "poke"]
    again = tp.Simulation(layers(), time_step=0.01, steering=tmp_path / "live" / FILE)
    while again.step_number < simulation.step_number:
        again.step(1000.0)  # the length of steps depends on the time they are to end at
    assert again.particles.position.tobytes() == simulation.particles.position.tobytes()
    plain = [{**row, "wall_seconds": 0} for row in simulation.history]
    assert plain == [{**row, "wall_seconds": 0} for row in again.history]


@pytest.mark.slow
def test_a_run_that_is_watched_is_no_faster_than_it_is_to_be(tmp_path):
    passed = []

    def script(page):
        page.until(lambda: page.frames >= 2)
        begun = time.monotonic()
        page.until(lambda: time.monotonic() > begun + 1.5 and "pace" in page.status)
        passed.append(page.status["pace"])
        page.command("stop")
        page.until(lambda: page.bye)

    simulation = tp.Simulation(layers(0.1), time_step=0.01)
    with pytest.raises(ValueError, match="pace is 0"):
        LiveControl(simulation, port=0, browser=False, pace=0)
    control, page = shown(simulation, script, pace=0.2)
    simulation.run(1000.0, progress=False, control=control)
    page.join(PATIENCE)
    assert page.error is None or page.bye, page.error
    assert 0 < passed[0] < 0.25  # over a second, of which it makes up for 0.2 s


class OneState:
    """What a `LiveSource` reads, with one state."""

    wanted, ended, paused, published = True, False, False, 1

    def __init__(self, state):
        self.state = state

    def latest(self):
        """The state, by way of the shared memory."""
        memory = StateMemory()  # which grows
        memory.publish(self.state)
        return memory.latest()


def test_a_page_changes_the_tensions_that_a_run_has():
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((0.3, 0.2), 0.02).fill(air).fill(water, box=((0, 0), (0.3, 0.1)))
    given = {("water", "air"): 0.07}
    simulation, sent = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81), surface_tension=given)), []
    feed = OneState(snapshot_of(simulation, 1.0))
    source = LiveSource(describe(simulation.case, None), feed, lambda *command: sent.append(command))
    assert source.steered["tension"] == [{"between": ["water", "air"], "value": 0.07}]
    assert "tension" in source.commands
    message = protocol.parse('{"type": "command", "name": "tension", "between": ["water", "air"], "value": 0.03}')
    source.command(message["name"], message["values"])
    simulation.steer(command_from(*sent[-1]))
    assert (simulation.state.parts["surface_tension"].sigma == 0.03).all()
    with pytest.raises(protocol.ProtocolError, match="one or two names"):
        protocol.parse('{"type": "command", "name": "tension", "between": "water", "value": 0.03}')


def test_valves_and_discharges_of_a_run_are_passed_on_from_the_page():
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((0.3, 0.2), 0.02).fill(air).fill(water, box=((0, 0), (0.3, 0.1)))
    openings = [
        tp.Inlet(wall="left", between=((0, 0), (0, 0.1)), fluid=water, discharge=0.01, name="in"),
        tp.Vent(wall="top", between=((0.1, 0.2), (0.2, 0.2)), name="out"),
    ]
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81), openings=openings), time_step=2e-3)
    sent = []
    feed = OneState(snapshot_of(simulation, 1.0))
    source = LiveSource(describe(simulation.case, None), feed, lambda *command: sent.append(command))
    assert source.steered["valve"] == [{"name": "in", "kind": "inlet"}, {"name": "out", "kind": "vent"}]
    assert {"valve", "discharge"} <= source.commands
    assert [gap.kind for gap in source.scene(0).openings] == ["inlet", "vent"]
    for text in (
        '{"type": "command", "name": "valve", "opening": "in", "open": false}',
        '{"type": "command", "name": "discharge", "opening": "in", "value": 0.02}',
    ):
        message = protocol.parse(text)
        source.command(message["name"], message["values"])
        simulation.steer(command_from(*sent[-1]))
    part = simulation.state.parts["openings"]
    assert part.valve.tolist() == [0, -1]
    assert part.discharge[0] == 0.02
    with pytest.raises(protocol.ProtocolError, match="open"):
        protocol.parse('{"type": "command", "name": "valve", "opening": "in", "open": 1}')


def test_bodies_are_drawn_where_the_run_has_them(tmp_path):
    water = tp.Fluid("water", density=1000.0, viscosity=1.0)
    air = tp.Fluid("air", density=1.2, viscosity=1e-3)
    tank = tp.tank((1.0, 0.8), 0.05).fill(air).fill(water, box=((0, 0), (1.0, 0.4)))
    tank.add(tp.Body(tp.shapes.rectangle((0.25, 0.3), (0.5, 0.45)), name="box", density=500.0, angular_velocity=2.0))
    turn = tp.Motion(angle=lambda t: 30.0 * t**2)
    tank.add(tp.Body(tp.shapes.rectangle((0.65, 0.18), (0.85, 0.38)), name="paddle", motion=turn))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0.0, -9.81)), tmp_path / "out", time_step=0.01)
    simulation.run(0.05, progress=False)
    source = LiveSource(describe(simulation.case, None), OneState(snapshot_of(simulation, 1.0)), lambda *_: None)
    box, paddle = source.scene(0).bodies
    poses = simulation.state.parts["bodies"].position
    for body, seen, pose in zip(simulation.case.bodies, (box, paddle), poses, strict=True):
        x, y, angle = pose
        r = (body.corners - body.reference) @ np.array([1, 1j])  # as complex numbers
        assert seen.corners @ np.array([1, 1j]) == pytest.approx(x + 1j * y + r * np.exp(1j * angle), abs=1e-12)
    along = paddle.mark[1] - paddle.mark[0]  # which pointed to the right
    assert np.arctan2(along[1], along[0]) == pytest.approx(30.0 * 0.05**2)
    stored = Results(tmp_path / "out").scene(-1).bodies
    assert box.corners == pytest.approx(stored[0].corners, abs=1e-9)
    entry, _ = Pane(source, "raster").vectors(0, Choices((0.0, 0.0), (1.0, 0.8)))
    assert np.array(entry["turns"]) == pytest.approx(np.array([box.mark, paddle.mark]))


def test_a_periodic_domain_is_drawn_to_its_ends(tmp_path):
    water = tp.Fluid("water", density=1000.0, viscosity=1.0)
    tank = tp.tank((1.0, 0.5), 0.1, periodic="x").fill(water, velocity=lambda x: np.tile([0.5, 0.0], (len(x), 1)))
    simulation = tp.Simulation(tp.Case(tank, [water], (0.0, -9.81)), tmp_path / "out", time_step=0.01)
    simulation.run(0.05, progress=False)
    live = LiveSource(describe(simulation.case, None), OneState(snapshot_of(simulation, 1.0)), lambda *_: None).scene(0)
    stored = Results(tmp_path / "out").scene(-1)
    for scene in (live, stored):
        x = scene.position[scene.cells][..., 0]
        assert np.ptp(x, axis=1).max() < 0.2  # no cell reaches across the domain
        assert x.min() <= 0
        assert x.max() >= 1
        assert (scene.lower[0], scene.upper[0]) == (0.0, 1.0)
    assert len(live.cells) == len(stored.cells)


@pytest.mark.slow
def test_while_nobody_looks_nothing_is_copied():
    simulation = tp.Simulation(layers(), time_step=0.01)
    control, _ = shown(simulation)
    memory = control._memory
    before = memory.published
    simulation.run(0.3, progress=False, control=control)
    assert before == 1
    assert simulation.step_number >= 30
    assert control._process is None  # it ended with the run


def test_no_command_is_dropped_however_many_come_between_two_steps():
    simulation = tp.Simulation(layers(), time_step=0.01)
    control, _ = shown(simulation)
    theirs, (ours, end) = control._link, socket.socketpair()
    control._link = Link(ours)
    try:
        pushes = [{"name": "gravity", "values": {"value": [0.01 * k, -9.0]}} for k in range(500)]
        lines = [*pushes, {"name": "pause", "values": {}}, *pushes, {"name": "drop", "values": {}}]
        end.sendall("".join(json.dumps(line) + "\n" for line in lines).encode())
        found = control._receive_commands(1.0)
    finally:
        control._link.close()
        control._link = theirs
        end.close()
        control.close()
    # Of pushes that follow each other in one step the last counts.
    assert [command.name for command in found] == ["gravity", "pause", "gravity"]
    assert found[0].value == found[2].value == (4.99, -9.0)


@pytest.mark.slow
def test_a_viewer_attaches_to_a_run_begun_without_one_and_again_when_it_died(tmp_path):
    """`tipfem view` finds the run by its folder; while it is shown, another one is told where."""
    out, said, pages = tmp_path / "run", [], []

    def visit(script):
        words = [sys.executable, "-m", "tipfem", "view", str(out), "--no-browser", "--port", "0"]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        said.append(process.stdout.readline().strip())
        pages.append(Client(said[-1].split()[1], script))
        pages[-1].run()
        return process

    def steer(page):
        page.until(lambda: page.frames >= 1)
        page.command("gravity", value=[1.0, -9.0])
        page.until(lambda: page.status["gravity"] == [1.0, -9.0])
        page.command("stop")
        page.until(lambda: page.bye)

    def watched():
        while FolderLock(out).door() is None:
            time.sleep(0.01)
        first = visit(lambda page: page.until(lambda: page.frames >= 2))
        serve_guest(guest_of(out), None, False, said.append)
        first.kill()
        first.wait()
        step = simulation.step_number
        while simulation.step_number < step + 2:  # by which the run knows
            time.sleep(0.01)
        visit(steer).wait(PATIENCE)

    simulation = tp.Simulation(layers(), out, time_step=0.01)
    thread = threading.Thread(target=watched, daemon=True)
    thread.start()
    simulation.run(1000.0, progress=False)
    thread.join(PATIENCE)
    assert [page.error for page in pages if not page.bye] == [None]
    assert pages[0].hello["live"]
    assert pages[1].bye == "the run has ended"
    assert said[0] == said[1] != said[2]
    assert [record.command.name for record in simulation.steering.applied] == ["gravity"]
    assert guest_of(out) is None  # the door has gone with the run


@pytest.mark.slow
@pytest.mark.parametrize("paused", [False, True])
def test_a_viewer_that_is_killed_does_not_hurt_the_run(paused):
    """The run goes on, and a poke that nobody is left to release ends."""

    def script(page):
        page.until(lambda: page.frames >= 1)
        page.command("poke", at=[0.3, 0.15], acceleration=[30.0, 0.0], radius=0.2)
        page.until(lambda: simulation.forces.poke is not None)
        if paused:
            page.command("pause")
            page.until(lambda: page.status["state"] == "paused")
        os.kill(control._process.pid, signal.SIGKILL)
        killed = simulation.step_number
        while simulation.step_number < killed + 10 or simulation.forces.poke is not None:
            time.sleep(0.01)
        control.stopped = True

    simulation = tp.Simulation(layers(), time_step=0.01)
    control, page = shown(simulation, script, rate=20)
    simulation.run(1000.0, progress=False, control=control)
    page.join(PATIENCE)
    assert page.error is None, page.error
    assert simulation.forces.poke is None
    assert [record.command.values()["at"] for record in simulation.steering.applied] == [[0.3, 0.15], None]


def test_what_cannot_be_shown_is_refused_before_any_time_is_spent():
    simulation = tp.Simulation(layers())
    for options, message in (
        ({"rate": 0}, "rate is 0"),
        ({"port": 70000}, "port is 70000"),
        ({"rate": "5"}, "rate is '5'"),
    ):
        with pytest.raises(ValueError, match=message):
            LiveControl(simulation, **options)


@pytest.mark.slow
def test_a_port_that_is_taken_is_named(tmp_path):
    simulation = tp.Simulation(layers())
    control, _ = shown(simulation)
    port = int(re.search(r":(\d+)/", control.address)[1])
    with pytest.raises(ValueError, match=f"port {port}"):
        LiveControl(simulation, port=port, browser=False)
    control.close()


@pytest.mark.slow
def test_the_command_shows_a_run_and_ends_with_it(tmp_path, capfd):
    case = tmp_path / "case.toml"
    case.write_text(
        "gravity = [0, -9.81]\n[fluids.water]\ndensity = 1000.0\nviscosity = 1.0\n[tank]\nsize = [1.0, 1.0]\n"
        'spacing = 0.1\n[[fill]]\nfluid = "water"\n[time]\nend = 0.2\n'
    )
    words = ["run", str(case), "--view", "--no-browser", "--port", "0", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    said = capfd.readouterr().out
    assert re.search(r"^Open http://127\.0\.0\.1:\d+/#\S+$", said, re.MULTILINE)
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["status"] == "complete"
    port = re.search(r":(\d+)/#", said)[1]
    listening = [line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines() if line.split()[3] == "0A"]
    assert f"0100007F:{int(port):04X}" not in listening


def test_a_run_in_a_notebooks_kernel_draws_and_obeys_between_its_steps(tmp_path):
    """As in a notebook: the run and the viewer are tasks of one loop."""
    simulation = tp.Simulation(layers(0.1), tmp_path / "out", time_step=0.01)
    run = KernelRun(simulation, 1000.0, 20.0, False)
    frames, states = [], []

    def take(message):
        if isinstance(message, bytes):
            head, _ = protocol.unpack(message)
            frames.append(head["panes"][0]["time"])
            session.receive(page, json.dumps({"type": "ack", "frame": head["frame"]}))
        elif json.loads(message)["type"] == "status":
            states.append(json.loads(message)["runs"][0])

    async def until(condition):
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, states[-1:]
            await asyncio.sleep(0.01)

    async def both():
        tasks = [asyncio.ensure_future(session.run()), asyncio.ensure_future(run.run())]
        await until(lambda: len(frames) >= 3 and frames[-1] > 0)
        session.receive(page, json.dumps({"type": "command", "name": "pause"}))
        await until(lambda: states[-1]["state"] == "paused")
        step = simulation.step_number
        session.receive(page, json.dumps({"type": "command", "name": "gravity", "value": [1.0, -9.0]}))
        await until(lambda: states[-1]["gravity"] == [1.0, -9.0])
        session.receive(page, json.dumps({"type": "command", "name": "step"}))
        await until(lambda: states[-1]["step"] == step + 1)
        assert simulation.step_number == step + 1
        session.receive(page, json.dumps({"type": "command", "name": "stop"}))
        await asyncio.wait_for(asyncio.gather(*tasks), PATIENCE)

    session = run.view.session
    page = session.attach(take)
    asyncio.run(both())
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["status"] == "stopped by a command"
    assert simulation.forces.gravity == (1.0, -9.0)


def drawing_process(run):
    """Number of the process that draws a run; None while there is none."""
    for number in Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split():
        with contextlib.suppress(OSError):
            if b"tipfem.run.liveview.process" in Path(f"/proc/{number}/cmdline").read_bytes():
                return number
    return None


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="the processes are found in /proc")
@pytest.mark.parametrize(
    ("name", "code"), [("SIGINT", 0), ("SIGTERM", 143), pytest.param("SIGHUP", 129, marks=pytest.mark.slow)]
)
def test_a_signal_while_the_viewer_starts_leaves_no_process(tmp_path, name, code):
    play = Path(__file__).resolve().parents[3] / "demos" / "play.py"
    words = [
        sys.executable,
        str(play),
        "--spacing",
        "0.1",
        "--no-browser",
        "--port",
        "0",
        "--out",
        str(tmp_path / "out"),
    ]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not (drawing := drawing_process(process)):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)
    process.send_signal(getattr(signal, name))
    said, complaints = process.communicate(timeout=PATIENCE)
    assert (process.returncode, complaints) == (code, "")
    assert "Open" not in said
    assert not Path(f"/proc/{drawing}").exists()


@pytest.mark.parametrize("periodic", [None, "x", "xy"])
def test_every_tank_is_drawn_at_its_start(periodic, tmp_path):
    water, oil = tp.Fluid("water", density=1000.0, viscosity=1.0), tp.Fluid("oil", density=800.0, viscosity=2.0)
    tank = tp.tank((0.4, 0.3), 0.03, periodic=periodic).fill(oil).fill(water, disc=((0.1, 0.15), 0.07))
    simulation = tp.Simulation(tp.Case(tank, [water, oil], (0, 0)))
    draw_state(simulation, tmp_path / "initial.png")
    scene = LiveSource(describe(simulation.case, None), OneState(snapshot_of(simulation, 1.0)), lambda *_: None).scene(
        0
    )
    np.testing.assert_allclose([scene.lower, scene.upper], [(0, 0), (0.4, 0.3)], atol=1e-12)


@pytest.mark.slow
def test_a_run_in_three_dimensions_is_seen_kept_and_paused(tmp_path):
    """What a page cannot do there is refused in a sentence; the run goes on."""
    water = tp.Fluid("water", density=1000.0, viscosity=1.0)
    tank = tp.tank((0.6, 0.3, 0.4), 0.1, jitter=0.1).fill(water, box=((0, 0, 0), (0.6, 0.3, 0.2)))
    case = tp.Case(tank, [water], (0, 0, -9.81), free_surface=True)
    simulation = tp.Simulation(case, tmp_path / "run", time_step=0.002)

    def script(page):
        page.until(lambda: page.frames >= 2)
        assert page.hello["panes"][0]["solid"]["up"] == 2
        assert not {"gravity", "poke", "drop"} & set(page.hello["commands"])
        page.command("pause")
        page.until(lambda: page.status.get("state") == "paused")
        page.command("gravity", value=[1.0, 0.0])
        page.until(lambda: page.errors)
        assert "flows in 3-D are pushed, dropped into and tilted from Python only" in page.errors[-1]
        step = page.status["step"]
        page.command("step", count=2)
        page.until(lambda: page.status["step"] == step + 2)
        page.command("viscosity", fluid="water", value=2.0)
        page.command("go")
        page.until(lambda: page.status["step"] > step + 4)
        page.command("pause")
        page.until(lambda: page.status.get("state") == "paused")
        page.command("undo")
        page.until(lambda: page.status["step"] == step + 2)
        page.socket.send('{"type": "share"}')
        page.until(lambda: page.file)
        page.command("stop")
        page.until(lambda: page.bye)

    control, page = shown(simulation, script)
    simulation.run(10.0, progress=False, control=control)
    page.join(PATIENCE)
    assert page.error is None or page.bye, page.error
    assert page.head["panes"][0]["counts"][1] > 100
    assert b'"counts":[[' in page.file

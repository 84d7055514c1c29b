"""A session with a simulation behind it, without sockets: commands, states as they come, and the end."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace

import numpy as np
import pytest
from render_results import sharp_tank, write_results
from tipfem.render import Scene, View
from tipfem.render.renderer import settled
from tipfem.render.viewer import ResultsSource, protocol
from tipfem.render.viewer.choices import Choices
from tipfem.render.viewer.outbox import MOST_MESSAGES, Outbox
from tipfem.render.viewer.pane import Pane
from tipfem.render.viewer.session import Session
from tipfem.render.viewer.showing import Showing


class Flow:
    """A source whose state changes at every look, and which keeps the commands that it is given."""

    name, title, live = "tank", "A tank", True
    fluid_names, fluid_densities, spacing, dimension = ("water", "air"), (998.2, 1.204), 0.025, 2
    commands = frozenset({"pause", "go", "poke", "gravity"})
    limits = {"poke_acceleration": 98.1}  # noqa: RUF012
    interval, ended, tool, steered = 0.05, False, "look", {}

    def __init__(self):
        self.time, self.given, self.closed, self.drawn = 0.0, [], False, 0

    @property
    def times(self):
        return [self.time]

    def refresh(self):
        self.time += 0.01
        return True

    def scene(self, index):
        self.drawn += 1
        points, cells, fluid, cell_fluid, wall = sharp_tank(self.time, 20)
        return Scene(
            position=points,
            cells=cells,
            fluid=fluid,
            cell_fluid=cell_fluid,
            wall=wall,
            fields={"pressure": np.arange(len(points)) * 1.0, "velocity_x": points[:, 1], "velocity_y": -points[:, 0]},
            time=self.time,
            fluid_names=self.fluid_names,
            fluid_densities=self.fluid_densities,
        )

    def status(self):
        return {"state": "running", "step": round(self.time / 0.01)}

    def command(self, name, values):
        if name == "gravity" and abs(values["value"][1]) > 20:
            raise ValueError("gravity: at most 20 m/s^2")
        self.given.append((name, values))

    def close(self):
        self.closed = True


class SlowingFlow(Flow):
    """One that is at rest at first, then fastest, then slower; its air presses at the last time only."""

    live, times = False, (0.0, 0.1, 0.2)

    def scene(self, index):
        scene = super().scene(index)
        speed = np.full(len(scene.position), (0.0, 1.0, 0.5)[index])
        pressure = np.where((scene.fluid == 0) | (index == 2), 5000 * scene.position[:, 0], 0)
        fields = {"pressure": pressure, "velocity_x": speed, "velocity_y": 0 * speed}
        return replace(scene, fields=fields, time=self.times[index])


class Screen:
    """A page without a browser: it keeps what it is sent, and may acknowledge frames."""

    def __init__(self, session, acks=True):
        self.session, self.acks, self.taken = session, acks, []
        self.page = session.attach(self.take)

    def take(self, data):
        message = json.loads(data) if isinstance(data, str) else protocol.unpack(data)[0]
        self.taken.append(message)
        if message["type"] == "frame" and self.acks:
            self.say("ack", frame=message["frame"])

    def say(self, kind, **content):
        self.session.receive(self.page, json.dumps({"type": kind, **content}))

    def of(self, kind):
        return [message for message in self.taken if message["type"] == kind]


def played(script, seconds=120):
    """Run a session of one flow while a script, a coroutine function of both, goes on; it ends the session."""
    flow = Flow()

    async def run():
        session = Session([flow])
        running = asyncio.ensure_future(session.run())
        try:
            await asyncio.wait_for(script(session, flow), seconds)
        finally:
            session.close("that was it")
            await running

    asyncio.run(run())
    return flow


async def until(condition):
    while not condition():
        await asyncio.sleep(0.01)


def test_states_are_shown_as_they_come_and_the_latest_only():
    async def script(session, flow):
        quick, slow = Screen(session), Screen(session, acks=False)
        await until(lambda: len(quick.of("frame")) >= 6)
        assert len(slow.of("frame")) == protocol.AHEAD
        times = [frame["panes"][0]["time"] for frame in quick.of("frame")]
        assert times == sorted(times)
        assert times[-1] > times[0]
        slow.say("ack", frame=slow.of("frame")[-1]["frame"])
        await until(lambda: len(slow.of("frame")) > protocol.AHEAD)
        assert slow.of("frame")[protocol.AHEAD]["frame"] > slow.of("frame")[protocol.AHEAD - 1]["frame"] + 1

    assert played(script).closed


def test_nothing_is_drawn_for_pages_that_are_hidden():
    async def script(session, flow):
        screen = Screen(session)
        await until(lambda: screen.of("frame"))
        screen.say("visible", on=False)
        # What is on its way is still drawn; then the state changes ten times without a picture.
        drawn = -1
        while flow.drawn != drawn:
            drawn, end = flow.drawn, flow.time + 0.1
            await until(lambda end=end: flow.time >= end)
        screen.say("visible", on=True)
        await until(lambda: flow.drawn > drawn)

    played(script)


def test_commands_go_to_the_simulation_and_only_from_the_page_that_steers():
    async def script(session, flow):
        first, second = Screen(session), Screen(session)
        assert first.of("hello")[0]["commands"] == sorted(flow.commands)
        poke = {"at": [0.1, 0.2], "acceleration": [5.0, 0.0], "radius": 0.05}
        first.say("command", name="poke", **poke)
        second.say("command", name="pause")
        first.say("command", name="stop")  # the flow does not take it
        first.say("command", name="gravity", value=[0, -30])
        first.say("command", name="poke", at=[0.1, 0.2], acceleration=[float("1e300"), 0], radius=0.05)
        texts = [message["text"] for message in first.of("error")]
        assert len(texts) == 3
        assert "stop" in texts[0]
        assert texts[1] == "gravity: at most 20 m/s^2"
        assert "acceleration" in texts[2]
        assert flow.given == [("poke", {"at": (0.1, 0.2), "acceleration": (5.0, 0.0), "radius": 0.05})]
        # The page that pokes goes away: the poke ends, and the other page steers.
        session.detach(first.page)
        assert flow.given[1:] == [("poke", {"at": None})]
        assert second.of("role") == [{"type": "role", "steers": True}]
        second.say("command", name="pause")
        assert flow.given[-1] == ("pause", {})

    played(script)


def test_a_run_that_ends_says_goodbye():
    async def script(session, flow):
        screen = Screen(session)
        await until(lambda: screen.of("frame"))
        flow.ended = True
        await until(lambda: screen.of("bye"))
        assert screen.of("bye")[0]["text"] == "the run has ended"

    played(script)


def test_a_time_that_cannot_be_read_is_named_and_the_others_are_shown(tmp_path):
    out = write_results(tmp_path / "broken", (0.0, 0.1, 0.2))
    path = out / "fields" / "step_000001.vtu"
    path.write_bytes(path.read_bytes()[:500])

    async def script():
        session = Session([ResultsSource(out)])
        running = asyncio.ensure_future(session.run())
        screen = Screen(session)
        await until(lambda: screen.of("frame"))
        screen.say("show", time=0.1)
        await until(lambda: screen.of("error"))
        assert "step_000001.vtu" in screen.of("error")[0]["text"]
        screen.say("show", time=0.2)
        await until(lambda: screen.of("frame")[-1]["panes"][0]["index"] == 2)
        screen.say("layers", tracers=20)  # they would be followed through all times
        await until(lambda: len(screen.of("error")) == 2)
        await until(lambda: screen.of("status")[-1]["layers"]["tracers"] == 0)
        session.close("that was it")
        await running

    asyncio.run(asyncio.wait_for(script(), 120))


def test_a_page_that_reads_nothing_is_given_up():
    async def script():
        given_up = []
        outbox = Outbox(lambda: given_up.append(True))
        for _ in range(MOST_MESSAGES):
            outbox.put("status")
        assert not given_up
        outbox.put("status")
        outbox.put("status")
        assert given_up == [True]
        sent = []

        async def send(message):
            sent.append(message)

        passing = asyncio.ensure_future(outbox.pass_on(send))
        await asyncio.sleep(0.01)
        passing.cancel()
        assert sent == []

    asyncio.run(script())


@pytest.mark.parametrize("count", [0, 3])
def test_one_source_or_two(count):
    with pytest.raises(ValueError, match="expected one, or two"):
        Session([Flow()] * count)


def test_arrows_keep_their_scale_from_time_to_time():
    """It grows when a faster time is shown, stays at slower ones, and begins anew in another part of the domain."""
    pane = Pane(SlowingFlow(), "raster")
    choices = Choices((0.0, 0.0), (0.5, 0.5), layers=Choices((0, 0), (1, 1)).layers | {"arrows": True})
    speeds = []
    for index in (2, 1, 2):
        (note,) = pane.vectors(index, choices)[0]["notes"]
        speeds.append(float(note.split(" at ")[1].removesuffix(" m/s")))
    assert speeds == [0.5, 1.0, 1.0]
    choices.show((0.1, 0.1, 0.2, 0.2))
    assert pane.vectors(2, choices)[0]["notes"][0].endswith(" at 0.5 m/s")
    pane.close()


def test_air_is_coloured_from_the_time_on_at_which_its_pressure_varies():
    """Until then it keeps its own colour, unless all fluids are to be coloured; back in time it stays as it is."""
    pane = Pane(SlowingFlow(), "raster")
    choices = Choices((0.0, 0.0), (0.5, 0.5), field="pressure")
    assert [pane.vectors(index, choices)[0]["muted"] for index in (0, 1)] == [("air",), ("air",)]
    choices.layers["colour_all"] = True
    assert not pane.vectors(0, choices)[0]["muted"]
    choices.layers["colour_all"] = False
    assert [pane.vectors(index, choices)[0]["muted"] for index in (0, 2, 0)] == [("air",), (), ()]
    choices.field = "velocity_x"
    assert not pane.vectors(0, choices)[0]["muted"]
    pane.close()


def test_fixed_ranges_are_those_of_pictures():
    """Once all times have been looked at: of all values together, and without the fluids that are not coloured."""
    pane = Pane(SlowingFlow(), "raster")
    scenes = [pane.source.scene(index) for index in range(3)]
    choices = Choices((0.0, 0.0), (0.5, 0.5), field="pressure")
    calm = round(pane.field_range(scenes[0], choices)[1])
    assert any(list(pane.sampling()))
    for choices.field in ("pressure", "velocity_x", "velocity_y"):
        for colour_all in (False, True):
            choices.layers["colour_all"] = colour_all
            view = View(muted=() if colour_all else None)
            expected = settled(view, scenes, choices.field, None)[1]
            for index in (2, 0, 1):  # drawing does not widen them
                pane.vectors(index, choices)
                assert pane.field_range(scenes[index], choices) == expected
    choices.layers["colour_all"], choices.field, choices.range_mode = False, "pressure", "frame"
    assert round(pane.field_range(scenes[0], choices)[1]) == calm
    pane.close()


def test_two_panes_have_the_ranges_of_both():
    class Faster(SlowingFlow):
        def scene(self, index):
            scene = super().scene(index)
            return replace(scene, fields={name: 3 * values for name, values in scene.fields.items()})

    showing = Showing([SlowingFlow(), Faster()], "raster")
    choices = replace(showing.choices, field="velocity_x")
    for pane in showing.panes:
        assert any(list(pane.sampling()))
    ranges = [pane.field_range(pane.source.scene(0), choices) for pane in showing.panes]
    assert ranges == [(-3.0, 3.0)] * 2
    for pane in showing.panes:
        pane.close()


def test_all_times_of_two_results_are_reached():
    """Of a short result and a long one every stored time of either is shown, whichever comes first."""
    short, long = SlowingFlow(), SlowingFlow()
    short.times = (0.0, 0.05)
    for sources in ((short, long), (long, short)):
        showing = Showing(sources, "raster")
        assert showing.times == [0.0, 0.05, 0.1, 0.2]
        assert showing.status()["times"]["count"] == 4
        seen = []
        for _ in range(4):
            seen.append(showing.time)
            showing.step(1)
        assert seen == [0.0, 0.05, 0.1, 0.2]
        assert showing.status()["index"] == 3


def test_playing_and_its_end_are_told_however_short_it_is():
    """A page that is not told of a play would take the next press of its key for the opposite."""

    class Ended(SlowingFlow):
        def status(self):
            return {"state": "complete"}

    async def run():
        session = Session([Ended()])
        running = asyncio.ensure_future(session.run())
        screen = Screen(session)
        await until(lambda: screen.of("frame"))
        screen.say("speed", value=1000.0)
        before = len(screen.of("status"))
        screen.say("play", on=True)
        assert [status["playing"] for status in screen.of("status")[before:]] == [True]
        await until(lambda: not screen.of("status")[-1]["playing"])
        assert screen.of("status")[-1]["index"] == 2
        session.close("that was it")
        await running

    asyncio.run(run())


def test_a_viewer_that_is_to_end_answers_nothing_more(tmp_path):
    """A page that only watches asks for a hundred pictures, of which two are drawn before the signal."""
    write_results(tmp_path, times=(0.0,))
    session, sent = Session([ResultsSource(tmp_path)]), []
    session.attach(lambda message: None)
    page = session.attach(sent.append)
    for number in range(100):
        if number == 2:
            session.close("the viewer was ended")
        session.receive(page, '{"type": "picture"}')
    asyncio.run(session.run())
    assert sum(isinstance(message, bytes) for message in sent) == 2

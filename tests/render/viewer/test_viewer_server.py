"""The viewer's server and session, by a WebSocket client: who gets in, who steers, and what a page is sent."""

from __future__ import annotations

import asyncio
import http.client
import io
import json
import os
import signal
import socket
import time
from pathlib import Path
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from render_results import SIDE, write_results
from tipfem.render import Results, View, render_frame
from tipfem.render.viewer import ResultsSource, protocol
from tipfem.render.viewer.server import ViewServer, open_browser
from tipfem.render.viewer.session import Session
from view_client import PATIENCE, TIMES, Page, start
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect


def asked(server, path, **headers):
    """The answer to a request: its status, headers and body."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
    connection.request("GET", path, headers={"Host": f"127.0.0.1:{server.port}"} | headers)
    answer = connection.getresponse()
    return answer.status, answer.headers, answer.read()


def cpu_seconds(process):
    """CPU time that a process has taken."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


# Who gets in


@pytest.mark.slow
def test_the_page_is_served_and_may_load_nothing_from_elsewhere(server):
    for name, kind in (("/", "text/html"), ("/main.js", "text/javascript"), ("/viewer.css", "text/css")):
        status, headers, body = asked(server, name)
        assert (status, headers["Content-Type"].split(";")[0]) == (200, kind)
        assert int(headers["Content-Length"]) == len(body) > 300
        policy = dict(part.strip().split(" ", 1) for part in headers["Content-Security-Policy"].split(";"))
        assert policy["default-src"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == "'self'"
        assert policy["connect-src"].split() == ["'self'", *(f"{s}://127.0.0.1:{server.port}" for s in ("ws", "wss"))]
        assert server.token.encode() not in body


def test_what_is_sent_is_compressed_for_those_who_can_read_it(server):
    address = f"ws://127.0.0.1:{server.port}/socket?token={server.token}"
    with connect(address, origin=f"http://127.0.0.1:{server.port}") as socket:
        assert [each.name for each in socket.protocol.extensions] == ["permessage-deflate"]


def test_a_page_that_sends_without_end_leaves_the_others_their_turn(tmp_path):
    """Its messages are there at once, so that nothing has to be waited for between them."""

    class Flood:
        transport = SimpleNamespace(abort=lambda: None)
        sent, request = 0, None

        async def __aiter__(self):
            while self.sent < 10_000:
                self.sent += 1
                yield json.dumps({"type": "ack", "frame": 1})

        async def send(self, message):
            pass

    async def turn():
        session = Session([ResultsSource(tmp_path)])
        flood = Flood()
        task = asyncio.ensure_future(ViewServer(session)._receive(flood))
        for _ in range(20):
            await asyncio.sleep(0)
        assert 0 < flood.sent <= 20
        task.cancel()

    write_results(tmp_path, TIMES)
    asyncio.run(turn())


@pytest.mark.parametrize("path", ["/server.py", "/../server.py", "/page/main.js", "/%2e%2e/server.py", "//etc/passwd"])
def test_nothing_else_is_served(server, path):
    assert asked(server, path)[0] == 404


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8800", "127.0.0.1.evil.example", "0.0.0.0:80", "", "a@localhost"]
)
def test_requests_that_name_another_host_are_refused(server, host):
    assert asked(server, "/", Host=host)[0] == 403


@pytest.mark.parametrize(("path", "host"), [("/", "["), ("/", "[::1"), ("//[", "127.0.0.1"), ("//[x]/", "localhost")])
def test_what_is_no_address_is_a_bad_request(server, path, host):
    assert asked(server, path, Host=host)[0] in (400, 403, 404)


def test_a_forwarded_port_is_this_machine_too(server):
    assert asked(server, "/", Host="localhost:9000")[0] == 200


@pytest.mark.parametrize("token", ["", "wrong", "ä", "x" * 4000])
def test_without_the_token_there_is_no_socket(server, token):
    with pytest.raises(InvalidStatus, match="403"):
        Page(server, token=token)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "http://localhost"])
def test_sockets_are_for_the_viewers_own_page(server, origin):
    with pytest.raises(InvalidStatus, match="403"):
        Page(server, origin=origin)


def test_only_this_machine_is_listened_to(server):
    listening = [line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines() if line.split()[3] == "0A"]
    assert f"0100007F:{server.port:04X}" in listening
    assert f"00000000:{server.port:04X}" not in listening


# What a page may say


BAD = [
    "",
    "[]",
    "{}",
    "not JSON",
    '{"type": "nothing"}',
    '{"type": "window", "window": [0, 0, NaN, 1]}',
    '{"type": "window", "window": [0, 0, 1e999, 1]}',
    '{"type": "window", "window": [1, 0, 0, 1]}',
    '{"type": "window", "window": [0, 0, 1e-11, 1e-11]}',
    '{"type": "size", "width": 100000, "height": 10}',
    '{"type": "size", "width": true, "height": 100}',
    '{"type": "speed", "value": -1}',
    '{"type": "show", "time": "0"}',
    '{"type": "show"}',
    '{"type": "show", "time": 0, "more": 1}',
    '{"type": "field", "name": "__class__"}',
    '{"type": "map", "name": "jet"}',
    '{"type": "layers", "contours": "nothing"}',
    '{"type": "layers", "tracers": 1000000}',
    '{"type": "follow", "what": "oil"}',
    '{"type": "range", "mode": "given", "low": 2, "high": 1}',
    '{"type": "pick", "pane": 1, "at": [0, 0]}',
    '{"type": "command", "name": "pause"}',
    '{"type": "command", "name": "poke", "at": [0, 0]}',
    '{"type": "command", "name": "rm"}',
    "[" * 10_000,
]


def test_bad_messages_are_answered_with_an_error_and_change_nothing(page):
    before = page.status
    for text in BAD:
        page.socket.send(text)
        message, _ = page.until("error")
        assert 10 < len(message["text"]) < 300, text
    page.socket.send(b"\x00")
    assert "binary" in page.until("error")[0]["text"]
    page.send("step", count=1)
    page.until("status", lambda status: status["index"] == 1)
    same = ("field", "range", "map", "layers", "window", "follow", "size", "speed")
    assert {name: page.status[name] for name in same} == {name: before[name] for name in same}


def test_a_message_that_is_too_long_ends_its_connection_alone(server, page):
    other = Page(server)
    other.until("hello")
    other.socket.send("x" * (protocol.LARGEST + 1))
    with pytest.raises(ConnectionClosed) as closed:
        other.until("nothing")
    assert closed.value.rcvd.code == 1009
    page.send("step", count=1)
    page.until("status", lambda status: status["index"] == 1)


# What a page is sent


def test_layers_are_those_of_the_window_of_the_page_that_steers(page):
    """Arrows have one distance on the screen, so they are as many in a part of the domain, and stand in it."""
    page.send("layers", arrows=True)
    frame, data = page.until("frame", lambda frame: "lines" in frame["panes"][0])
    (pane,) = frame["panes"]
    assert pane["bytes"] == len(data)
    page.send("window", window=[0.1, 0.1, 0.4, 0.3])
    frame, data = page.until("frame", lambda frame: frame["panes"][0]["notes"] != pane["notes"])
    head = frame["panes"][0]["lines"]
    (sort,) = head["sorts"]
    assert (sort["kind"], sort["each"]) == ("arrows", 2)
    ends = np.frombuffer(data[: head["bytes"]], "<f4").reshape(-1, 2, 2) + np.array(head["origin"])
    assert 20 < len(ends) == sort["count"]
    middles = ends.mean(axis=1)
    assert (middles > [0.1, 0.1]).all()
    assert (middles < [0.4, 0.3]).all()
    scale = (ends[:, 1, 0] - ends[:, 0, 0]) / middles[:, 1]  # the velocity is (y, -x)
    assert scale == pytest.approx(np.full(len(ends), scale.mean()), rel=0.02)


def test_a_frame_that_follows_the_flow_says_its_window(page):
    page.send("follow", what="water")
    frame, _ = page.until("frame", lambda frame: "window" in frame["panes"][0])
    x0, y0, x1, y1 = frame["panes"][0]["window"]
    assert (x1 - x0, y1 - y0) == pytest.approx((SIDE / 3, SIDE / 3))
    assert (x0 + x1) / 2 == pytest.approx(SIDE / 2, abs=0.05)
    page.send("follow", what=None)


def test_a_page_that_does_not_acknowledge_gets_no_queue_and_then_the_newest(page):
    page.frames.clear()
    for index in (1, 2):
        page.send("show", time=TIMES[index])
        while len(page.frames) < index:
            page.receive()
    assert len(page.frames) == protocol.AHEAD
    for index in range(3, 11):
        page.send("show", time=TIMES[index])
    page.send("pick", pane=0, at=[0.2, 0.1])
    page.until("picked", acks=False)  # all that was said before has been read
    page.quiet()
    assert len(page.frames) == protocol.AHEAD
    assert page.frames[-1]["panes"][0]["index"] < 3
    page.send("ack", frame=page.frames[-1]["frame"])
    frame, _ = page.until("frame")
    assert frame["panes"][0]["index"] == 10


def test_another_page_watches_and_steers_when_the_first_dies(server, page):
    other = Page(server)
    hello, _ = other.until("hello")
    assert not hello["steers"]
    other.send("field", name="pressure")
    other.send("pick", pane=0, at=[0.2, 0.1])
    other.until("picked")
    page.send("step", count=3)
    frame, _ = other.until("frame", lambda frame: frame["panes"][0]["index"] == 3)
    assert frame["field"] is None
    # It dies without a word.
    page.socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    page.socket.socket.close()
    assert other.until("role")[0]["steers"]
    other.send("field", name="pressure")
    other.until("frame", lambda frame: frame["field"] == "pressure")
    other.close()


@pytest.mark.slow
def test_playing_goes_through_the_times_and_stops_at_the_end(page):
    page.send("speed", value=0.7)
    page.frames.clear()
    begin = time.monotonic()
    page.send("play", on=True)
    page.until("status", lambda status: status["playing"])
    page.until("status", lambda status: not status["playing"] and status["index"] == len(TIMES) - 1)
    assert TIMES[-1] / 0.7 - 0.1 < time.monotonic() - begin  # a busy machine takes longer
    seen = [frame["panes"][0]["index"] for frame in page.frames]
    assert seen == sorted(seen)
    assert any(0 < index < len(TIMES) - 1 for index in seen)
    assert page.frames[-1]["panes"][0]["index"] == len(TIMES) - 1


def test_values_at_a_point_are_interpolated(page):
    x, y = 0.213, 0.101
    page.send("pick", pane=0, at=[x, y])
    found, _ = page.until("picked")
    assert found["fluid"] == "water"
    assert found["values"]["velocity_x"] == pytest.approx(y)  # the velocity is linear: (y, -x)
    assert found["values"]["velocity_y"] == pytest.approx(-x)
    assert found["values"]["speed"] == pytest.approx(np.hypot(x, y))
    assert found["values"]["density"] == 998.2
    particle = found["particle"]
    assert particle["values"]["velocity_x"] == pytest.approx(particle["position"][1])
    assert np.hypot(*np.subtract(particle["position"], [x, y])) < SIDE / 24
    page.send("pick", pane=0, at=[-1, 0.1])
    outside, _ = page.until("picked")
    assert not outside["inside"]
    assert outside["values"] == {}


def test_a_history_has_the_values_at_all_times(page):
    page.send("pick", pane=0, at=[0.25, 0.27], history=True)
    history, _ = page.until("history", lambda message: message["done"] == 1)
    assert history["times"] == pytest.approx(TIMES)
    assert history["values"]["velocity_x"] == pytest.approx([0.27] * len(TIMES))
    assert {1.204, 998.2} == set(history["values"]["density"])  # the wave passes by


@pytest.mark.parametrize("colour_all", [False, True])
def test_a_picture_to_keep_is_that_of_the_renderer(server, page, colour_all):
    """Air of even pressure keeps its own colour in both, unless all fluids are to be coloured."""
    page.send("field", name="pressure")
    page.send("range", mode="given", low=0, high=2500)
    page.send("window", window=[0.1, 0.1, 0.4, 0.3])
    page.send("layers", mesh=True, colour_all=colour_all)
    page.send("step", count=2)
    page.until("frame", lambda frame: frame["panes"][0]["muted"] == ([] if colour_all else ["air"]))
    page.send("picture")
    head, data = page.until("file")
    assert (head["name"], head["mime"]) == ("wave_pressure_0.2000s.png", "image/png")
    expected = render_frame(
        Results(server.out).scene(2),
        field="pressure",
        field_range=(0, 2500),
        mesh=True,
        size=(1280, 720),
        view=View(window=(0.1, 0.1, 0.4, 0.3), muted=() if colour_all else None),
        backend="raster",
    )
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(data))), expected)
    words = "--field pressure --range 0 2500 --mesh --window 0.1 0.1 0.4 0.3" + " --colour-all" * colour_all
    page.until_status(lambda status: status["command"].endswith(words))


def test_a_movie_is_as_long_as_it_was_seen(page, tmp_path):
    asked = time.monotonic()
    page.send("record", on=True)
    page.until("status", lambda status: status["recording"])
    begin = time.monotonic()
    for _ in range(4):
        page.send("step", count=1)
        page.until("frame")
        time.sleep(0.1)
    page.send("record", on=False)
    seconds = time.monotonic() - begin
    head, data = page.until("file")
    whole = time.monotonic() - asked
    assert (head["name"], head["mime"]) == ("wave.mp4", "video/mp4")
    (tmp_path / "movie.mp4").write_bytes(data)
    frames, length = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "movie.mp4"))
    assert length == pytest.approx(frames / 25, abs=0.05)
    assert seconds - 0.2 < length < whole + 0.2


def test_tracers_are_followed_from_the_first_time(page):
    page.send("layers", tracers=50)
    page.send("show", time=TIMES[5])
    page.until(
        "frame", lambda frame: frame["panes"][0]["index"] == 5 and frame["panes"][0]["notes"] == ["paths of tracers"]
    )


def test_nothing_is_done_while_nothing_happens(server, page):
    """What was asked for before may take its time on a busy machine; then nothing is sent, and no time is used."""
    for _ in range(20):
        before = cpu_seconds(server.process)
        if page.quiet(1.5) == [] and cpu_seconds(server.process) - before < 0.06:
            return
    pytest.fail("the viewer keeps sending or computing")


@pytest.mark.slow
def test_two_results_are_shown_at_equal_times_and_a_signal_ends_the_viewer(tmp_path):
    first = write_results(tmp_path / "first", (0.0, 0.1, 0.2, 0.3))
    second = write_results(tmp_path / "second", (0.0, 0.2))
    running = start(first, second)
    page = Page(running)
    hello, _ = page.until("hello")
    assert [pane["name"] for pane in hello["panes"]] == ["first", "second"]
    page.send("show", time=0.2)
    frame, data = page.until("frame", lambda frame: frame["panes"][0]["index"] == 2)
    assert [pane["index"] for pane in frame["panes"]] == [2, 1]
    assert [pane["time"] for pane in frame["panes"]] == [0.2, 0.2]
    assert sum(pane["bytes"] for pane in frame["panes"]) == len(data)
    # The run of the first goes on.
    write_results(tmp_path / "more", (0.0, 0.1, 0.2, 0.3, 0.4))
    for path in (tmp_path / "more" / "fields").iterdir():
        if not (first / "fields" / path.name).exists():
            path.rename(first / "fields" / path.name)
    (tmp_path / "more" / "fields.pvd").replace(first / "fields.pvd")
    page.until("status", lambda status: status["times"]["count"] == 5)
    running.process.send_signal(signal.SIGTERM)
    assert "ended" in page.until("bye")[0]["text"]
    assert running.process.wait(PATIENCE) == 0


def test_what_cannot_be_shown_is_said_in_a_line(tmp_path, capfd):
    from tipfem.app.commands import main

    assert main(["view", str(tmp_path / "none")]) == 2
    assert "there is no such folder" in capfd.readouterr().err
    out = write_results(tmp_path / "out", (0.0,))
    assert main(["view", str(out), "--port", "99999"]) == 2
    assert "--port is 99999" in capfd.readouterr().err
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert main(["view", str(out), "--port", str(taken.getsockname()[1])]) == 2
    assert "cannot be used" in capfd.readouterr().err
    json.loads((out / "case.json").read_text())


def test_the_browser_is_not_told_the_token_in_its_command_line(monkeypatch):
    """It opens a file that only the user can read, which leads to the address."""
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    door = open_browser("http://127.0.0.1:8800/#secret")
    try:
        assert opened == [door.as_uri()]
        assert door.stat().st_mode & 0o077 == 0
        assert 'content="0; url=http://127.0.0.1:8800/#secret"' in door.read_text()
    finally:
        door.unlink()

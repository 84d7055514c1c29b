"""A viewer's page, served to this machine alone.

The server listens on 127.0.0.1. The page itself is public to this machine; what it shows is not: the WebSocket takes
only those who know the token in the address that was printed, which browsers do not pass on, and which is new for each
viewer. Requests must name this machine in their Host header, which a page elsewhere that has its name resolve to
127.0.0.1 cannot, and WebSockets must come from the viewer's own page.
"""

from __future__ import annotations

import asyncio
import contextlib
import getpass
import os
import secrets
import signal
import socket
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from tipfem.render.viewer import protocol
from tipfem.render.viewer.outbox import Outbox
from tipfem.render.viewer.page_files import FILES, page_file
from tipfem.render.viewer.session import Session
from tipfem.render.viewer.source import Source

if TYPE_CHECKING:
    from websockets.asyncio.server import Server as WebSocketServer
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

PORT = 8800
_PORTS_TRIED = 20
HOSTS = frozenset({"127.0.0.1", "localhost", "[::1]"})
MOST_PAGES = 16


class ViewServer:
    """Serves a session; `open` it, run the session, then `close` it.

    Pages must know the token. For ``port`` see `serve`; after `open` it is the one in use.
    """

    def __init__(self, session: Session, port: int | None = None) -> None:
        self.session = session
        self.port = PORT if port is None else port
        self.token = secrets.token_urlsafe(24)
        self._tries = _PORTS_TRIED if port is None else 1
        self._files = {name: page_file(name) for name in FILES}
        self._server: WebSocketServer | None = None
        self._outboxes: set[Outbox] = set()

    async def emptied(self) -> None:
        """Wait until the pages have been sent what they were told, goodbyes among them; not for ever."""
        await asyncio.sleep(0.1)
        for outbox in list(self._outboxes):
            await outbox.emptied()

    @property
    def address(self) -> str:
        """Address of the page, with the token where browsers keep it to themselves."""
        return f"http://127.0.0.1:{self.port}/#{self.token}"

    async def open(self) -> None:
        """Listen; `ValueError` if the port is taken, or websockets is not installed."""
        serve = _websockets_server()
        for attempt in range(self._tries):
            port = self.port + attempt
            try:
                self._server = await serve(
                    self._receive,
                    "127.0.0.1",
                    port,
                    process_request=self._answer,
                    max_size=protocol.LARGEST,
                    max_queue=64,
                    compression=None,  # other than that of `_websockets_server`
                    open_timeout=10,
                    ping_interval=20,
                    ping_timeout=60,
                    server_header=None,
                )
                self.port = next(iter(self._server.sockets)).getsockname()[1]
                return
            except OSError as error:
                if attempt + 1 == self._tries:
                    text = f"port {port} of 127.0.0.1 cannot be used: {error.strerror}; name another"
                    raise ValueError(text) from None

    async def close(self) -> None:
        """Stop listening, and disconnect the pages."""
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request with a file or a refusal; None lets a WebSocket open."""
        host = request.headers.get("Host", "")
        try:
            known = urlsplit(f"//{host}").netloc == host and _without_port(host) in HOSTS
            parts = urlsplit(request.path)
        except ValueError:  # no address, such as "[" or "//["
            return _response(400, "Bad Request", b"that is no address\n")
        if not known:
            return _response(403, "Forbidden", b"this viewer answers to 127.0.0.1 and localhost only\n")
        if parts.path == "/socket":
            given = parse_qs(parts.query).get("token", [""])[0]
            if request.headers.get("Origin") not in (f"http://{host}", f"https://{host}"):
                return _response(403, "Forbidden", b"the WebSocket is for the viewer's own page\n")
            if not secrets.compare_digest(given.encode(), self.token.encode()):
                return _response(403, "Forbidden", b"the token is wrong: open the address that was printed\n")
            if len(self.session.pages) >= MOST_PAGES:
                return _response(503, "Service Unavailable", b"too many pages look at this viewer\n")
            return None
        name = "index.html" if parts.path == "/" else parts.path[1:]
        if name not in self._files:
            return _response(404, "Not Found", b"there is no such file\n")
        return _response(200, "OK", self._files[name], FILES[name], host)

    async def _receive(self, connection: ServerConnection) -> None:
        from websockets.exceptions import ConnectionClosed

        outbox = Outbox(connection.transport.abort)
        self._outboxes.add(outbox)
        passing = asyncio.ensure_future(outbox.pass_on(connection.send))
        page = self.session.attach(outbox.put)
        try:
            async for text in connection:
                self.session.receive(page, text)
                await asyncio.sleep(0)  # a page that sends without end leaves the others their turn
        except ConnectionClosed:
            pass
        finally:
            self.session.detach(page)
            self._outboxes.discard(outbox)
            passing.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                await passing


def serve(
    sources: Sequence[Source],
    port: int | None = None,
    browser: bool = True,
    say: Callable[[str], None] = print,
    backend: str = "raster",
) -> None:
    """Show sources to browsers on this machine, until a source ends, or the process is interrupted or terminated.

    Args:
        sources: one, or two that are compared at equal times.
        port: of 127.0.0.1; 0 for any, None for 8800 or one of the next.
        browser: open a browser where there is a display.
        say: takes lines of text: the address, and how to reach it from another machine.
        backend: of the pictures, see `tipfem.render.Renderer`.

    Raises:
        ValueError: a source cannot be drawn, the port is taken, or websockets is not installed.
    """
    _websockets_server()
    asyncio.run(_serve(sources, port, browser, say, backend))


async def _serve(
    sources: Sequence[Source], port: int | None, browser: bool, say: Callable[[str], None], backend: str
) -> None:
    session = Session(sources, backend)
    server = ViewServer(session, port)
    await server.open()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        with contextlib.suppress(ValueError, RuntimeError):  # not in the main thread
            loop.add_signal_handler(number, session.close, "the viewer was ended")
    say(f"Open {server.address}")
    say(forwarding(server.port))
    door: Path | None = None
    if browser and _has_display() and not any(source.ended for source in sources):
        door = await asyncio.to_thread(open_browser, server.address)
    try:
        await session.run()
        await server.emptied()
    finally:
        await server.close()
        if door is not None:
            door.unlink(missing_ok=True)


def open_browser(address: str) -> Path:
    """Open a browser on a file, of the user alone, that leads to the address; returns the file.

    The address holds the token, which other users would read in the browser's command line.
    """
    number, name = tempfile.mkstemp(prefix="tipfem-view-", suffix=".html")  # readable by its owner alone
    page = (
        '<!doctype html><meta charset="utf-8"><title>tipfem</title>'
        f'<meta http-equiv="refresh" content="0; url={address}"><a href="{address}">tipfem</a>\n'
    )
    with os.fdopen(number, "w", encoding="utf-8") as file:
        file.write(page)
    webbrowser.open(Path(name).as_uri())
    return Path(name)


def forwarding(port: int) -> str:
    """Instruction for reaching a port of 127.0.0.1 from another machine."""
    ours = os.environ.get("SSH_CONNECTION", "").split()
    host = ours[2] if len(ours) == 4 else socket.gethostname()
    return f"From another machine: ssh -L {port}:127.0.0.1:{port} {_user()}{host}, then open the same address there"


def _user() -> str:
    try:
        return getpass.getuser() + "@"
    except (KeyError, OSError):  # a user without a name, as in some containers
        return ""


def _has_display() -> bool:
    if os.environ.get("SSH_CONNECTION"):
        return False
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def _without_port(host: str) -> str:
    name, colon, port = host.rpartition(":")
    return name.lower() if colon and port.isdigit() else host.lower()


def _websockets_server() -> Any:
    try:
        from websockets.asyncio.server import serve as opened
        from websockets.extensions.permessage_deflate import ServerPerMessageDeflateFactory
    except ImportError:
        raise ValueError("the viewer needs websockets, which is not installed: pip install 'tipfem[view]'") from None
    quick = ServerPerMessageDeflateFactory(compress_settings={"level": 1})  # a state with a field becomes a third
    return partial(opened, extensions=[quick])


def _response(
    status: int, reason: str, body: bytes, kind: str = "text/plain; charset=utf-8", host: str = ""
) -> Response:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    # 'self' does not cover WebSockets in all browsers.
    sockets = f" ws://{host} wss://{host}" if host else ""
    return Response(
        status,
        reason,
        Headers(
            {
                "Content-Type": kind,
                "Content-Length": str(len(body)),
                "Connection": "close",
                "Cache-Control": "no-store",
                "Content-Security-Policy": (
                    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
                    f"connect-src 'self'{sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
                ),
                "Cross-Origin-Opener-Policy": "same-origin",
                "Cross-Origin-Resource-Policy": "same-origin",
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
            }
        ),
        body,
    )

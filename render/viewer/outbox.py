"""Messages on their way to one page: few, or the page is given up."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

MOST_MESSAGES = 200
MOST_BYTES = 256_000_000  # a movie is one message
PATIENCE = 2.0  # longest wait for the last messages [s]


class Outbox:
    """Takes messages without waiting, and passes them on one after another.

    Frames are not held up here: no more are put in than the page acknowledges. What is left, such as the status, piles
    up only for a page that reads nothing; then ``give_up`` is called once.
    """

    def __init__(self, give_up: Callable[[], None]) -> None:
        self._give_up = give_up
        self._messages: asyncio.Queue[str | bytes] = asyncio.Queue(MOST_MESSAGES)
        self._bytes = 0
        self.given_up = False

    def put(self, message: str | bytes) -> None:
        """Take a message."""
        if self.given_up:
            return
        if self._messages.full() or self._bytes + len(message) > MOST_BYTES:
            self.given_up = True
            self._give_up()
            return
        self._messages.put_nowait(message)
        self._bytes += len(message)

    async def pass_on(self, send: Callable[[str | bytes], Awaitable[None]]) -> None:
        """Send what is put in, until cancelled or given up; ``send`` waits until a message is on its way."""
        while not self.given_up:
            message = await self._messages.get()
            await send(message)
            self._bytes -= len(message)
            self._messages.task_done()

    async def emptied(self) -> None:
        """Wait until all has been sent; not for ever."""
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._messages.join(), PATIENCE)

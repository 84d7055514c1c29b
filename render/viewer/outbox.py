"""Messages on their way to one page: few, or the page is given up."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable

MOST_MESSAGES = 200
MOST_BYTES = 256_000_000  # a movie is one message


class Outbox:
    """Takes messages without waiting, and passes them on one after another.

    Frames are not held up here: no more are put in than the page acknowledges. What is left, such as the status, piles
    up only for a page that reads nothing; then ``give_up`` is called once.
    """

    def __init__(self, give_up: Callable[[], None]) -> None:
        self._give_up = give_up
        self._messages: deque[str | bytes] = deque()
        self._bytes = 0
        self._filled = asyncio.Event()
        self.given_up = False

    def put(self, message: str | bytes) -> None:
        """Take a message."""
        if self.given_up:
            return
        if len(self._messages) >= MOST_MESSAGES or self._bytes + len(message) > MOST_BYTES:
            self.given_up = True
            self._messages.clear()
            self._give_up()
            return
        self._messages.append(message)
        self._bytes += len(message)
        self._filled.set()

    async def pass_on(self, send: Callable[[str | bytes], Awaitable[None]]) -> None:
        """Send what is put in, until cancelled; ``send`` waits until a message is on its way."""
        while True:
            await self._filled.wait()
            while self._messages:
                message = self._messages.popleft()
                await send(message)
                self._bytes -= len(message)
            self._filled.clear()

    async def emptied(self) -> None:
        """Wait until all has been sent; not for ever."""
        for _ in range(200):
            if not self._messages:
                return
            await asyncio.sleep(0.01)

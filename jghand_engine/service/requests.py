"""The requests of one client: taken in the order in which they came, canceled by their number. No socket here."""

from __future__ import annotations

import threading
from collections import deque

from jghand_engine.service.protocol import Message

# requests of a client that wait; one more is read when one is taken
REQUESTS_WAITING_MAX = 16


class Requests:
    """A queue between the thread that reads a client's messages and the one that answers them."""

    def __init__(self) -> None:
        self._waiting: deque[Message] = deque()
        self._changed = threading.Condition()
        self._running: Message | None = None
        self._canceled = False
        self._over = False

    def put(self, message: Message) -> None:
        """Adds a request; waits while too many wait already, so that a client that floods is slowed down."""
        with self._changed:
            self._changed.wait_for(lambda: self._over or len(self._waiting) < REQUESTS_WAITING_MAX)
            if not self._over:
                self._waiting.append(message)
                self._changed.notify_all()

    def come(self, within_s: float) -> bool:
        """Waits for the next request or the client's leaving; False when neither came in time. Nothing runs now."""
        with self._changed:
            self._running = None
            return self._changed.wait_for(lambda: self._over or bool(self._waiting), within_s)

    def take(self) -> Message | None:
        """Waits for the next request, which is running from now on; None when the client is gone."""
        with self._changed:
            self._running = None
            self._changed.wait_for(lambda: self._over or bool(self._waiting))
            if self._over:
                return None
            self._running, self._canceled = self._waiting.popleft(), False
            self._changed.notify_all()
            return self._running

    def cancel(self, identity: object) -> bool:
        """Cancels a request. True: it waited, will not run, and is to be answered so; False: it runs, and is told to
        stop, or there is none of this number (any more)."""
        with self._changed:
            for message in self._waiting:
                if message.header.get("id") == identity:
                    self._waiting.remove(message)
                    self._changed.notify_all()
                    return True
            if self._running is not None and self._running.header.get("id") == identity:
                self._canceled = True
            return False

    def end(self) -> None:
        """The client is gone: nobody wants what waits, nor what runs."""
        with self._changed:
            self._over = self._canceled = True
            self._waiting.clear()
            self._changed.notify_all()

    @property
    def running_id(self) -> object:
        """The number of the request that runs; None while there is none."""
        running = self._running
        return running.header.get("id") if running is not None else None

    def is_canceled(self) -> bool:
        """Whether the running request is to stop."""
        return self._canceled

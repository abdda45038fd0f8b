"""Time as this process has lived through it."""

from __future__ import annotations

import time
from collections.abc import Callable

#: Longest time between two looks at the clock that a process at work lets pass, seconds.
_LOOK_S = 2.0


class WakingTime:
    """A clock that stands still while its process is stopped, as far as a caller who looks at it often can tell.

    Who was stopped for a minute (SIGSTOP, a frozen container) has seen nothing of that minute, and must not blame the
    silence on others, who may have been stopped with it.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._last = clock()
        self._lived = 0.0

    def __call__(self) -> float:
        """Seconds since the beginning; of the time between two calls no more than `_LOOK_S` count."""
        now = self._clock()
        self._lived += min(now - self._last, _LOOK_S)
        self._last = now
        return self._lived

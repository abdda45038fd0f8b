"""Clips, drawn by a process of its own ahead of the people who will see them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from rrm.environ import environment
from rrm.files import make_folder
from rrm.teachers.published import ShownSegment

#: So often may a clip end the process that draws it.
_TRIES = 3
#: Between two attempts where nothing draws, seconds.
_AGAIN_S = 5.0


class Wanted(NamedTuple):
    """What a clip shows."""

    path: Path  #: file of the published session
    segment: ShownSegment


class Clips:
    """The sprites there are, and those still to be drawn."""

    def __init__(self, folder: Path, say: Callable[[str], None]) -> None:
        """Args: say: told once of whatever keeps clips from being drawn."""
        self._folder, self._say = folder, say
        self.facts: dict[str, dict[str, Any]] = {}  #: of each clip that is drawn, by segment
        self.refused: dict[str, str] = {}  #: segments that cannot be shown, and why
        self.trouble = ""  #: why nothing at all is drawn now
        self._wanted: dict[str, Wanted] = {}
        self._urgent: list[str] = []
        self._jobs: asyncio.Queue[tuple[dict[str, Any], asyncio.Future[dict[str, Any]]]] = asyncio.Queue()
        self._changed = asyncio.Condition()
        self._child: asyncio.subprocess.Process | None = None

    def want(self, wanted: Iterable[Wanted]) -> None:
        """Draw these, in this order; forget all others."""
        self._wanted = {each.segment.id: each for each in wanted}
        for gone in set(self.facts) - set(self._wanted):
            del self.facts[gone]
            self.path(gone).unlink(missing_ok=True)

    def path(self, segment: str) -> Path:
        """Where a clip lies once it is drawn."""
        return self._folder / f"{segment}.webp"

    def wants(self, segment: str) -> bool:
        """Whether a clip is still to be drawn."""
        return segment in self._wanted and segment not in self.refused

    async def drawn(self, segment: str, patience_s: float) -> bool:
        """Wait for a clip, which is drawn before all others; False where it is not there in time, or never will be."""
        if segment not in self._wanted:
            return False
        self._urgent.append(segment)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(patience_s), self._changed:
                await self._changed.wait_for(lambda: segment in self.facts or segment in self.refused)
        return segment in self.facts

    async def make(self, **asked: Any) -> dict[str, Any]:
        """Have the process make something else, see `rrmctl.labelling.renderer`, and give its answer."""
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        await self._jobs.put((asked, answer))
        return await answer

    async def work(self) -> None:
        """Draw until cancelled."""
        shutil.rmtree(self._folder, ignore_errors=True)  # of a server that died
        make_folder(self._folder)
        try:
            while True:
                if not self._jobs.empty():
                    asked, answer = self._jobs.get_nowait()
                    answer.set_result(await self._ask(asked))
                elif segment := self._next():
                    await self._draw(segment)
                else:
                    await asyncio.sleep(0.05)
        finally:
            await self._end()
            shutil.rmtree(self._folder, ignore_errors=True)

    def _next(self) -> str | None:
        open_ = (each for each in (*self._urgent, *self._wanted) if each in self._wanted)
        return next((each for each in open_ if each not in self.facts and each not in self.refused), None)

    async def _draw(self, segment: str) -> None:
        path, shown = self._wanted[segment]
        told = await self._ask({
            "path": str(path), "episode": shown.episode, "begin": shown.begin, "out": str(self.path(segment)),
        })  # fmt: skip
        if "trouble" in told:
            if told["trouble"] != self.trouble:
                self._say(told["trouble"])
            self.trouble = told["trouble"]
            await self._end()  # it would not look again
            await asyncio.sleep(_AGAIN_S)
            return
        self.trouble = ""
        async with self._changed:
            if "refused" in told:
                self.refused[segment] = told["refused"]
                self._say(
                    f"a clip of {path} cannot be shown: {told['refused']}; --skip-unshown lets its run go on without"
                )
            else:
                self.facts[segment] = told
            self._urgent = [each for each in self._urgent if each != segment]
            self._changed.notify_all()

    async def _ask(self, asked: dict[str, Any]) -> dict[str, Any]:
        for _ in range(_TRIES):
            child = self._child = self._child or await self._start()
            assert child.stdin is not None
            assert child.stdout is not None
            with contextlib.suppress(OSError, ValueError):
                child.stdin.write(json.dumps(asked).encode() + b"\n")
                await child.stdin.drain()
                if line := await child.stdout.readline():
                    told: dict[str, Any] = json.loads(line)
                    return told
            await self._end()
        log = (self._folder / "log").read_text(errors="replace").strip().splitlines() or ["it was killed"]
        return {"refused": f"the process that draws ended {_TRIES} times: {log[-1]}"}

    async def _start(self) -> asyncio.subprocess.Process:
        with (self._folder / "log").open("wb") as log:
            return await asyncio.create_subprocess_exec(
                sys.executable, "-m", "rrmctl.labelling.renderer", env=environment(), stderr=log,
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, start_new_session=True,
            )  # fmt: skip

    async def _end(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            with contextlib.suppress(ProcessLookupError):
                child.kill()
            await child.wait()

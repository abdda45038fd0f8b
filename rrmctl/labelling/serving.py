"""Listening, and serving until a study is over or somebody stops it."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable

import uvicorn

from rrmctl.errors import UserError
from rrmctl.labelling.guard import LARGEST_HEAD
from rrmctl.labelling.office import Office
from rrmctl.labelling.server import application

LOOPBACK = ("127.0.0.1", "localhost")


def listen(host: str, port: int) -> socket.socket:
    """A socket that takes connections from now on. Raises UserError where it cannot be had."""
    sock = socket.socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        sock.bind((host, port))
        sock.listen(128)
    except (OSError, OverflowError) as error:
        sock.close()
        reason = getattr(error, "strerror", None) or str(error)
        raise UserError(f"cannot listen at {host}:{port}: {reason}", "--port 0 takes any port that is free") from error
    return sock


def serve(office: Office, sock: socket.socket, host: str, left: Callable[[], bool] = lambda: False) -> None:
    """Until every run of the study has ended, or `left` says so. A signal's own handler has the last word."""
    hosts = list(dict.fromkeys((*LOOPBACK, host)))
    config = uvicorn.Config(
        application(office, hosts), http="h11", ws="none", loop="asyncio", lifespan="off", log_config=None,
        log_level="error", access_log=False, server_header=False, date_header=False, proxy_headers=False,
        h11_max_incomplete_event_size=LARGEST_HEAD, timeout_graceful_shutdown=1,
    )  # fmt: skip
    server = uvicorn.Server(config)
    office.closing = lambda: server.should_exit

    async def leave() -> None:
        while not left():
            await asyncio.sleep(0.2)

    async def main() -> None:
        serving = asyncio.create_task(server.serve(sockets=[sock]))
        others = [asyncio.create_task(each) for each in (office.work(), office.clips.work(), leave())]
        try:
            ended, _ = await asyncio.wait([serving, *others], return_when=asyncio.FIRST_COMPLETED)
            server.should_exit = True
            await serving
            for task in ended:
                task.result()
        finally:
            for task in others:
                task.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await task

    asyncio.run(main())

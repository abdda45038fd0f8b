"""What every request must be, and what every answer says to the browser, before anything else looks at either."""

from __future__ import annotations

from typing import TYPE_CHECKING

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

LARGEST = 4096  #: bytes of a request's body
LARGEST_HEAD = 1 << 14  #: bytes of what stands before it

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Guard:
    """Refuses requests of other pages, of other kinds and of other sizes than this page's own."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def sealed(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        status = _refusal(scope["method"], Headers(scope=scope))
        app = self._app if status is None else JSONResponse({"message": "refused"}, status)
        await app(scope, receive, sealed)


def _refusal(method: str, headers: Headers) -> int | None:
    if sum(len(name) + len(value) for name, value in headers.raw) > LARGEST_HEAD:
        return 431
    reads = method in ("GET", "HEAD")
    length = headers.get("content-length", "0" if reads else "")
    if "transfer-encoding" in headers or not length.isdecimal() or len(length) > 9 or int(length) > LARGEST:
        return 413
    if not reads:
        if headers.get("origin") != f"http://{headers.get('host', '')}":
            return 403
        if headers.get("content-type", "").partition(";")[0].strip() != "application/json":
            return 415
    return None

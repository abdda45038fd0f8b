"""The server: the page, its clips and its five questions, over HTTP on this machine."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from rrm.teachers.labels import PRACTICE, SECOND, SHARED
from rrmctl.errors import UserError
from rrmctl.labelling.desk import RefusedError
from rrmctl.labelling.guard import Guard
from rrmctl.labelling.question import Claim, Given, Sitting
from rrmctl.labelling.words import TASKS, better

if TYPE_CHECKING:
    from starlette.requests import Request

    from rrmctl.labelling.office import Office

PAGE = Path(__file__).parent / "page"
_FILES = {"/": "index.html", "/page.js": "page.js", "/page.css": "page.css", "/icon.svg": "icon.svg"}
_KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_ID = re.compile(r"[0-9a-f]{16}")
#: A question that is not there yet is waited for so long, seconds; a clip likewise.
_PATIENCE_S = 20.0
#: A request that waits looks so often, seconds.
_LOOK_S = 0.1

#: Whose progress is counted by itself.
_ROUNDS = {PRACTICE: 0, SHARED: 1}

_Name = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]


class _Asked(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Session(_Asked):
    token: Annotated[str, Field(min_length=1, max_length=200)]


class _Held(_Asked):
    held: Annotated[list[_Name], Field(max_length=8)] = []


class _Claim(_Held):
    patient: bool = False  #: whether a question that is not there yet is waited for


class _Answer(_Asked):
    claim: _Name
    chosen: Literal["left", "right", "equal", "skip"]
    latency_ms: Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
    loops: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
    speed: Annotated[float, Field(gt=0, le=100, allow_inf_nan=False)]
    input: Literal["key", "pointer"]


class _Undo(_Asked):
    claim: _Name | None = None


_Model = TypeVar("_Model", bound=_Asked)


def application(office: Office, hosts: list[str]) -> Starlette:
    """The ASGI application; `hosts` are names under which it answers."""

    def sitting(request: Request) -> Sitting:
        scheme, _, key = request.headers.get("authorization", "").partition(" ")
        known = office.keys.sitting(key) if scheme == "Bearer" else None
        if known and not office.ready and request.url.path != "/api/claim":  # it does not know yet what was asked
            raise HTTPException(503, "the server is starting")
        if known is None:
            raise HTTPException(401, "this page is not known here (any more): open a new link")
        return known

    async def body(request: Request, model: type[_Model]) -> _Model:
        try:
            return model.model_validate(json.loads(await request.body()))
        except (ValidationError, ValueError, RecursionError):
            raise HTTPException(422, "not what this server understands") from None

    async def session(request: Request) -> Response:
        given = office.admit((await body(request, _Session)).token)
        if given is None:
            raise HTTPException(403, "this link was opened already: take the new one that the server printed")
        return JSONResponse({"key": given})

    async def claim(request: Request) -> Response:
        me, asked = sitting(request), await body(request, _Claim)
        deadline = time.monotonic() + (_PATIENCE_S if asked.patient else 0.0)
        while True:
            if office.over:
                return JSONResponse({"state": "over"})
            if office.clips.trouble:
                return JSONResponse({"state": "trouble", "message": office.clips.trouble})
            if found := office.desk.claim(me, asked.held):
                return JSONResponse(describe(me, found))
            if time.monotonic() >= deadline or office.closing() or await request.is_disconnected():
                return JSONResponse(office.waiting(me))
            await asyncio.sleep(_LOOK_S)

    def describe(me: Sitting, claim: Claim) -> dict[str, Any]:
        question = claim.question
        sides = [question.query.first, question.query.second]
        if claim.left == SECOND:
            sides.reverse()
        done, of = office.desk.progress(me, question.purpose)
        return {
            "state": "question", "claim": claim.id, "clips": [side.id for side in sides],
            "returns": [side.true_return for side in sides] if office.desk.rules.hint else None,
            "task": TASKS.get(question.session.task, question.session.task), "practice": question.purpose == PRACTICE,
            "round": _ROUNDS.get(question.purpose), "done": done, "of": of,
        }  # fmt: skip

    async def answer(request: Request) -> Response:
        me, asked = sitting(request), await body(request, _Answer)
        given = Given(asked.chosen, asked.latency_ms, asked.loops, asked.speed, asked.input)
        row = office.answer(me, asked.claim, given)
        done, of = office.desk.progress(me, row.purpose)
        return JSONResponse({"done": done, "of": of, "better": better(row) if row.purpose == PRACTICE else None})

    async def undo(request: Request) -> Response:
        me, asked = sitting(request), await body(request, _Undo)
        return JSONResponse(describe(me, office.desk.undo(me, asked.claim or "")))

    async def renew(request: Request) -> Response:
        me, held = sitting(request), (await body(request, _Held)).held
        return JSONResponse({"held": office.desk.renew(me, held)})

    async def clip(request: Request) -> Response:
        sitting(request)
        name = request.path_params["name"]
        if not _ID.fullmatch(name):
            raise HTTPException(404, "no such clip")
        if not await office.drawn(name, _PATIENCE_S):
            gone = name in office.clips.refused
            raise HTTPException(410 if gone else 503, "it cannot be shown" if gone else "it is not drawn yet")
        facts = json.dumps(office.clips.facts[name])
        return FileResponse(office.clips.path(name), media_type="image/webp", headers={"Clip": facts})

    posts = {"session": session, "claim": claim, "answer": answer, "undo": undo, "renew": renew}
    return Starlette(
        routes=[
            *(Route(path, _file(name)) for path, name in _FILES.items()),
            *(Route(f"/api/{name}", handler, methods=["POST"]) for name, handler in posts.items()),
            Route("/clips/{name}.webp", clip),
        ],
        middleware=[Middleware(Guard), Middleware(TrustedHostMiddleware, allowed_hosts=hosts, www_redirect=False)],
        exception_handlers={HTTPException: _plain, RefusedError: _conflict, UserError: _unstored},
    )


def _file(name: str) -> Callable[[Request], Response]:
    data, kind = (PAGE / name).read_bytes(), _KINDS[Path(name).suffix]
    return lambda _request: Response(data, media_type=kind)


async def _plain(_request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"message": error.detail}, error.status_code)


async def _conflict(_request: Request, error: Exception) -> Response:
    return JSONResponse({"message": str(error)}, 409)


async def _unstored(_request: Request, error: Exception) -> Response:
    return JSONResponse({"message": f"the answer could not be stored: {error}"}, 507)

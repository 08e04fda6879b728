"""The bridge's web server: the page, its WebSocket, downloads of takes, uploads of motion files."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Awaitable, Callable
from pathlib import Path
from urllib.parse import quote

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from motiongen_client.errors import InvalidInput, MotiongenError
from motiongen_tools.view.access import Access, Role, is_own_page
from motiongen_tools.view.bridge import Bridge
from motiongen_tools.view.browser import Browser
from motiongen_tools.view.character import Character
from motiongen_tools.view.constraint_list import moved, read_list
from motiongen_tools.view.motion_files import FOLDER_PREFIX, MAX_BYTES, read_upload
from motiongen_tools.view.page_files import PAGE, content_policy
from motiongen_tools.view.recording import write_take
from motiongen_tools.view.session_file import parse_session
from motiongen_tools.view.wire import pack_motion

DENIED = 4401
"""Close code of a WebSocket whose token is wrong."""
UNKNOWN_ROOM = 4400
"""Close code of a WebSocket whose room cannot be had. Pages treat both as final, and show the reason."""
MOST_REASON_BYTES = 123
"""Most bytes of the reason in a close frame; more is an error of the protocol."""
_OWN_FILE = re.compile(rf"[^\s'\"]*{FOLDER_PREFIX}\w+/[\w.-]+")
MOST_HEADER_SIGNS = 800
MOST_DIGITS = 15
"""Most digits of a frame number; Python refuses to read thousands."""
MOST_MADE_AT_ONCE = 2
"""Most files converted at the same time, each by a process of its own: anyone who watches may ask for any number."""
MARGIN_S = 0.6
"""How much may be committed while a list of constraints is sent and takes effect."""
LEAST_MARGIN_FRAMES = 12

_log = logging.getLogger(__name__)


def web_app(bridge: Bridge, access: Access, three: Path) -> Starlette:
    """The application. three: the folder of the npm package."""

    making = asyncio.Semaphore(MOST_MADE_AT_ONCE)

    async def socket(websocket: WebSocket) -> None:
        host = websocket.headers.get("host", "")
        role = access.role_of(websocket.query_params.get("token", ""))
        await websocket.accept()  # a page cannot see the reason of an earlier refusal
        if role is None or not is_own_page(websocket.headers.get("origin"), host):
            await websocket.close(DENIED, "the token is missing or wrong, or the page belongs to another site")
            return
        try:
            room = bridge.room(websocket.query_params.get("room", "main"))
        except InvalidInput as error:
            await websocket.close(UNKNOWN_ROOM, str(error).encode()[:MOST_REASON_BYTES].decode(errors="ignore"))
            return
        try:
            await Browser(websocket, bridge, room, role).serve()
        except WebSocketDisconnect:
            return

    async def take(request: Request) -> Response:
        room = bridge.room(request.path_params["room"])
        character = room.character(request.path_params["character"])
        name = request.path_params["name"]
        query = request.query_params
        first, end = (_frame(query.get(key, "")) for key in ("first", "end"))
        async with making:
            data, media_type, warnings = await write_take(character, name, first, end)
        told = {
            "Content-Disposition": f"attachment; filename*=UTF-8''{quote(name, safe='')}",
            "X-Warnings": _header(" ".join(warnings)),
        }
        return Response(data, media_type=media_type, headers=told)

    async def open_motion(request: Request) -> Response:
        name = request.query_params.get("name", "")
        rigs = bridge.line.client.catalog.rigs
        data = await _body(request)
        async with making:
            motion = await asyncio.to_thread(read_upload, name, data, rigs)
        return Response(pack_motion(Path(name).name, motion), media_type="application/octet-stream")

    async def load(request: Request) -> Response:
        data, name = await _body(request), request.query_params.get("name", "the file")
        recorded = await asyncio.to_thread(parse_session, data, name)  # there may be thousands of edits
        number = await bridge.room(request.path_params["room"]).again(recorded, {})
        return JSONResponse({"numbers": [number]})

    async def aim(request: Request) -> Response:
        character = bridge.room(request.path_params["room"]).character(request.path_params["character"])
        max_path_frames = bridge.line.client.catalog.limits.max_trajectory_frames
        data, rig = await _body(request), character.session.rig
        found = await asyncio.to_thread(read_list, data, rig, max_path_frames)  # there may be thousands
        specs = moved(found, _first_free(character))
        entry = character.tell({"op": "add_constraints", "constraints": specs})
        return JSONResponse({"entry": entry.number, "count": len(specs)})

    def guarded(answer: Callable[[Request], Awaitable[Response]], *roles: Role) -> Callable[..., Awaitable[Response]]:
        async def check(request: Request) -> Response:
            headers = request.headers
            if not is_own_page(headers.get("origin"), headers.get("host", ""), headers.get("sec-fetch-site")):
                return PlainTextResponse("the page belongs to another site", status_code=403)
            token = headers.get("authorization", "").removeprefix("Bearer ")
            if access.role_of(token) not in roles:
                return PlainTextResponse("the token is missing, or for spectators only", status_code=401)
            try:
                return await answer(request)
            except MotiongenError as error:
                return JSONResponse({"error": _said(error, request)}, status_code=400)
            except ClientDisconnect:
                return PlainTextResponse("the client is gone", status_code=400)
            except Exception:
                _log.exception("a request of a page failed")
                return JSONResponse({"error": "the bridge failed to do this; its log says why"}, status_code=500)

        return check

    return Starlette(
        routes=[
            WebSocketRoute("/ws", socket),
            Route("/take/{room}/{character:int}/{name}", guarded(take, Role.CONTROL, Role.WATCH)),
            Route("/motion", guarded(open_motion, Role.CONTROL), methods=["POST"]),
            Route("/session/{room}", guarded(load, Role.CONTROL), methods=["POST"]),
            Route("/constraints/{room}/{character:int}", guarded(aim, Role.CONTROL), methods=["POST"]),
            Mount("/three", StaticFiles(directory=three)),
            Mount("/", StaticFiles(directory=PAGE, html=True)),
        ],
        middleware=[Middleware(_Guard, access=access)],
    )


def _said(error: MotiongenError, request: Request) -> str:
    """The text of an error, with the name that the page knows instead of that of a temporary file."""
    name = request.query_params.get("name") or request.path_params.get("name") or "the file"
    return _OWN_FILE.sub(lambda _: name, str(error))


def _frame(text: str) -> int | None:
    return int(text) if text.isdecimal() and len(text) <= MOST_DIGITS else None


def _header(text: str) -> str:
    """A text that can be sent in a header: one line of ASCII of limited length."""
    return " ".join(text.encode("ascii", "replace").decode().split())[:MOST_HEADER_SIGNS]


def _first_free(character: Character) -> int:
    """The frame that stands for a list's frame 0: one that can surely still change when the message arrives."""
    session, playback = character.session, character.session.playback
    margin_frames = max(session.rig.frames_in(MARGIN_S), LEAST_MARGIN_FRAMES)
    return max(playback.committed_to, playback.playhead) + margin_frames


async def _body(request: Request) -> bytes:
    if int(request.headers.get("content-length", MAX_BYTES + 1)) > MAX_BYTES:
        raise InvalidInput("file", "more", f"at most {MAX_BYTES >> 20} MiB")
    return await request.body()


class _Guard:
    """Refuses requests for hosts other than ours, and adds to every answer what a page may load."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access
        self._headers = [
            (b"content-security-policy", content_policy().encode()),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-resource-policy", b"same-origin"),
            (b"cache-control", b"no-cache"),
        ]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        hosts = [value.decode("latin-1") for name, value in scope.get("headers", []) if name == b"host"]
        if scope["type"] == "http" and not (hosts and self._access.admits_host(hosts[0])):
            refusal = PlainTextResponse("this bridge is for localhost; --listen opens it to others", status_code=421)
            await refusal(scope, receive, send)
            return
        if scope["type"] == "websocket" and not (hosts and self._access.admits_host(hosts[0])):
            await send({"type": "websocket.close", "code": 1008})
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *self._headers]
            await send(message)

        await self._app(scope, receive, with_headers)

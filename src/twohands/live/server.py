"""The server of the live page: one page, one WebSocket, no files (docs/stream.md)."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import replace
from typing import Any, Final

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from twohands.errors import InputError
from twohands.inference.frames import Frame
from twohands.live.clip import LiveClip
from twohands.live.door import Door
from twohands.live.messages import MAX_BYTES, Begin, Measure, Settings, parse_text, picture_message
from twohands.live.worker import News, Picture, Worker

MAX_CLIENTS: Final = 8
GOING, UNREADABLE, REFUSED, FULL = 1001, 1007, 1008, 1013
"""Codes with which a WebSocket is closed: the server ends, a picture that cannot be used, against the rules, too many
clients."""
_MAX_REASON_BYTES: Final = 123
_MAX_CONNECTIONS: Final = 64
_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class _Client:
    """One open WebSocket.

    Attributes:
        pictures: whether it wants them.
        count: of pictures that it has sent in its clip.
    """

    def __init__(self, pictures: bool) -> None:
        self.pictures = pictures
        self.count = 0
        self._newest: News | None = None
        self._note: str | None = None
        self._end: tuple[int, str] | None = None
        self._woken = asyncio.Event()

    def offer(self, news: News) -> None:
        """The newest frame; one that has not been sent yet is dropped, and so is what is said of measuring."""
        self._newest = news
        if news.note is not None and news.note[0] is self:
            self._note = news.note[1]
        self._woken.set()

    def end(self, code: int, reason: str) -> None:
        """Close it."""
        self._end = self._end or (code, reason)
        self._woken.set()

    async def send_all(self, websocket: WebSocket) -> None:
        """Sends what is offered, until it is to be closed."""
        header: str | None = None
        while True:
            await self._woken.wait()
            self._woken.clear()
            if self._end is not None:
                await websocket.close(self._end[0], _short(self._end[1]))
                return
            news, self._newest = self._newest, None
            if news is None:
                continue
            if news.header is not header:
                header = news.header
                await websocket.send_text(header)
            if self.pictures and news.picture is not None and news.sender is not self:
                age_s = time.monotonic() - news.taken
                await websocket.send_bytes(picture_message(news.picture, news.time_s, age_s))
            await websocket.send_text(news.line)
            note, self._note = self._note, None
            if note is not None:
                await websocket.send_text(note)


class _Server(uvicorn.Server):
    """Uvicorn, which lets us close our WebSockets before it does."""

    def __init__(self, goodbye: Callable[[], Awaitable[None]], config: uvicorn.Config) -> None:
        super().__init__(config)
        self._goodbye = goodbye

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await self._goodbye()
        await super().shutdown(sockets)


class LiveServer:
    """Serves the page and the stream until it is told to end.

    Args:
        clip: estimates.
        door: who may come.
        page: the page's HTML.
        policy: its Content-Security-Policy.
        camera: frames of this machine's camera, and its name; None where pages send pictures.
    """

    def __init__(
        self,
        clip: LiveClip,
        door: Door,
        page: str,
        policy: str,
        camera: tuple[str, Iterable[Frame]] | None = None,
    ) -> None:
        self._clip, self._door, self._page = clip, door, page
        self._page_headers = _HEADERS | {"Content-Security-Policy": policy}
        self._camera = camera
        self._clients: set[_Client] = set()
        self._sender: _Client | None = None
        self._error: BaseException | None = None
        routes = [Route("/", self._show_page), WebSocketRoute("/stream", self._stream)]
        self._server = _Server(
            self._say_goodbye,
            uvicorn.Config(
                Starlette(routes=routes),
                log_level="critical",
                access_log=False,
                lifespan="off",
                server_header=False,
                ws_max_size=MAX_BYTES,
                ws_per_message_deflate=False,
                limit_concurrency=_MAX_CONNECTIONS,
                timeout_graceful_shutdown=2,
            ),
        )

    def run(self, listening: socket.socket, started: Callable[[], None] = lambda: None) -> None:
        """Serves on a socket that listens already, until a signal comes or the camera ends.

        Args:
            listening: bound to where clients come.
            started: called once pages are answered.

        Raises:
            KeyboardInterrupt: Ctrl-C, when all is closed.
            TwoHandsError: what ended the estimating.
        """
        asyncio.run(self._serve(listening, started))
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """Ends it, from any thread."""
        self._server.should_exit = True

    async def _serve(self, listening: socket.socket, started: Callable[[], None]) -> None:
        loop = asyncio.get_running_loop()

        def later(function: Callable[..., None], *arguments: Any) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(function, *arguments)

        self._worker = Worker(
            self._clip,
            publish=lambda news: later(self._publish, news),
            refuse=lambda client, reason: later(client.end, UNREADABLE, reason),
            ended=self._take_end,
            camera=None if self._camera is None else self._camera[1],
            wanted=lambda: any(client.pictures for client in self._clients.copy()),
        )
        with self._worker:
            listening.listen()
            started()  # whoever comes now waits until the server takes over
            await self._server.serve(sockets=[listening])

    def _take_end(self, error: BaseException | None) -> None:
        self._error = error
        self.stop()

    async def _say_goodbye(self) -> None:
        for client in self._clients:
            client.end(GOING, "twohands live has ended")
        for _ in range(20):
            if self._clients:
                await asyncio.sleep(0.05)

    async def _show_page(self, request: Request) -> Response:
        refusal = self._door.refusal(request.headers, request.query_params.get("token"))
        if refusal is not None:
            return PlainTextResponse(f"refused: {refusal}\n", 403, _HEADERS)
        return HTMLResponse(self._page, headers=self._page_headers)

    async def _stream(self, websocket: WebSocket) -> None:
        refusal = self._door.refusal(websocket.headers, websocket.query_params.get("token"))
        if refusal is not None:
            await websocket.close(REFUSED, _short(refusal))  # before it is accepted: 403
            return
        await websocket.accept()
        if len(self._clients) >= MAX_CLIENTS:
            await websocket.close(FULL, f"{MAX_CLIENTS} clients are connected already")
            return
        client = _Client(websocket.query_params.get("pictures") == "1")
        self._clients.add(client)
        tasks = [
            asyncio.create_task(each) for each in (client.send_all(websocket), self._receive_all(websocket, client))
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._clients.discard(client)
            if self._sender is client:
                self._sender = None
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _receive_all(self, websocket: WebSocket, client: _Client) -> None:
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                raise WebSocketDisconnect()
            text, data = message.get("text"), message.get("bytes")
            try:
                if text is not None:
                    self._take_text(client, text)
                elif data is not None:
                    self._take_picture(client, data)
            except InputError as error:
                client.end(REFUSED, str(error))
                await asyncio.Event().wait()  # nothing more is read; ends with the closing

    def _take_text(self, client: _Client, text: str) -> None:
        asked = parse_text(text)
        if self._camera is None and self._sender not in (None, client):
            raise InputError("another client is sending pictures; one camera at a time")
        if isinstance(asked, Begin):
            client.count = 0
            self._sender = client if self._camera is None else None
            self._worker.begin(asked.settings if self._camera is None else _renamed(asked.settings, self._camera[0]))
        elif isinstance(asked, Measure):
            if self._camera is None and self._sender is not client:
                raise InputError("a clip must begin first")
            self._worker.measure(client, asked.distance_m)
        else:
            self._sender = None

    def _take_picture(self, client: _Client, data: bytes) -> None:
        if self._sender is not client:
            own = self._camera is not None
            raise InputError("pictures come from this machine's camera" if own else "a clip must begin first")
        self._worker.put(Picture(data, client.count, client))
        client.count += 1

    def _publish(self, news: News) -> None:
        for client in self._clients:
            client.offer(news)


def listen(host: str, port: int) -> socket.socket:
    """A socket bound to an address; port 0 for any free one.

    Raises:
        InputError: somebody listens there already, or the address is not this machine's.
    """
    if not 0 <= port < 1 << 16:
        raise InputError(f"--port must lie between 0 and 65535, got {port}")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        bound = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:
        raise InputError(f"{host}:{port}: cannot be used ({getattr(error, 'strerror', None) or error})") from None
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(address)
    except OSError as error:
        bound.close()
        raise InputError(f"{host}:{port}: cannot be used ({error.strerror}); try another --port") from None
    return bound


def _renamed(settings: Settings, source: str) -> Settings:
    return replace(settings, source=source)


def _short(reason: str) -> str:
    """As much of it as a WebSocket's closing frame holds."""
    return reason.encode()[:_MAX_REASON_BYTES].decode(errors="ignore")

"""The page's server: HTTP and a socket on this machine alone, for whoever has the token."""

import asyncio
import hmac
import ipaddress
import json
import secrets
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import jax
import numpy as np
from tornado import httpserver, netutil, web, websocket

from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..studies.schema import SceneFile
from ..studies.text_limits import LARGEST
from . import files, messages
from .ahead import Ahead
from .complaints import complaint, told
from .page_text import program, text_of
from .session import Session

PAGE = Path(__file__).with_name("page")
PORTS = range(8420, 8440)
MOST_WAITING = 500  # messages of a page
MOST_PAGES = 16
QUIET = 3.0  # s after a message: as long nothing is compiled that no page waits for
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; "
    "frame-ancestors 'self' http://localhost:* http://127.0.0.1:*",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


def is_loopback(host: str) -> bool:
    """Whether a host's name or address is this machine's own."""
    try:
        return host == "localhost" or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class Line:
    """A thread of a page's own, which sees to its messages in turn: of several in a row that replace each other to the
    last alone."""

    def __init__(self, double: bool) -> None:
        self._ended = False
        self._waiting: deque[tuple[Callable[[], object] | None, Any]] = deque()
        self._changed, self._double = threading.Condition(), double
        threading.Thread(target=self._run, daemon=True).start()

    def add(self, does: Callable[[], object] | None, replaces: Any = None) -> bool:
        """Sees to something when its turn comes; None: ends. Whether there was room for it, and it has not ended."""
        with self._changed:
            if self._ended:
                return False
            self._ended = does is None
            if replaces is not None and self._waiting and self._waiting[-1][1] == replaces:
                self._waiting.pop()
            elif does is not None and len(self._waiting) >= MOST_WAITING:
                return False
            self._waiting.append((does, replaces))
            self._changed.notify()
        return True

    def _run(self) -> None:
        with jax.enable_x64(self._double):
            while (does := self._next()) is not None:
                try:
                    does()
                except Exception:  # of the program's own: the page goes on
                    traceback.print_exc()

    def _next(self):
        with self._changed:
            self._changed.wait_for(lambda: self._waiting)
            return self._waiting.popleft()[0]


class Explorer:
    """A server of pages about one scene.

    scene: that of the file, or one that has none. address: of this machine's own; port: None for the first free one of
    8420 to 8439, 0 for any. Raises ArgumentError for an address that is not loopback, OSError where no port is free.
    """

    def __init__(
        self, scene: Scene, file: SceneFile | None, address: str, port: int | None, token: str | None = None
    ) -> None:
        if not is_loopback(address):
            raise ArgumentError("address", "must be this machine's own, as 127.0.0.1", address)
        self.scene, self.file, self.token = scene, file, token or secrets.token_urlsafe(32)
        self.pages: dict[str, Socket] = {}
        self._sockets = _bound(address, port)
        self.port = self._sockets[0].getsockname()[1]
        host = f"[{address}]" if ":" in address else address
        self.url = f"http://{host}:{self.port}/?token={self.token}"
        self._begun = threading.Event()
        self.last = 0.0  # s: when a page last asked anything
        self.ahead = Ahead(scene, self._is_quiet)

    async def serve(self) -> None:
        """Serves until `stop`."""
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        self._begun.set()
        given = {"explorer": self}
        routes = [
            (r"/", Page, given),
            (r"/(panel\.js|page\.js|page\.css)", Asset, given),
            (r"/socket", Socket, given),
            (r"/take/([\w-]+)/([\w.]+)", Take, given),
        ]
        settings: dict[str, Any] = {"websocket_max_message_size": LARGEST + 4096, "websocket_ping_interval": 20}
        settings |= {"default_handler_class": Missing, "default_handler_args": given}
        server = httpserver.HTTPServer(web.Application(routes, **settings), max_body_size=4096, max_header_size=65536)
        server.add_sockets(self._sockets)
        try:
            await self._end.wait()
        finally:
            for page in list(self.pages.values()):
                page.close()
            server.stop()

    def stop(self) -> None:
        """Ends serving, from any thread; pages see that the server has gone."""
        self._begun.wait()
        self._loop.call_soon_threadsafe(self._end.set)
        self.ahead.end()

    def _is_quiet(self):
        return time.monotonic() - self.last > QUIET

    def allows(self, request: Any) -> bool:
        """Return True if a request has the token, and comes from this machine under its own name."""
        given = request.query_arguments.get("token", [b""])[-1]
        return hmac.compare_digest(given, self.token.encode()) and is_loopback(host_of(f"//{request.host}"))


def host_of(url: str) -> str:
    """The host that a text from outside names as a URL does, without its port; "" if it names none."""
    return (urlsplit(url).hostname or "") if is_url(url) else ""


def is_url(text: str) -> bool:
    """Return True if a text from outside can be read as a URL: Python raises for some, as for half a bracket."""
    try:
        return bool(urlsplit(text))
    except ValueError:
        return False


def _bound(address, port):
    for one in PORTS if port is None else [port]:
        try:
            return netutil.bind_sockets(one, address)
        except OSError as error:
            last = error
    raise OSError(last.errno, f"no port is free at {address} ({last.strerror})")


class Guarded(web.RequestHandler):
    """Refuses what has no token, or comes under another name than this machine's."""

    def initialize(self, explorer: Explorer) -> None:
        self.explorer = explorer

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        if not self.explorer.allows(self.request):
            raise web.HTTPError(403)

    def write_error(self, status_code: int, **given: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        known = {403: "this page needs the address with its token, which jaxvibro view prints"}
        self.finish(f"{status_code}: {known.get(status_code, self._reason)}\n")


class Missing(Guarded):
    """An address at which there is nothing."""

    def prepare(self) -> None:
        super().prepare()
        raise web.HTTPError(404)


class Page(Guarded):
    """The page itself."""

    def get(self) -> None:
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish((PAGE / "index.html").read_text().replace("TOKEN", self.explorer.token))


class Asset(Guarded):
    """What the page is made of."""

    def get(self, name: str) -> None:
        kind = "text/css" if name.endswith("css") else "text/javascript"
        self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.finish((PAGE / name).read_bytes())


class Take(Guarded):
    """A file of what a page shows: scene.toml, lines.py, data.zip, or a panel's picture."""

    async def get(self, page: str, name: str) -> None:
        socket = self.explorer.pages.get(page)
        if socket is None or socket.session is None:
            raise web.HTTPError(404)
        session = socket.session
        loop, done = asyncio.get_running_loop(), asyncio.get_running_loop().create_future()

        def work():
            try:
                found = content(name, session), None
            except Exception as error:  # whatever it was, the request is answered
                found = None, error
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(done.set_result, found)

        if not socket.line.add(work):
            raise web.HTTPError(503)
        found, error = await done
        if error is not None:
            self.set_status(400)
            self.finish(f"{complaint(error)['text']}\n")
            return
        self.set_header("Content-Type", "application/octet-stream")
        self.set_header("Content-Disposition", f'attachment; filename="{name}"')
        self.finish(found)


def content(name: str, session: Session) -> bytes:
    """The content of a file that can be taken. Raises ArgumentError for others."""
    now, results = session.shown, session.results
    if name == "scene.toml":
        if session.file is None:
            raise ArgumentError("scene.toml", "must be of a scene that can be written: its force has no name", name)
        return text_of(now, session.file).encode()
    if name == "lines.py":
        return program(now, results, session.file).encode()
    if name == "data.zip":
        return files.archive(now, results)
    panel, _, kind = name.partition(".")
    return files.picture(panel, kind, now, results, session.screen)


class Socket(websocket.WebSocketHandler):
    """A page's socket: JSON both ways. When it closes, the page's work ends."""

    def initialize(self, explorer: Explorer) -> None:
        self.explorer, self.name = explorer, secrets.token_urlsafe(9)
        self.session: Session | None = None

    def prepare(self) -> None:
        origins = (self.request.headers.get(name, "") for name in ("Origin", "Sec-Websocket-Origin"))
        if not (self.explorer.allows(self.request) and all(map(is_url, origins))):  # tornado reads them as URLs
            raise web.HTTPError(403)
        if len(self.explorer.pages) >= MOST_PAGES:
            raise web.HTTPError(503)

    def check_origin(self, origin: str) -> bool:
        """A page of this server alone."""
        return urlsplit(origin).netloc == self.request.host

    def open(self) -> None:
        self.set_nodelay(True)
        loop, double = asyncio.get_running_loop(), bool(self.explorer.scene.dtype == np.float64)

        def push(record):
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._send, messages.written(record))

        self.line = Line(double)
        given = self.explorer.file, self.explorer.scene, push, self.line.add
        self.session = Session(*given, self.explorer.ahead.ready.wait)
        self.explorer.pages[self.name] = self
        self._send(json.dumps({"kind": "page", "name": self.name}))

    def _send(self, text):
        with suppress(websocket.WebSocketClosedError):
            self.write_message(text)

    def on_message(self, text: str | bytes) -> None:
        try:
            message = messages.read(text)
        except ArgumentError as error:
            self._send(json.dumps(complaint(error)))
            self._send(json.dumps({"kind": "answer", "number": messages.number_of(text)}))
            return
        session, self.explorer.last = self.session, time.monotonic()
        if session is not None and not self.line.add(lambda: session.receive(message), message.replaces):
            self._send(json.dumps(told("too much at once: the last was left out")))
            self._send(json.dumps({"kind": "answer", "number": message.number}))

    def on_close(self) -> None:
        self.explorer.pages.pop(self.name, None)
        if self.session is not None:
            self.session.close()
            self.line.add(None)

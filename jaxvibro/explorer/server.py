"""Serve pages over HTTP and a WebSocket, on this machine only and with a token."""

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
from ..studies.scene_file import MAX_BYTES
from ..studies.schema import SceneFile
from . import downloads, messages
from .messages import error_record, message_record
from .page_display import program_text, scene_file_text
from .precomputation import PrecomputationThread
from .session import Session

PAGE_FOLDER = Path(__file__).with_name("page")
PORTS = range(8420, 8440)
MAX_QUEUED = 500  # queued messages per page
MAX_PAGES = 16
IDLE_TIME = 3.0  # s after the last message before idle compilation starts
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; "
    "frame-ancestors 'self' http://localhost:* http://127.0.0.1:*",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


def is_loopback(host: str) -> bool:
    """Return True if a host name or address is a loopback address."""
    try:
        return host == "localhost" or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class PageThread:
    """Thread that handles the messages of a page in order, and only the last of messages that replace each other."""

    def __init__(self, double_precision: bool) -> None:
        self._closed = False
        self._queue: deque[tuple[Callable[[], object] | None, Any]] = deque()
        self._condition, self._double_precision = threading.Condition(), double_precision
        threading.Thread(target=self._run, daemon=True).start()

    def add(self, callback: Callable[[], object] | None, replacement_key: Any = None) -> bool:
        """Queue a callback, or None to end the thread; return False if the queue is full or the thread has ended."""
        with self._condition:
            if self._closed:
                return False
            self._closed = callback is None
            if replacement_key is not None and self._queue and self._queue[-1][1] == replacement_key:
                self._queue.pop()
            elif callback is not None and len(self._queue) >= MAX_QUEUED:
                return False
            self._queue.append((callback, replacement_key))
            self._condition.notify()
        return True

    def _run(self) -> None:
        with jax.enable_x64(self._double_precision):
            while (callback := self._next_callback()) is not None:
                try:
                    callback()
                except Exception:  # an internal error must not end the page
                    traceback.print_exc()

    def _next_callback(self):
        with self._condition:
            self._condition.wait_for(lambda: self._queue)
            return self._queue.popleft()[0]


class ExplorerServer:
    """Server of pages of one scene.

    Parameters
    ----------
    scene : Scene
        Scene of the file, or a scene without a file.
    scene_file : SceneFile or None
        Scene file; None if the scene cannot be written as text.
    address : str
        Loopback address.
    port : int or None
        Port; None takes the first free one from 8420 to 8439, 0 any free one.
    token : str, optional
        Secret in the address; None makes a new one.

    Raises
    ------
    ArgumentError
        If `address` is not a loopback address.
    OSError
        If no port is free.
    """

    def __init__(
        self, scene: Scene, scene_file: SceneFile | None, address: str, port: int | None, token: str | None = None
    ) -> None:
        if not is_loopback(address):
            raise ArgumentError("address", "must be a loopback address, such as 127.0.0.1", address)
        self.scene, self.file, self.token = scene, scene_file, token or secrets.token_urlsafe(32)
        self.page_sockets: dict[str, PageSocket] = {}
        self._listening_sockets = _bind_sockets(address, port)
        self.port = self._listening_sockets[0].getsockname()[1]
        url_host = f"[{address}]" if ":" in address else address
        self.url = f"http://{url_host}:{self.port}/?token={self.token}"
        self._started = threading.Event()
        self.last_request_time = 0.0  # s, time of the last message of any page
        self.precomputation = PrecomputationThread(scene, self._is_idle)

    async def serve(self) -> None:
        """Serve until `stop` is called."""
        self._loop, self._stop_requested = asyncio.get_running_loop(), asyncio.Event()
        self._started.set()
        handler_arguments = {"explorer": self}
        routes = [
            (r"/", PageHandler, handler_arguments),
            (r"/(panel\.js|page\.js|page\.css)", AssetHandler, handler_arguments),
            (r"/socket", PageSocket, handler_arguments),
            (r"/take/([\w-]+)/([\w.]+)", DownloadHandler, handler_arguments),
        ]
        application_settings: dict[str, Any] = {
            "websocket_max_message_size": MAX_BYTES + 4096,
            "websocket_ping_interval": 20,
        }
        application_settings |= {"default_handler_class": NotFoundHandler, "default_handler_args": handler_arguments}
        http_server = httpserver.HTTPServer(
            web.Application(routes, **application_settings), max_body_size=4096, max_header_size=65536
        )
        http_server.add_sockets(self._listening_sockets)
        try:
            await self._stop_requested.wait()
        finally:
            for page_socket in list(self.page_sockets.values()):
                page_socket.close()
            http_server.stop()

    def stop(self) -> None:
        """Stop the server, from any thread."""
        self._started.wait()
        self._loop.call_soon_threadsafe(self._stop_requested.set)
        self.precomputation.stop()

    def _is_idle(self):
        return time.monotonic() - self.last_request_time > IDLE_TIME

    def allows_request(self, request: Any) -> bool:
        """Return True if a request has the token and names this machine as its host."""
        request_token = request.query_arguments.get("token", [b""])[-1]
        request_host = host_of_url(f"//{request.host}") or ""
        return hmac.compare_digest(request_token, self.token.encode()) and is_loopback(request_host)


def host_of_url(url: str) -> str | None:
    """Return the host name in an external URL, without the port; "" if there is none, and None for an invalid URL.

    `urlsplit` raises ValueError for texts such as "http://[".
    """
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return None


def _bind_sockets(address, port):
    for candidate_port in PORTS if port is None else [port]:
        try:
            return netutil.bind_sockets(candidate_port, address)
        except OSError as error:
            last_error = error
    raise OSError(last_error.errno, f"no port is free at {address} ({last_error.strerror})")


class GuardedHandler(web.RequestHandler):
    """Handler that refuses requests without the token or with a foreign host name."""

    def initialize(self, explorer: ExplorerServer) -> None:
        self.explorer = explorer

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        if not self.explorer.allows_request(self.request):
            raise web.HTTPError(403)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        explanations = {403: "open the address with its token, which jaxvibro view prints"}
        self.finish(f"{status_code}: {explanations.get(status_code, self._reason)}\n")


class NotFoundHandler(GuardedHandler):
    """Handler of unknown addresses."""

    def prepare(self) -> None:
        super().prepare()
        raise web.HTTPError(404)


class PageHandler(GuardedHandler):
    """Handler of the page."""

    def get(self) -> None:
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish((PAGE_FOLDER / "index.html").read_text().replace("TOKEN", self.explorer.token))


class AssetHandler(GuardedHandler):
    """Handler of the scripts and the style sheet of the page."""

    def get(self, name: str) -> None:
        content_type = "text/css" if name.endswith("css") else "text/javascript"
        self.set_header("Content-Type", f"{content_type}; charset=utf-8")
        self.finish((PAGE_FOLDER / name).read_bytes())


class DownloadHandler(GuardedHandler):
    """Handler of downloads: scene.toml, lines.py, data.zip, or the figure of a panel."""

    async def get(self, page_name: str, file_name: str) -> None:
        page_socket = self.explorer.page_sockets.get(page_name)
        if page_socket is None or page_socket.session is None:
            raise web.HTTPError(404)
        session = page_socket.session
        loop, future = asyncio.get_running_loop(), asyncio.get_running_loop().create_future()

        def produce_download():
            try:
                data_or_error = download_content(file_name, session), None
            except Exception as error:  # answer the request after any error
                data_or_error = None, error
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(future.set_result, data_or_error)

        if not page_socket.page_thread.add(produce_download):
            raise web.HTTPError(503)
        data, error = await future
        if error is not None:
            self.set_status(400)
            self.finish(f"{error_record(error)['text']}\n")
            return
        self.set_header("Content-Type", "application/octet-stream")
        self.set_header("Content-Disposition", f'attachment; filename="{file_name}"')
        self.finish(data)


def download_content(file_name: str, session: Session) -> bytes:
    """Return the content of a download. Raises ArgumentError for unknown names."""
    page, results = session.page, session.results
    if file_name == "scene.toml":
        if session.file is None:
            raise ArgumentError(
                "scene.toml", "requires a scene that can be written; a force without a name cannot", file_name
            )
        return scene_file_text(page, session.file).encode()
    if file_name == "lines.py":
        return program_text(page, results, session.file).encode()
    if file_name == "data.zip":
        return downloads.data_archive(page, results)
    panel, _, file_format = file_name.partition(".")
    return downloads.panel_picture(panel, file_format, page, results, session.screen)


class PageSocket(websocket.WebSocketHandler):
    """WebSocket of a page, with JSON in both directions; its end stops the tasks of the page."""

    def initialize(self, explorer: ExplorerServer) -> None:
        self.explorer, self.name = explorer, secrets.token_urlsafe(9)
        self.session: Session | None = None

    def prepare(self) -> None:
        origins = (self.request.headers.get(name, "") for name in ("Origin", "Sec-Websocket-Origin"))
        are_valid = all(host_of_url(origin) is not None for origin in origins)  # tornado parses them as URLs
        if not (self.explorer.allows_request(self.request) and are_valid):
            raise web.HTTPError(403)
        if len(self.explorer.page_sockets) >= MAX_PAGES:
            raise web.HTTPError(503)

    def check_origin(self, origin: str) -> bool:
        """Accept only pages of this server."""
        return urlsplit(origin).netloc == self.request.host

    def open(self) -> None:
        self.set_nodelay(True)
        loop, double_precision = asyncio.get_running_loop(), bool(self.explorer.scene.dtype == np.float64)

        def send_record(record):
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._send, messages.encode_record(record))

        self.page_thread = PageThread(double_precision)
        session_arguments = self.explorer.file, self.explorer.scene, send_record, self.page_thread.add
        self.session = Session(*session_arguments, self.explorer.precomputation.ready.wait)
        self.explorer.page_sockets[self.name] = self
        self._send(json.dumps({"kind": "page", "name": self.name}))

    def _send(self, text):
        with suppress(websocket.WebSocketClosedError):
            self.write_message(text)

    def on_message(self, text: str | bytes) -> None:
        try:
            message = messages.decode_message(text)
        except ArgumentError as error:
            self._send(json.dumps(error_record(error)))
            self._send(json.dumps({"kind": "answer", "number": messages.decode_message_number(text)}))
            return
        session, self.explorer.last_request_time = self.session, time.monotonic()
        if session is not None and not self.page_thread.add(
            lambda: session.receive_message(message), message.replacement_key
        ):
            self._send(json.dumps(message_record("too many messages are queued; the last one was ignored")))
            self._send(json.dumps({"kind": "answer", "number": message.number}))

    def on_close(self) -> None:
        self.explorer.page_sockets.pop(self.name, None)
        if self.session is not None:
            self.session.close()
            self.page_thread.add(None)

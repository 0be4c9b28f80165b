"""The explorer's server over its own protocol: access, errors that it survives, and the end of a page and its tasks."""

import asyncio
import io
import json
import math
import queue
import re
import socket
import threading
import zipfile
from functools import wraps

import pytest
import xarray as xr
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClosedError, websocket_connect

import jaxvibro as jv
from jaxvibro.explorer.precomputation import PrecomputationThread
from jaxvibro.explorer.server import PageThread

from .explorer_pages import PATIENCE, Page, two_walls

SERVER, PRECOMPUTATION = "jaxvibro.explorer.server", "jaxvibro.explorer.precomputation"


@pytest.fixture(scope="module")
def served():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{SERVER}.IDLE_TIME", math.inf)  # nothing is compiled that other tests have evaluated
        shown = jv.view(two_walls(), 0)
        yield shown
        shown.stop()


def port_of(shown):
    """Return the port of a server."""
    return int(shown.url.split(":")[2].split("/")[0])


def in_a_loop(test):
    """Run a test that is a coroutine with a time limit, and close its pages."""

    async def limited(*arguments, **named):
        try:
            await asyncio.wait_for(test(*arguments, **named), PATIENCE)
        finally:
            while Page.opened:
                Page.opened.pop().socket.close()

    @wraps(test)
    def run(*arguments, **named):
        asyncio.run(limited(*arguments, **named))

    return run


async def fetch(url, host=None):
    """Return the answer to a request, also if it is an error."""
    headers = {} if host is None else {"Host": host}
    return await AsyncHTTPClient(force_instance=True).fetch(HTTPRequest(url, headers=headers), raise_error=False)


def status(served, path, host, more=""):
    """Return the status of the answer to a request, 0 if the server closes the connection without one."""
    request = f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n".encode("latin1")
    with socket.create_connection(("127.0.0.1", port_of(served)), timeout=PATIENCE) as connection:
        connection.sendall(request)
        answer = b""
        while b"\r\n" not in answer and (part := connection.recv(1 << 16)):
            answer += part
    return int(answer.split()[1]) if answer else 0


def test_evaluated_functions_are_compiled_while_nobody_waits(monkeypatch):
    done, quiet = queue.Queue(), threading.Event()
    monkeypatch.setattr(f"{PRECOMPUTATION}.CompilationQueue.compile_next", lambda _: done.put(1))
    monkeypatch.setattr(f"{PRECOMPUTATION}.DRAWING_TIME", 0.0)
    thread = PrecomputationThread(two_walls(), quiet.is_set)
    assert thread.ready.wait(PATIENCE)
    with pytest.raises(queue.Empty):
        done.get(timeout=1.0)
    quiet.set()
    done.get(timeout=PATIENCE)
    thread.stop()
    assert not thread.is_alive()


@pytest.mark.parametrize("name", ["", "page.js", "page.css"])
@in_a_loop
async def test_the_page_is_given_only_with_the_token(served, name):
    plain, token = served.url.split("?token=")
    answer = await fetch(f"{plain}{name}?token={token}")
    assert answer.code == 200 and "default-src 'self'" in answer.headers["Content-Security-Policy"]
    assert (await fetch(f"{plain}{name}")).code == 403
    assert (await fetch(f"{plain}{name}?token={token[:-1]}x")).code == 403
    assert (await fetch(f"{plain}{name}?token={token}", "evil.example")).code == 403
    assert (await fetch(f"{plain}../server.py?token={token}")).code == 404


HOSTS = "[::1 [ ] [] [::1]:x [::1]] [[::1]] [v1.x] [fe80::1%25x] 127.0.0.1: 127.0.0.1:99999 localhost@evil.example"
HOSTS += " evil.example#localhost 127.0.0.1/../ \\evil 0x7f.1 2130706433 %5b::1 [127.0.0.1]"
HOSTS = [*HOSTS.split(), "", " ", "\u2100".encode().decode("latin1"), "a" * 5000, "localhost, evil.example", "\x7f"]
PATHS = ["/", "/page.js", "/socket", "/take/x/lines.py", "/missing", "/%", "//", "/?", "/../", "*", "http://[::1/"]
PATHS += ["/\xff"]


@pytest.mark.parametrize("origin", ["http://[::1", "[", "http://]", "\x7f", "a" * 5000])
def test_requests_with_any_header_are_refused_without_an_error(served, origin):
    """A request without the token is told only that a token is required, whatever its Host is; none raises."""
    token, upgrade = served.url.split("?")[1], f"Upgrade: websocket\r\nConnection: Upgrade\r\nOrigin: {origin}\r\n"
    upgrade += "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
    for path in PATHS:
        for host in ("127.0.0.1", "[::1", "evil.example"):
            assert status(served, path, host, upgrade) in (0, 400, 403)
    for host in HOSTS:
        assert status(served, "/", host) in (0, 400, 403)
        assert status(served, f"/?{token}", host) in (0, 200, 400, 403)
    for path in PATHS[:4]:
        expected = {"/": 200, "/page.js": 200, "/socket": 403}.get(path, 404)
        # No header may contain the letter \x7f.
        assert status(served, f"{path}?{token}", "127.0.0.1", upgrade) == (400 if origin == "\x7f" else expected)


def test_the_token_is_checked_first(served, monkeypatch):
    hosts = []
    monkeypatch.setattr(f"{SERVER}.is_loopback", lambda host: hosts.append(host))
    for host in ("127.0.0.1", "[::1", "evil.example"):
        assert status(served, "/", host) == status(served, "/socket?token=x", host) == 403
    assert hosts == []
    assert status(served, f"/?{served.url.split('?')[1]}", "[::1") == 403 and hosts == [""]


@in_a_loop
async def test_a_file_that_cannot_be_made_is_answered(served, monkeypatch, capsys):
    def fail(name, session):
        raise RuntimeError("no such file")

    page = await Page.open(served.url, size=False)
    monkeypatch.setattr(f"{SERVER}.download_content", fail)
    answer = await fetch(page.address("lines.py"))
    assert (answer.code, answer.body) == (400, b"no such file\n")
    assert "RuntimeError: no such file" in capsys.readouterr().err
    monkeypatch.setattr(PageThread, "add", lambda thread, task, replaces=None: False)  # full, or ended
    assert (await fetch(page.address("lines.py"))).code == 503
    monkeypatch.undo()


def test_a_thread_that_has_ended_takes_no_task():
    thread, done = PageThread(True), queue.Queue()
    assert thread.add(lambda: done.put(1)) and thread.add(None)
    assert not thread.add(lambda: done.put(2))
    assert done.get(timeout=PATIENCE) == 1 and done.empty()


def test_only_a_message_with_the_same_key_is_replaced():
    thread, begun, go, done = PageThread(True), threading.Event(), threading.Event(), queue.Queue()
    thread.add(lambda: (begun.set(), go.wait(PATIENCE)))
    assert begun.wait(PATIENCE)
    for number, key in enumerate(("pan", "pan", "zoom", None, "zoom")):
        thread.add(lambda number=number: done.put(number), key)
    go.set()
    thread.add(lambda: done.put("end"))
    assert list(iter(lambda: done.get(timeout=PATIENCE), "end")) == [1, 2, 3, 4]


@in_a_loop
async def test_a_socket_needs_the_token_and_the_same_origin(served):
    url = served.url.replace("http:", "ws:").split("?")[0] + "socket"
    for address in (url, f"{url}?token=", f"{url}?token=%C3%A4"):
        with pytest.raises(HTTPClientError, match="403"):
            await websocket_connect(address)
    for origin in ("http://evil.example", "http://127.0.0.1:1", "null"):
        with pytest.raises(HTTPClientError, match="403"):
            await Page.open(served.url, origin)


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.1.7", "example.org", "::", ""])
def test_an_address_that_is_not_loopback_is_refused(address):
    with pytest.raises(jv.ArgumentError, match="address: must be a loopback address"):
        jv.view(two_walls(), 0, address)


def test_a_port_that_cannot_be_used_is_refused(served):
    for port in (-1, 65536, 1.5):
        with pytest.raises(jv.ArgumentError, match="port: must be"):
            jv.view(two_walls(), port)
    with pytest.raises(OSError, match="no port is free"):
        jv.view(two_walls(), port_of(served))


UNKNOWN = ["", "{", "[]", '{"do": "dance"}', '{"do": "pick", "panel": "door", "x": 1, "y": 2}', "\0"]


@pytest.mark.parametrize("text", UNKNOWN)
@in_a_loop
async def test_an_unknown_message_is_answered_with_one_line(served, text):
    page = await Page.open(served.url, size=False)
    await page.socket.write_message(text)
    (record,) = await page.until(lambda record: record["kind"] == "told")
    assert record["bad"] and "message: must be a known message" in record["text"]
    await page.say(do="zoom", panel="diagram")


@in_a_loop
async def test_a_scene_file_of_ten_megabytes_is_refused_and_others_go_on(served, tmp_path):
    page, other = await Page.open(served.url, size=False), await Page.open(served.url, size=False)
    with pytest.raises((ConnectionError, WebSocketClosedError)):
        await page.socket.write_message(json.dumps({"do": "load", "text": "#" * 10_000_000}))
        await page.until(lambda record: False)
    await other.say(do="zoom", panel="diagram")
    path = tmp_path / "large.toml"
    path.write_text("#" * 10_000_000)
    with pytest.raises(jv.SceneError, match="must be at most 1,000,000 bytes long"):
        jv.view(path, 0)


@in_a_loop
async def test_a_thousand_clicks_end_with_the_last_and_two_pages_are_apart(served):
    page, other = await Page.open(served.url), await Page.open(served.url)
    for each in (page, other):
        await each.say(do="start", x=0.9, v=-1.1)
    for k in range(1000):
        number = await page.send(do="set", name="amplitude", value=1.0 + 0.001 * k)
    await page.until(lambda record: record.get("number", 0) >= number)
    assert page.state["numbers"]["amplitude"] == 1.0 + 0.001 * 999
    assert other.state["numbers"]["amplitude"] == 2.0


@in_a_loop
async def test_files_of_a_page(served, tmp_path):
    page = await Page.open(served.url)
    await page.say(do="start", x=0.9, v=-1.1)
    names = ("scene.toml", "lines.py", "data.zip", "portrait.png", "portrait.svg", "trace.pdf")
    answers = {name: (await fetch(page.address(name))).body for name in names}
    refused = [page.address("shadow.png"), page.address("lines.py").replace(page.name, f"{page.name}x")]
    refused += [page.address("lines.py").partition("?")[0]]
    assert [(await fetch(address)).code for address in refused] == [400, 404, 403]
    assert answers["lines.py"].decode() == page.state["python"]
    assert answers["portrait.png"][:4] == b"\x89PNG" and b"<svg" in answers["portrait.svg"][:500]
    assert answers["trace.pdf"][:4] == b"%PDF"
    with zipfile.ZipFile(io.BytesIO(answers["data.zip"])) as data:
        assert data.namelist() == ["orbit_1.nc", "orbit_1.txt"]
        table = data.read("orbit_1.txt").decode()
        motion = xr.load_dataset(io.BytesIO(data.read("orbit_1.nc")))
    x = float(re.search(r"x (\S+), v", table)[1])
    assert (
        "multipliers" in table and motion.sizes["impact"] == 2 and float(motion["x"][0]) == pytest.approx(x, rel=1e-9)
    )
    path = tmp_path / "page.toml"
    path.write_bytes(answers["scene.toml"])
    assert jv.load_scene(path).numbers == two_walls().numbers


@in_a_loop
async def test_a_page_that_closes_ends_its_tasks(served):
    page = await Page.open(served.url, size=False)
    await page.say(do="ask", call="explore", max_period=8)
    (task,) = [task for _, task in served._explorer.page_sockets[page.name].session.tasks._tasks.values()]
    page.socket.close()
    await asyncio.to_thread(task.join, 60.0)
    assert not task.is_alive()


def test_a_stopped_server_is_gone():
    shown = jv.view(two_walls(), 0)
    assert shown.url in shown._repr_html_() and "127.0.0.1" in repr(shown)
    shown.stop()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", port_of(shown)), 5.0)

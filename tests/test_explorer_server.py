"""The explorer's server over its own protocol: who is let in, what survives, what ends with a page."""

import asyncio
import io
import json
import math
import queue
import socket
import threading
import zipfile

import pytest
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClosedError, websocket_connect

import jaxvibro as jv
from jaxvibro.explorer import precomputation, server
from jaxvibro.explorer.server import is_loopback

from .explorer_pages import PATIENCE, Page, two_walls


@pytest.fixture(scope="module")
def served():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(server, "IDLE_TIME", math.inf)  # nothing is compiled that other tests have evaluated
        shown = jv.view(two_walls(), 0)
        yield shown
        shown.stop()


def test_what_was_evaluated_is_compiled_while_nobody_waits(monkeypatch):
    done, quiet = queue.Queue(), threading.Event()
    monkeypatch.setattr(precomputation, "compile_numpy_functions", lambda: iter([done.put(1)]))
    monkeypatch.setattr(precomputation, "DRAWING_TIME", 0.0)
    one = precomputation.PrecomputationThread(two_walls(), quiet.is_set)
    assert one.ready.wait(PATIENCE)
    with pytest.raises(queue.Empty):
        done.get(timeout=1.0)
    quiet.set()
    done.get(timeout=PATIENCE)
    one.stop()
    assert not one.is_alive()


def run(coroutine):
    return asyncio.run(asyncio.wait_for(coroutine, PATIENCE))


async def fetched(url, host=None):
    headers = {} if host is None else {"Host": host}
    return await AsyncHTTPClient(force_instance=True).fetch(HTTPRequest(url, headers=headers), raise_error=False)


@pytest.mark.parametrize("name", ["", "page.js", "page.css"])
def test_the_page_is_given_to_whoever_has_the_token(served, name):
    plain, token = served.url.split("?token=")
    answer = run(fetched(f"{plain}{name}?token={token}"))
    assert answer.code == 200 and "default-src 'self'" in answer.headers["Content-Security-Policy"]
    assert run(fetched(f"{plain}{name}")).code == 403
    assert run(fetched(f"{plain}{name}?token={token[:-1]}x")).code == 403
    assert run(fetched(f"{plain}{name}?token={token}", "evil.example")).code == 403
    assert run(fetched(f"{plain}../server.py?token={token}")).code == 404


HOSTS = [
    *(
        "[::1",
        "[",
        "]",
        "[]",
        "[::1]:x",
        "[::1]]",
        "[[::1]]",
        "[v1.x]",
        "[fe80::1%25x]",
        "127.0.0.1:",
        "127.0.0.1:99999",
    ),
    *("", " ", "localhost@evil.example", "evil.example#localhost", "127.0.0.1/../", "\\evil", "0x7f.1"),
    *(
        "2130706433",
        "\u2100".encode().decode("latin1"),
        "a" * 5000,
        "localhost, evil.example",
        "\x7f",
        "%5b::1",
        "[127.0.0.1]",
    ),
]
PATHS = [
    "/",
    "/page.js",
    "/socket",
    "/take/x/lines.py",
    "/missing",
    "/%",
    "//",
    "/?",
    "/../",
    "*",
    "http://[::1/",
    "/\xff",
]


def raw(served, content):
    """The status of the answer to the bytes of a request, 0 where the server closed without one."""
    port = int(served.url.split(":")[2].split("/")[0])
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as line:
        line.sendall(content)
        answer = b""
        while b"\r\n" not in answer and (part := line.recv(1 << 16)):
            answer += part
    return int(answer.split()[1]) if answer else 0


def request(path, host, more=""):
    return f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n".encode("latin1")


@pytest.mark.parametrize("origin", ["http://[::1", "[", "http://]", "\x7f", "a" * 5000])
def test_requests_with_any_header_are_refused_without_an_error(served, origin):
    """No request without the token learns more than that it is needed, whatever its Host is; none raises."""
    token, upgrade = served.url.split("?")[1], f"Upgrade: websocket\r\nConnection: Upgrade\r\nOrigin: {origin}\r\n"
    upgrade += "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
    for path in PATHS:
        for host in ("127.0.0.1", "[::1", "evil.example"):
            assert raw(served, request(path, host, upgrade)) in (0, 400, 403)
    for host in HOSTS:
        assert raw(served, request("/", host)) in (0, 400, 403)
        assert raw(served, request(f"/?{token}", host)) in (0, 200, 400, 403)
    for path in PATHS[:4]:
        found = raw(served, request(f"{path}?{token}", "127.0.0.1", upgrade))
        known = {"/": 200, "/page.js": 200, "/socket": 403}.get(path, 404)
        assert found == (400 if origin == "\x7f" else known)  # no header may have such a letter


def test_the_token_is_looked_at_first(served, monkeypatch):
    hosts = []
    monkeypatch.setattr(server, "is_loopback", lambda host: hosts.append(host))
    for host in ("127.0.0.1", "[::1", "evil.example"):
        assert raw(served, request("/", host)) == 403
        assert raw(served, request("/socket?token=x", host)) == 403
    assert hosts == []
    assert raw(served, request(f"/?{served.url.split('?')[1]}", "[::1")) == 403
    assert hosts == [""]


def test_a_file_that_cannot_be_made_is_answered(served, monkeypatch, capsys):
    def fails(name, session):
        raise RuntimeError("no such file")

    async def talk():
        page = await Page.open(served.url, size=False)
        base, token = served.url.split("?")
        address = f"{base}take/{page.name}/lines.py?{token}"
        monkeypatch.setattr(server, "download_content", fails)
        first = await fetched(address)
        monkeypatch.setattr(server.PageThread, "add", lambda line, does, replaces=None: False)  # no room, or at its end
        second = await fetched(address)
        monkeypatch.undo()
        page.socket.close()
        return first, second

    first, second = run(talk())
    assert (first.code, first.body) == (400, b"no such file\n") and second.code == 503
    assert "RuntimeError: no such file" in capsys.readouterr().err


def test_a_line_that_has_ended_takes_nothing():
    line, done = server.PageThread(True), queue.Queue()
    assert line.add(lambda: done.put(1)) and line.add(None)
    assert not line.add(lambda: done.put(2))
    assert done.get(timeout=PATIENCE) == 1 and done.empty()


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:1", "null"])
def test_another_origin_has_no_socket(served, origin):
    with pytest.raises(HTTPClientError, match="403"):
        run(Page.open(served.url, origin))


def test_a_socket_needs_the_token(served):
    url = served.url.replace("http:", "ws:").split("?")[0] + "socket"

    async def connect(to):
        await websocket_connect(to)

    for each in (url, f"{url}?token=", f"{url}?token=%C3%A4"):
        with pytest.raises(HTTPClientError, match="403"):
            run(connect(each))


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.1.7", "example.org", "::", ""])
def test_an_address_that_is_not_loopback_is_refused(address):
    assert not is_loopback(address)
    with pytest.raises(jv.ArgumentError, match="address: must be a loopback address"):
        jv.view(two_walls(), 0, address)


@pytest.mark.parametrize("port", [-1, 65536, 1.5])
def test_a_port_that_cannot_be_is_refused(port):
    with pytest.raises(jv.ArgumentError, match="port: must be"):
        jv.view(two_walls(), port)


def test_a_port_that_is_taken(served):
    with pytest.raises(OSError, match="no port is free"):
        jv.view(two_walls(), int(served.url.split(":")[2].split("/")[0]))


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"do": "dance"}', '{"do": "pick", "panel": "door", "x": 1, "y": 2}', "\0"]
)
def test_a_message_that_is_none_is_one_line(served, text):
    async def talk():
        page = await Page.open(served.url, size=False)
        await page.socket.write_message(text)
        (told,) = await page.until(lambda record: record["kind"] == "told")
        assert told["bad"] and "message: must be a known message" in told["text"]
        await page.say(do="zoom", panel="diagram")
        page.socket.close()

    run(talk())


def test_a_scene_file_of_ten_megabytes_is_refused_and_others_go_on(served, tmp_path):
    async def talk():
        page, other = await Page.open(served.url, size=False), await Page.open(served.url, size=False)
        with pytest.raises((ConnectionError, WebSocketClosedError)):
            await page.socket.write_message(json.dumps({"do": "load", "text": "#" * 10_000_000}))
            await page.until(lambda record: False)
        await other.say(do="zoom", panel="diagram")
        other.socket.close()

    run(talk())
    path = tmp_path / "large.toml"
    path.write_text("#" * 10_000_000)
    with pytest.raises(jv.SceneError, match="must be at most 1,000,000 bytes long"):
        jv.view(path, 0)


def test_a_thousand_clicks_end_with_the_last_and_two_pages_are_apart(served):
    async def talk():
        page, other = await Page.open(served.url), await Page.open(served.url)
        for each in (page, other):
            await each.say(do="start", x=0.9, v=-1.1)
        for k in range(1000):
            number = await page.send(do="set", name="amplitude", value=1.0 + 0.001 * k)
        await page.until(lambda record: record.get("number", 0) >= number)
        assert page.state["numbers"]["amplitude"] == 1.0 + 0.001 * 999
        assert other.state["numbers"]["amplitude"] == 2.0
        page.socket.close()
        other.socket.close()

    run(talk())


def test_what_can_be_taken(served, tmp_path):
    async def talk():
        page = await Page.open(served.url)
        await page.say(do="start", x=0.9, v=-1.1)
        base, token = served.url.split("?")
        found = {}
        for name in ("scene.toml", "lines.py", "data.zip", "portrait.png", "portrait.svg", "trace.pdf", "shadow.png"):
            found[name] = await fetched(f"{base}take/{page.name}/{name}?{token}")
        found["other"] = await fetched(f"{base}take/{page.name}x/lines.py?{token}")
        found["none"] = await fetched(f"{base}take/{page.name}/lines.py")
        page.socket.close()
        return page.state, found

    state, found = run(talk())
    assert [found[name].code for name in ("shadow.png", "other", "none")] == [400, 404, 403]
    assert found["lines.py"].body.decode() == state["python"]
    assert found["portrait.png"].body[:4] == b"\x89PNG" and b"<svg" in found["portrait.svg"].body[:500]
    assert found["trace.pdf"].body[:4] == b"%PDF"
    with zipfile.ZipFile(io.BytesIO(found["data.zip"].body)) as data:
        assert data.namelist() == ["orbit_1.nc", "orbit_1.txt"]
        assert "multipliers" in data.read("orbit_1.txt").decode()
    path = tmp_path / "page.toml"
    path.write_bytes(found["scene.toml"].body)
    assert jv.load_scene(path).numbers == two_walls().numbers


def test_a_page_that_goes_away_ends_its_work(served):
    pages = served._explorer.page_sockets

    async def talk():
        before = set(pages)
        page = await Page.open(served.url, size=False)
        (name,) = set(pages) - before
        await page.say(do="ask", call="explore", max_period=8)
        (work,) = [work for _, work in pages[name].session.tasks._tasks.values()]
        page.socket.close()
        for _ in range(600):
            if not work.is_alive():
                return
            await asyncio.sleep(0.1)
        pytest.fail("the work goes on")

    run(talk())


def test_a_server_that_has_stopped_is_gone():
    shown = jv.view(two_walls(), 0)
    assert shown.url in shown._repr_html_() and "127.0.0.1" in repr(shown)
    shown.stop()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", int(shown.url.split(":")[2].split("/")[0])), 5.0)

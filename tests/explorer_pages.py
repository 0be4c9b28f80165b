"""Pages of the explorer for tests: a session without a server, and the socket of a page of a server."""

import json
import queue

import msgspec
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

import jaxvibro as jv
from jaxvibro.explorer.messages import decode_message, encode_record
from jaxvibro.explorer.session import Session
from jaxvibro.scene.scene_table import make_scene_table
from jaxvibro.studies.schema import SceneFile

SIZES = {"diagram": (400, 300), "plane": (400, 200), "portrait": (300, 300), "trace": (300, 150)}
PATIENCE = 300  # s


def two_walls():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))


class Desk:
    """A session whose thread is that of the test."""

    def __init__(self, scene=None):
        scene = two_walls() if scene is None else scene
        self.records, self.turns = [], queue.Queue()
        self.session = Session(SceneFile(scene=make_scene_table(scene)), scene, self.record, self.turns.put)
        self.session.connected = True

    def record(self, record):
        """Keep a record as a page would read it."""
        self.records.append(msgspec.json.decode(encode_record(record)))

    def receive_text(self, text):
        """Pass a message to the session, and return the records that it sends because of it."""
        before = len(self.records)
        self.session.receive_message(decode_message(text))
        return self.records[before:]

    def say(self, do, **fields):
        """Send a message as the page does, and return the records that the session sends because of it."""
        return self.receive_text(json.dumps({"do": do, **fields}))

    def run(self, do, **fields):
        """Send a message, wait until no task runs, and return the records that are sent."""
        before = len(self.records)
        self.say(do, **fields)
        while self.session.tasks.labels:
            self.turns.get(timeout=PATIENCE)()
        return self.records[before:]

    def resize(self):
        """Give the panels their sizes, after which they are drawn."""
        for panel, (width, height) in SIZES.items():
            self.say("size", panel=panel, width=width, height=height)

    def result(self, name):
        """Return the result that a field of the page, such as "scene" or "current", names."""
        return self.session.results[getattr(self.session.page, name)]

    @property
    def lines(self):
        """Names of the results on the page."""
        return [line.name for line in self.session.page.lines]

    @property
    def sent(self):
        """Fields that the page has."""
        return self.session.sent_fields


def complaints(records):
    """Return the error messages among records."""
    return [record["text"] for record in records if record["kind"] == "told" and record["bad"]]


class Page:
    """The socket of a page."""

    opened = []  # noqa: RUF012

    def __init__(self, socket, url):
        self.socket, self.url, self.number, self.state = socket, url, 0, {}
        self.opened.append(self)

    def address(self, name):
        """Return the address of a file of the page."""
        return self.url.replace("?", f"take/{self.name}/{name}?")

    @classmethod
    async def open(cls, url, origin=None, size=True):
        headers = {} if origin is None else {"Origin": origin}
        request = HTTPRequest(url.replace("http:", "ws:").replace("/?", "/socket?"), headers=headers)
        page = cls(await websocket_connect(request, max_message_size=1 << 26), url)
        (first,) = await page.until(lambda record: record["kind"] == "page")
        page.name = first["name"]
        for panel, (width, height) in SIZES.items() if size else ():
            await page.say(do="size", panel=panel, width=width, height=height)
        return page

    async def say(self, **message):
        """Send a message, and return the records that come up to its answer."""
        number = await self.send(**message)
        return await self.until(lambda record: record.get("number", 0) >= number)

    async def send(self, **message):
        """Send a message, and return its number."""
        self.number += 1
        await self.socket.write_message(json.dumps(message | {"number": self.number}))
        return self.number

    async def until(self, is_last):
        """Return the records that come up to one that fulfils a condition."""
        records = []
        while not records or not is_last(records[-1]):
            text = await self.socket.read_message()
            if text is None:
                raise ConnectionError("the server closed the socket")
            records.append(json.loads(text))
            if records[-1]["kind"] == "state":
                self.state |= records[-1]
        return records

"""Pages of the explorer for tests: a session without a server, and a socket to a server."""

import json
import queue

from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

import jaxvibro as jv
from jaxvibro.explorer import messages
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
        self.told, self.turns = [], queue.Queue()
        self.session = Session(SceneFile(scene=make_scene_table(scene)), scene, self.told.append, self.turns.put)
        self.session.connected = True

    def receive(self, message):
        """Pass a message to the session, and return the records that it sends because of it."""
        before = len(self.told)
        self.session.receive_message(message)
        return self.told[before:]

    def say(self, do, **fields):
        """Send a message as the page does, and return the records that the session sends because of it."""
        return self.receive(messages.decode_message(json.dumps({"do": do, **fields})))

    def rest(self):
        """Wait until no task runs, and return the records that are sent meanwhile."""
        before = len(self.told)
        while self.session.tasks.labels:
            self.turns.get(timeout=PATIENCE)()
        return self.told[before:]

    def run(self, do, **fields):
        """Send a message, wait until no task runs, and return the records that are sent."""
        return self.say(do, **fields) + self.rest()

    def resize(self):
        """Give the panels their sizes, after which they are drawn."""
        for panel, (width, height) in SIZES.items():
            self.say("size", panel=panel, width=width, height=height)

    @property
    def current(self):
        """Orbit or motion in the portrait."""
        return self.session.results[self.session.page.current]

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
    """A page's socket."""

    def __init__(self, socket):
        self.socket, self.number, self.state, self.pictures = socket, 0, {}, {}

    @classmethod
    async def open(cls, url, origin=None, size=True):
        headers = {} if origin is None else {"Origin": origin}
        request = HTTPRequest(url.replace("http:", "ws:").replace("/?", "/socket?"), headers=headers)
        page = cls(await websocket_connect(request, max_message_size=1 << 26))
        await page.until(lambda record: record["kind"] == "page")
        for panel, (width, height) in SIZES.items() if size else ():
            await page.say(do="size", panel=panel, width=width, height=height)
        return page

    async def say(self, **message):
        """Sends a message and waits until it has been seen to: what was told meanwhile."""
        number = await self.send(**message)
        return await self.until(lambda record: record.get("number", 0) >= number)

    async def send(self, **message):
        self.number += 1
        await self.socket.write_message(json.dumps(message | {"number": self.number}))
        return self.number

    async def rest(self):
        """Waits until no work is under way."""
        if self.state.get("works"):
            await self.until(lambda record: record.get("works") == [])

    async def until(self, is_last):
        found = []
        while not found or not is_last(found[-1]):
            text = await self.socket.read_message()
            if text is None:
                raise ConnectionError("the server closed the socket")
            found.append(json.loads(text))
            if found[-1]["kind"] == "state":
                self.state |= found[-1]
            elif found[-1]["kind"] == "picture":
                self.pictures[found[-1]["panel"]] = found[-1]
            elif found[-1]["kind"] == "page":
                self.name = found[-1]["name"]
        return found

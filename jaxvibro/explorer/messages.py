"""What a page may send, each message a record, read strictly; and how what it is told is written."""

import json
import math
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from ..scene.check import ArgumentError, shorten

Panel = Literal["diagram", "plane", "portrait", "trace"]
Interval = tuple[float, float]
ShortText = Annotated[str, Meta(max_length=200)]
Count = Annotated[int, Meta(ge=1, le=100_000)]


class Message(Struct, tag_field="do", forbid_unknown_fields=True, kw_only=True):
    """A message; number: its own, told back once it has been seen to."""

    number: int = 0

    @property
    def replacement_key(self) -> tuple[Any, ...] | None:
        """Of two messages in a row with one key the later one alone counts; None: each counts."""
        return None


class Hello(Message, tag="hello"):
    """The page is there; text: the scene file that it had of a server before, if any."""

    text: str = ""


class Resize(Message, tag="size"):
    """A panel has another size, pixels of the page; ratio: pixels of the screen to one of them."""

    panel: Panel
    width: float
    height: float
    ratio: float = 1.0

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return "size", self.panel


class Zoom(Message, tag="zoom"):
    """Other limits of a panel's axes, None: all of it."""

    panel: Panel
    x: Interval | None = None
    y: Interval | None = None

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return "zoom", self.panel


class Click(Message, tag="pick"):
    """A click into the diagram, or into the plane of two parameters: the nearest point there."""

    panel: Literal["diagram", "plane"]
    x: float
    y: float

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return "pick", self.panel


class SetStart(Message, tag="start"):
    """A new start: position and velocity at phase 0."""

    x: float
    v: float

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return ("start",)


class SetParameter(Message, tag="set"):
    """A number of the scene; last: the slider has been let go of."""

    name: ShortText
    value: float
    last: bool = True

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return "set", self.name


class Select(Message, tag="choose"):
    """A special point, an orbit or a line, by its reference."""

    of: ShortText


class MoveOnBranch(Message, tag="move"):
    """Along the branch by so many points; branch: to another branch, so many on."""

    by: int = 0
    branch: int = 0


class SetAxes(Message, tag="along"):
    """The parameter of the diagram and its range, and the second one of the plane; variable: what is drawn."""

    parameter: ShortText
    bounds: Interval
    second: ShortText
    second_bounds: Interval
    variable: ShortText


class RunAction(Message, tag="ask"):
    """A call on what is chosen. count: of a grid's side, or of a sweep's values; max_period: of `explore`."""

    call: Literal["follow", "switch", "explore", "locus", "margin", "basins", "map", "sweep", "attractors"]
    count: Count = 128
    max_period: Annotated[int, Meta(ge=1, le=32)] = 2


class Stop(Message, tag="stop"):
    """Ends the long work."""


class Undo(Message, tag="undo"):
    """Takes the last thing that was asked back."""


class Load(Message, tag="load"):
    """A scene file's text in place of all that is there."""

    text: str


PageMessage = (
    Hello
    | Resize
    | Zoom
    | Click
    | SetStart
    | SetParameter
    | Select
    | MoveOnBranch
    | SetAxes
    | RunAction
    | Stop
    | Undo
    | Load
)
_message_decoder = msgspec.json.Decoder(PageMessage)


class _NumberedMessage(Struct):
    number: int = 0


_number_decoder = msgspec.json.Decoder(_NumberedMessage)


def decode(text: str | bytes) -> PageMessage:
    """The message of a text. Raises ArgumentError for what is none."""
    try:
        return _message_decoder.decode(text)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise ArgumentError("message", f"must be one that the page knows ({shorten(error)})", shorten(text)) from None


def message_number(text: str | bytes) -> int:
    """The number of a message that may be none the page knows, 0 without."""
    try:
        return _number_decoder.decode(text).number
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return 0


def encode(record: dict[str, Any]) -> str:
    """A record as JSON that browsers read: numbers that are not finite become null."""
    try:
        return json.dumps(record, allow_nan=False)
    except ValueError:
        return json.dumps(_replace_nonfinite(record))


def _replace_nonfinite(value):
    if isinstance(value, dict):
        return {key: _replace_nonfinite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_replace_nonfinite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

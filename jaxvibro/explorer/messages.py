"""Parse the messages of a page strictly, and encode the records for it."""

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
    """Message of a page; `number` is returned in its answer."""

    number: int = 0

    @property
    def replacement_key(self) -> tuple[Any, ...] | None:
        """Key of messages that replace each other: of two consecutive ones with the same key only the later counts."""
        return None


class Hello(Message, tag="hello"):
    """Start of a page; `text` is the scene file that the page had from an earlier server, if any."""

    text: str = ""


class Resize(Message, tag="size"):
    """New size of a panel in page pixels; `ratio` is the number of screen pixels per page pixel."""

    panel: Panel
    width: float
    height: float
    ratio: float = 1.0

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return "size", self.panel


class Zoom(Message, tag="zoom"):
    """New limits of the axes of a panel; None restores the full range."""

    panel: Panel
    x: Interval | None = None
    y: Interval | None = None

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return "zoom", self.panel


class Click(Message, tag="pick"):
    """Click into the diagram or the plane, which selects the nearest point."""

    panel: Literal["diagram", "plane"]
    x: float
    y: float

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return "pick", self.panel


class SetStart(Message, tag="start"):
    """New initial state: position and velocity at phase 0."""

    x: float
    v: float

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return ("start",)


class SetParameter(Message, tag="set"):
    """New value of a parameter of the scene; `last` is True once the slider is released."""

    name: ShortText
    value: float
    last: bool = True

    @property
    def replacement_key(self) -> tuple[Any, ...]:
        return "set", self.name


class Select(Message, tag="choose"):
    """Selection of a special point, an orbit or a line, by its reference."""

    of: ShortText


class MoveOnBranch(Message, tag="move"):
    """Move by a number of points along the branch, or by a number of branches."""

    by: int = 0
    branch: int = 0


class SetAxes(Message, tag="along"):
    """New parameter and range of the diagram, second parameter of the plane, and variable of the diagram."""

    parameter: ShortText
    bounds: Interval
    second: ShortText
    second_bounds: Interval
    variable: ShortText


class RunAction(Message, tag="ask"):
    """Call on the selection.

    `count` is the number of cells per side of a grid, or of values of a sweep. `max_period` belongs to `explore`.
    """

    call: Literal["follow", "switch", "explore", "locus", "margin", "basins", "map", "sweep", "attractors"]
    count: Count = 128
    max_period: Annotated[int, Meta(ge=1, le=32)] = 2


class Stop(Message, tag="stop"):
    """Request to stop the running tasks."""


class Undo(Message, tag="undo"):
    """Request to undo the last step."""


class Load(Message, tag="load"):
    """Text of a scene file that replaces the content of the page."""

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
    """Decode a message. Raises ArgumentError for invalid text."""
    try:
        return _message_decoder.decode(text)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise ArgumentError("message", f"must be a known message ({shorten(error)})", shorten(text)) from None


def message_number(text: str | bytes) -> int:
    """Return the number of a text that is not a valid message, 0 if it has none."""
    try:
        return _number_decoder.decode(text).number
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return 0


def encode(record: dict[str, Any]) -> str:
    """Encode a record as JSON that browsers read, with null for numbers that are not finite."""
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

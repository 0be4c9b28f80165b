"""Parse the messages of a page strictly, encode the records for it, and convert errors to records."""

import json
import math
import traceback
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from ..orbits.orbit import OrbitError
from ..scene.check import ArgumentError, shorten_text

EXPECTED_ERRORS = (ArgumentError, OrbitError, ArithmeticError, MemoryError, OSError)


def error_record(error: BaseException) -> dict[str, Any]:
    """Return the record of an error for the page; an unexpected error is also printed with its traceback."""
    if not isinstance(error, EXPECTED_ERRORS):
        traceback.print_exception(error)
    return message_record(str(error) or type(error).__name__)


def message_record(error_text: str) -> dict[str, Any]:
    """Return the record of an error text."""
    return {"kind": "told", "text": shorten_text(error_text, 300), "bad": True}


PanelName = Literal["diagram", "plane", "portrait", "trace"]
Interval = tuple[float, float]
ShortText = Annotated[str, Meta(max_length=200)]
Count = Annotated[int, Meta(ge=1, le=100_000)]


class Message(Struct, tag_field="do", forbid_unknown_fields=True, kw_only=True):
    """Message of a page.

    Attributes
    ----------
    number : int
        Number of the message, which the answer repeats.
    """

    number: int = 0

    @property
    def replacement_key(self) -> tuple[Any, ...] | None:
        """Key of messages that replace each other; of consecutive messages with equal keys only the last is applied."""
        field_names = REPLACEMENT_FIELDS.get(type(self))
        return None if field_names is None else (type(self), *(getattr(self, name) for name in field_names))


class Hello(Message, tag="hello"):
    """First message of a page.

    Attributes
    ----------
    text : str
        Text of the scene file that the page received from an earlier server; "" if there is none.
    """

    text: str = ""


class ResizePanel(Message, tag="size"):
    """New size of a panel.

    Attributes
    ----------
    panel : str
        Panel.
    width : float
        Width in page pixels.
    height : float
        Height in page pixels.
    ratio : float
        Number of screen pixels per page pixel.
    """

    panel: PanelName
    width: float
    height: float
    ratio: float = 1.0


class ZoomPanel(Message, tag="zoom"):
    """New limits of the axes of a panel; None restores the full range."""

    panel: PanelName
    x: Interval | None = None
    y: Interval | None = None


class Click(Message, tag="pick"):
    """Click into the diagram or the plane, which selects the nearest point."""

    panel: Literal["diagram", "plane"]
    x: float
    y: float


class SetStart(Message, tag="start"):
    """New initial state: position and velocity at phase 0."""

    x: float
    v: float


class SetParameter(Message, tag="set"):
    """New value of a parameter of the scene.

    Attributes
    ----------
    name : str
        Parameter.
    value : float
        Value.
    last : bool
        True once the slider is released.
    """

    name: ShortText
    value: float
    last: bool = True


class Select(Message, tag="choose"):
    """Selection of a special point or a branch by its reference."""

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
    """Request for a call on the selection, the current orbit or the scene.

    Attributes
    ----------
    call : str
        Name of the call.
    count : int
        Number of cells per side of a grid, or number of values of a sweep.
    max_period : int
        Largest number of drive periods of the orbits that ``"explore"`` searches for.
    """

    call: Literal["follow", "switch", "explore", "locus", "margin", "basins", "map", "sweep", "attractors"]
    count: Count = 128
    max_period: Annotated[int, Meta(ge=1, le=32)] = 2


class StopTasks(Message, tag="stop"):
    """Request to stop the running tasks."""


class Undo(Message, tag="undo"):
    """Request to undo the last step."""


class LoadSceneFile(Message, tag="load"):
    """Text of a scene file that replaces the content of the page."""

    text: str


PageMessage = (
    Hello
    | ResizePanel
    | ZoomPanel
    | Click
    | SetStart
    | SetParameter
    | Select
    | MoveOnBranch
    | SetAxes
    | RunAction
    | StopTasks
    | Undo
    | LoadSceneFile
)
# Fields in which consecutive messages of a type agree if the last one replaces the others.
REPLACEMENT_FIELDS: dict[type[Message], tuple[str, ...]] = {
    ResizePanel: ("panel",),
    ZoomPanel: ("panel",),
    Click: ("panel",),
    SetStart: (),
    SetParameter: ("name",),
}
_message_decoder = msgspec.json.Decoder(PageMessage)


class _MessageNumber(Struct):
    number: int = 0


_number_decoder = msgspec.json.Decoder(_MessageNumber)


def decode_message(message_text: str | bytes) -> PageMessage:
    """Decode a message. Raises ArgumentError for invalid text."""
    try:
        return _message_decoder.decode(message_text)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise ArgumentError(
            "message", f"must be a known message ({shorten_text(error)})", shorten_text(message_text)
        ) from None


def decode_message_number(message_text: str | bytes) -> int:
    """Return the `number` of an invalid message; 0 if its text contains none."""
    try:
        return _number_decoder.decode(message_text).number
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return 0


def encode_record(record: dict[str, Any]) -> str:
    """Encode a record as standard JSON, with null for numbers that are not finite."""
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

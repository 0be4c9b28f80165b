"""Convert errors to records with one line of text for a page."""

import traceback
from typing import Any

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

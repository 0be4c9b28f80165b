"""Why a branch or a locus ends: a member for each reason, with the text that tells it."""

import re
from enum import Enum
from typing import NamedTuple


class End(Enum):
    """Why a branch ends. A member's value is its text; value in it is the parameter's there, kind that of the special
    point at which it was stopped, or which it left."""

    BOUND = "the parameter reached its bound {value:.12g}"
    DOMAIN = "the parameter's domain ends at {value:.12g}"
    CLOSED = "it closes: the branch came back to an orbit met before, at {value:.12g}"
    STOPPED = "stopped at {kind}, {value:.12g}"
    STEP = "the step became too small at {value:.12g}: Newton's method does not converge there"
    GRAZE = "grazing at {value:.12g}: no orbit with as many periods goes on from there"
    REST = "from {value:.12g} on the mass rests on a wall for a while"
    POINTS = "it has too many points, the last at {value:.12g}"
    MAX_POINTS = "max_points reached at {value:.12g}"
    MAX_SECONDS = "max_seconds reached at {value:.12g}"
    NUMBER = "a number is not finite after {value:.12g}"
    HALVED = "at {value:.12g} it is an orbit of a shorter period, repeated"
    CHATTER = (
        "at {value:.12g} another impact is as good as without speed: towards complete chatter there is no end of"
        " grazings"
    )
    UNSETTLED = "at {value:.12g} the mass just comes to rest, or is let go: no orbit of as many periods goes on beyond"
    START = "the start"
    LEFT = "it left {kind} at {value:.12g}"

    def reason(self, value=0.0, kind=""):
        """The `Reason` with these in its text."""
        return Reason(self, self.value.format(value=value, kind=kind))


RESUMABLE_ENDS = End.MAX_POINTS, End.MAX_SECONDS  # ends that a later call can continue from


class Reason(NamedTuple):
    """Why a branch ends: the `End`, which decides, and its text, which only tells."""

    end: End
    text: str


def convert_end(segment):
    """A `continuation.branch_segment.BranchSegment` with its end as an `End` of these."""
    return segment._replace(end=End[segment.end.name])


def parse_end(text):
    """The `End` of a text: saved branches had no more. Raises ValueError where it is none."""
    return _parse_reason(text)[0]


def rescale_reason(text, factor):
    """The text of a `Reason`, its value told in another unit, in which it is so many times as large."""
    _, match = _parse_reason(text)
    if not match.groups():
        return text
    return f"{text[: match.start(1)]}{float(match[1]) * factor:.12g}{text[match.end(1) :]}"


def _parse_reason(text):
    """(the `End` of a text, the match, whose first group is the value where the text has one)."""
    for end in End:
        pattern = re.sub(r"\\{value[^}]*\\}", r"(\\S+)", re.escape(end.value)).replace(r"\{kind\}", ".+")
        match = re.fullmatch(pattern, text)
        if match:
            return end, match
    raise ValueError(f"why a branch ends is not told by {text!r}")

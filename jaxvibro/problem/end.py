"""Reasons for the end of a branch or a locus, with their texts."""

import re
from enum import Enum
from typing import NamedTuple


class End(Enum):
    """Reason for the end of a branch.

    The value of a member is a text. ``{value}`` stands for the value of the parameter. ``{kind}`` stands for the kind
    of special point at which the branch stops or starts. The texts are stored in files and parsed.

    Notes
    -----
    - BOUND and STOPPED are limits of the user: a bound, or a kind of special point in `stop`.
    - DOMAIN is the end of the domain of a parameter.
    - MAX_POINTS and MAX_SECONDS are limits of the computation; `extend` resumes there.
    - CLOSED is a closed branch.
    - STEP, POINTS, NUMBER and HALVED are failures: the step is too small, there are too many points, a number is not
      finite, or the orbit is a repeated orbit of a shorter period.
    - GRAZE, REST, CHATTER and UNSETTLED are grazings and limits of sticking beyond which no orbit of this kind exists.
    - START and LEFT are starts of a branch: the initial orbit, or the special point at which the branch begins.
    """

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
        """Return the `EndReason` with the value and the kind inserted in the text."""
        return EndReason(self, self.value.format(value=value, kind=kind))


RESUMABLE_ENDS = End.MAX_POINTS, End.MAX_SECONDS  # ends that a later call can continue from


class EndReason(NamedTuple):
    """Reason for the end of a branch.

    Attributes
    ----------
    end : End
        Reason, for decisions in the code.
    text : str
        Text for display.
    """

    end: End
    text: str


def convert_segment_end(segment):
    """Replace the end of a segment by the member of `End` with the same name.

    Parameters
    ----------
    segment : continuation.branch_segment.BranchSegment
        Segment from `continuation`.

    Returns
    -------
    continuation.branch_segment.BranchSegment
        Segment whose ``end`` is an `End`.
    """
    return segment._replace(end=End[segment.end.name])


def parse_end(text):
    """Return the `End` that a text describes, for old branch files, which store only the text.

    Parameters
    ----------
    text : str
        Text of an `EndReason`.

    Returns
    -------
    End
        The reason.

    Raises
    ------
    ValueError
        If no member of `End` has such a text.
    """
    return _match_reason_text(text)[0]


def rescale_reason_text(text, unit_factor):
    """Convert the value in a text to another unit.

    Parameters
    ----------
    text : str
        Text of an `EndReason`.
    unit_factor : float
        Value of the old unit in the new unit.

    Returns
    -------
    str
        Text with the value multiplied by `unit_factor`.
    """
    _, text_match = _match_reason_text(text)
    if not text_match.groups():
        return text
    return f"{text[: text_match.start(1)]}{float(text_match[1]) * unit_factor:.12g}{text[text_match.end(1) :]}"


def _match_reason_text(text):
    """Return (`End`, match) of a text; the first group of the match is the value, if the text contains a value."""
    for end in End:
        text_pattern = re.sub(r"\\{value[^}]*\\}", r"(\\S+)", re.escape(end.value)).replace(r"\{kind\}", ".+")
        text_match = re.fullmatch(text_pattern, text)
        if text_match:
            return end, text_match
    raise ValueError(f"unknown reason for the end of a branch: {text!r}")

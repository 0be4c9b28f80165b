"""Reasons for the end of a branch or a locus, with their texts."""

import re
from enum import Enum
from typing import NamedTuple


class End(Enum):
    """Reason for the end of a branch.

    The value of a member is its text. ``{value}`` stands for the value of the parameter, and ``{kind}`` for the kind of
    the special point at which the branch stops, or which it left. The texts are stored in files and parsed.

    Notes
    -----
    BOUND, DOMAIN and STOPPED are the user's limits: a bound, the end of a parameter's domain, a kind of `stop`.
    MAX_POINTS and MAX_SECONDS are limits of the computation, and `extend` resumes there. CLOSED is a closed branch.
    STEP, POINTS, NUMBER and HALVED are failures: too small a step, too many points, a number that is not finite, an
    orbit of a shorter period. GRAZE, REST, CHATTER and UNSETTLED are grazings and sticking beyond which no orbit of
    this kind continues. START and LEFT are the start of a branch: the initial orbit, or the special point that it left.
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
        """Make a `Reason` with the text filled in."""
        return Reason(self, self.value.format(value=value, kind=kind))


RESUMABLE_ENDS = End.MAX_POINTS, End.MAX_SECONDS  # ends that a later call can continue from


class Reason(NamedTuple):
    """Reason for the end of a branch.

    Attributes
    ----------
    end : End
        Reason, on which decisions depend.
    text : str
        Text, for display.
    """

    end: End
    text: str


def convert_end(segment):
    """Replace the end of a continued segment by the member of `End` of the same name.

    Parameters
    ----------
    segment : continuation.branch_segment.BranchSegment
        Segment.

    Returns
    -------
    continuation.branch_segment.BranchSegment
        Segment whose ``end`` is an `End`.
    """
    return segment._replace(end=End[segment.end.name])


def parse_end(text):
    """Return the reason that a text describes.

    Older files of branches store only the text.

    Parameters
    ----------
    text : str
        Text of a `Reason`.

    Returns
    -------
    End
        The reason.

    Raises
    ------
    ValueError
        If the text belongs to no reason.
    """
    return _parse_reason(text)[0]


def rescale_reason(text, factor):
    """Convert the value in a text to another unit.

    Parameters
    ----------
    text : str
        Text of a `Reason`.
    factor : float
        Old unit in the new unit.

    Returns
    -------
    str
        Text with the value multiplied by `factor`.
    """
    _, match = _parse_reason(text)
    if not match.groups():
        return text
    return f"{text[: match.start(1)]}{float(match[1]) * factor:.12g}{text[match.end(1) :]}"


def _parse_reason(text):
    """Return the `End` of a text and the match, whose first group is the value if there is one."""
    for end in End:
        pattern = re.sub(r"\\{value[^}]*\\}", r"(\\S+)", re.escape(end.value)).replace(r"\{kind\}", ".+")
        match = re.fullmatch(pattern, text)
        if match:
            return end, match
    raise ValueError(f"unknown reason for the end of a branch: {text!r}")

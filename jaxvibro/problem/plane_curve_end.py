"""Describe the end of a curve in the plane of two parameters."""

import re

from .end import End

REASON_TEXTS = {
    End.BOUND: "{name} reached its bound {value:.12g}",
    End.DOMAIN: "the domain of {name} ends at {value:.12g}",
    End.CLOSED: "it closes: the curve came back to its start",
    End.STEP: "the step became too small: Newton's method does not converge there",
    End.GRAZE: "an impact loses its speed there, a flight touches a wall, or a rest ends",
    End.POINTS: "it has too many points",
    End.MAX_POINTS: "max_points reached",
    End.MAX_SECONDS: "max_seconds reached",
}


def describe_end(end: End, name: str, value: float) -> str:
    """Describe the end of a curve in the plane of two parameters.

    Parameters
    ----------
    end : End
        Reason for the end.
    name : str
        Parameter that ended the curve.
    value : float
        Its value.

    Returns
    -------
    str
        Text.
    """
    return REASON_TEXTS.get(end, REASON_TEXTS[End.STEP]).format(name=name, value=value)


def rescale_end_text(text: str, factors: dict[str, float]) -> str:
    """Convert the parameter value in a text to another unit.

    Parameters
    ----------
    text : str
        Text from `describe_end`.
    factors : dict of str to float
        For each parameter the old unit in the new unit.

    Returns
    -------
    str
        Text with the value multiplied by the factor.
    """
    match = re.fullmatch(r"(?:the domain of )?(\S+) (?:reached its bound|ends at) (\S+)", text)
    factor = factors.get(match[1], 1.0) if match else 1.0
    return f"{text[: match.start(2)]}{float(match[2]) * factor:.12g}" if match and factor != 1.0 else text

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


def describe_end(end: End, parameter_name: str, parameter_value: float) -> str:
    """Describe the end of a curve in the plane of two parameters.

    Parameters
    ----------
    end : End
        Reason for the end.
    parameter_name : str
        Parameter that ended the curve.
    parameter_value : float
        Value of the parameter.

    Returns
    -------
    str
        Text for display.
    """
    return REASON_TEXTS.get(end, REASON_TEXTS[End.STEP]).format(name=parameter_name, value=parameter_value)


def rescale_end_text(text: str, unit_factors: dict[str, float]) -> str:
    """Convert the parameter value in a text to another unit.

    Parameters
    ----------
    text : str
        Text from `describe_end`.
    unit_factors : dict of str to float
        For each parameter the value of the old unit in the new unit.

    Returns
    -------
    str
        Text with the value multiplied by the factor of the parameter.
    """
    text_match = re.fullmatch(r"(?:the domain of )?(\S+) (?:reached its bound|ends at) (\S+)", text)
    unit_factor = unit_factors.get(text_match[1], 1.0) if text_match else 1.0
    return (
        f"{text[: text_match.start(2)]}{float(text_match[2]) * unit_factor:.12g}"
        if text_match and unit_factor != 1.0
        else text
    )

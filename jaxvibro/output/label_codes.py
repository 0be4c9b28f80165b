"""Encode orbit labels as integers, and translate kinds of special points to the labels of other programs.

The label P n p q denotes an orbit with n drive periods, p impacts on the left wall and q on the right wall. Its code is
1,000,000 n + 1,000 p + q. The count 999 stands for infinitely many impacts.
"""

import numpy as np
from jaxtyping import ArrayLike, Int

from ..scene import check

NOT_DONE, UNDECIDED, CHAOTIC = -1, 0, 1
CODE_WORDS = {NOT_DONE: "not done", UNDECIDED: "undecided", CHAOTIC: "chaotic"}
INFINITE_COUNT = 999  # stands for the infinitely many impacts of complete chatter
PERIODS_FACTOR, LEFT_FACTOR = 1_000_000, 1_000
CODE_RULE = "1000000 n + 1000 p + q for P n p q, 999 for inf; 1 chaotic, 0 undecided, -1 not done"


def label_code_from_counts(
    periods: Int[ArrayLike, "..."],
    n_left: Int[ArrayLike, "..."],
    n_right: Int[ArrayLike, "..."],
    chatter_wall_codes: Int[ArrayLike, "..."] = 0,
) -> Int[np.ndarray, "..."]:
    """Encode the labels of orbits.

    Parameters
    ----------
    periods : array_like
        Number of drive periods of each orbit.
    n_left : array_like
        Number of impacts on the left wall; numbers above 998 are encoded as 998.
    n_right : array_like
        Number of impacts on the right wall; numbers above 998 are encoded as 998.
    chatter_wall_codes : array_like, optional
        Walls at which the mass sticks after complete chatter: 0 none, 1 left, 2 right, 3 both.

    Returns
    -------
    ndarray
        Label codes.
    """
    has_chatter_by_wall = [np.asarray(chatter_wall_codes) & wall_bit for wall_bit in (1, 2)]
    n_left, n_right = (
        np.where(has_chatter, INFINITE_COUNT, np.minimum(n_impacts, INFINITE_COUNT - 1))
        for has_chatter, n_impacts in zip(has_chatter_by_wall, (n_left, n_right), strict=True)
    )
    return np.asarray(PERIODS_FACTOR * np.asarray(periods) + LEFT_FACTOR * n_left + n_right, np.int32)


def period_of(code: Int[ArrayLike, "..."]) -> Int[np.ndarray, "..."]:
    """Return the number of drive periods of each label code, 0 for codes of no periodic orbit.

    Parameters
    ----------
    code : array_like
        Label codes.

    Returns
    -------
    ndarray
        Numbers of drive periods.
    """
    return np.asarray(np.maximum(code, 0) // PERIODS_FACTOR)


def label_of(code: int | np.integer) -> str:
    """Return the label of a code.

    Parameters
    ----------
    code : int
        Code.

    Returns
    -------
    str
        Label such as ``"P111"`` or ``"P1-0-inf"``, or ``"chaotic"``, ``"undecided"`` or ``"not done"``.
    """
    code = int(code)
    if code in CODE_WORDS:
        return CODE_WORDS[code]
    label_counts = code // PERIODS_FACTOR, code // LEFT_FACTOR % 1000, code % 1000
    count_texts = ["inf" if label_count == INFINITE_COUNT else str(label_count) for label_count in label_counts]
    return "P" + ("" if all(len(count_text) == 1 for count_text in count_texts) else "-").join(count_texts)


# Kinds without a counterpart keep their label: neither program has GR, CH or RL.
FOREIGN_LABELS = {
    "auto": {"SN": "LP", "SB": "BP", "NS": "TR", "NSA": "NSA"},
    "matcont": {"SN": "LPC", "SB": "BPC", "BP": "BPC", "NSA": "NS", "CP": "CPC"},
}
LABEL_SYSTEMS = ("jaxvibro", *FOREIGN_LABELS)


def translate_label(kind: str, label_system: str) -> str:
    """Translate a kind of special point into the label of another program.

    Parameters
    ----------
    kind : str
        Kind of special point.
    label_system : {"jaxvibro", "auto", "matcont"}
        Program whose labels are used. For MatCont these are the labels for limit cycles.

    Returns
    -------
    str
        Label. Kinds without a counterpart are unchanged.

    Raises
    ------
    ArgumentError
        If `label_system` is unknown.
    """
    if not isinstance(label_system, str) or label_system not in LABEL_SYSTEMS:
        raise check.ArgumentError("labels", f"must be one of {', '.join(LABEL_SYSTEMS)}", label_system)
    return FOREIGN_LABELS.get(label_system, {}).get(kind, kind)

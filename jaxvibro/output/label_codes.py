"""Encode labels as integers, for large arrays: P n p q is 1,000,000 n + 1,000 p + q, with 999 for inf."""

import re

import numpy as np
from jaxtyping import ArrayLike, Int

NOT_DONE, UNDECIDED, CHAOTIC = -1, 0, 1
CODE_WORDS = {NOT_DONE: "not done", UNDECIDED: "undecided", CHAOTIC: "chaotic"}
INFINITE_COUNT = 999  # stands for the infinitely many impacts of complete chatter
PERIODS_FACTOR, LEFT_FACTOR = 1_000_000, 1_000
CODE_RULE = "1000000 n + 1000 p + q for P n p q, 999 for inf; 1 chaotic, 0 undecided, -1 not done"


def encode_labels(
    periods: Int[ArrayLike, "..."],
    n_left: Int[ArrayLike, "..."],
    n_right: Int[ArrayLike, "..."],
    chatter_walls: Int[ArrayLike, "..."] = 0,
) -> Int[np.ndarray, "..."]:
    """Encode the labels of orbits.

    Parameters
    ----------
    periods : array_like
        Drive periods.
    n_left : array_like
        Impacts on the left wall; more than 998 count as 998.
    n_right : array_like
        Impacts on the right wall; more than 998 count as 998.
    chatter_walls : array_like, optional
        Walls at which the mass sticks after complete chatter: 1 left, 2 right, 3 both.

    Returns
    -------
    ndarray
        Codes.
    """
    chatters_by_wall = [np.asarray(chatter_walls) & bit for bit in (1, 2)]
    n_left, n_right = (
        np.where(chatters, INFINITE_COUNT, np.minimum(n_impacts, INFINITE_COUNT - 1))
        for chatters, n_impacts in zip(chatters_by_wall, (n_left, n_right), strict=True)
    )
    return np.asarray(PERIODS_FACTOR * np.asarray(periods) + LEFT_FACTOR * n_left + n_right, np.int32)


def period_of(code: Int[ArrayLike, "..."]) -> Int[np.ndarray, "..."]:
    """Return the drive periods of the orbits with these codes; 0 for chaotic and undecided ones.

    Parameters
    ----------
    code : array_like
        Codes.

    Returns
    -------
    ndarray
        Drive periods.
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
    counts = code // PERIODS_FACTOR, code // LEFT_FACTOR % 1000, code % 1000
    numbers = ["inf" if count == INFINITE_COUNT else str(count) for count in counts]
    return "P" + ("" if all(len(number) == 1 for number in numbers) else "-").join(numbers)


def code_of(label: str) -> int:
    """Return the code of a label.

    Parameters
    ----------
    label : str
        Label.

    Returns
    -------
    int
        Code; that of ``"undecided"`` for an invalid label.
    """
    for code, word in CODE_WORDS.items():
        if label == word:
            return code
    match = re.fullmatch(r"P(\d)(\d)(\d)|P(\d+)-(\d+|inf)-(\d+|inf)", label)
    if match is None:
        return UNDECIDED
    n, p, q = (INFINITE_COUNT if part == "inf" else int(part) for part in match.groups() if part is not None)
    return PERIODS_FACTOR * n + LEFT_FACTOR * p + q

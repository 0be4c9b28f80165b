"""Labels as whole numbers, for arrays of very many: P n p q is 1,000,000 n + 1,000 p + q, 999 standing for inf."""

import re

import numpy as np
from jaxtyping import ArrayLike, Int

NOT_DONE, UNDECIDED, CHAOTIC = -1, 0, 1
CODE_WORDS = {NOT_DONE: "not done", UNDECIDED: "undecided", CHAOTIC: "chaotic"}
INFINITE_COUNT = 999  # impacts without end, of complete chatter
PERIODS_FACTOR, LEFT_FACTOR = 1_000_000, 1_000
CODE_RULE = "1000000 n + 1000 p + q for P n p q, 999 for inf; 1 chaotic, 0 undecided, -1 not done"


def encode_labels(
    periods: Int[ArrayLike, "..."],
    n_left: Int[ArrayLike, "..."],
    n_right: Int[ArrayLike, "..."],
    chatter_walls: Int[ArrayLike, "..."] = 0,
) -> Int[np.ndarray, "..."]:
    """Those of orbits of so many drive periods, with so many impacts on the walls; more than 998 count as 998.

    chatter_walls: on which walls the mass comes to rest by complete chatter: 1 left, 2 right, 3 both.
    """
    chatters_by_wall = [np.asarray(chatter_walls) & bit for bit in (1, 2)]
    n_left, n_right = (
        np.where(chatters, INFINITE_COUNT, np.minimum(n_impacts, INFINITE_COUNT - 1))
        for chatters, n_impacts in zip(chatters_by_wall, (n_left, n_right), strict=True)
    )
    return np.asarray(PERIODS_FACTOR * np.asarray(periods) + LEFT_FACTOR * n_left + n_right, np.int32)


def period_of(code: Int[ArrayLike, "..."]) -> Int[np.ndarray, "..."]:
    """Drive periods of the orbits with these codes; 0 of chaos and of what is undecided."""
    return np.asarray(np.maximum(code, 0) // PERIODS_FACTOR)


def label_of(code: int | np.integer) -> str:
    """The label of a code, as of an attractor: P111, P1-0-inf, "chaotic", "undecided", "not done"."""
    code = int(code)
    if code in CODE_WORDS:
        return CODE_WORDS[code]
    counts = code // PERIODS_FACTOR, code // LEFT_FACTOR % 1000, code % 1000
    numbers = ["inf" if count == INFINITE_COUNT else str(count) for count in counts]
    return "P" + ("" if all(len(number) == 1 for number in numbers) else "-").join(numbers)


def code_of(label: str) -> int:
    """The code of a label; that of what is undecided for one that is none."""
    for code, word in CODE_WORDS.items():
        if label == word:
            return code
    match = re.fullmatch(r"P(\d)(\d)(\d)|P(\d+)-(\d+|inf)-(\d+|inf)", label)
    if match is None:
        return UNDECIDED
    n, p, q = (INFINITE_COUNT if part == "inf" else int(part) for part in match.groups() if part is not None)
    return PERIODS_FACTOR * n + LEFT_FACTOR * p + q

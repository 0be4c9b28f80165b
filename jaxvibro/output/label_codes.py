"""Labels as whole numbers, for arrays of very many: P n p q is 1,000,000 n + 1,000 p + q, 999 standing for inf."""

import re

import numpy as np
from jaxtyping import ArrayLike, Int

NOT_DONE, UNDECIDED, CHAOTIC = -1, 0, 1
WORDS = {NOT_DONE: "not done", UNDECIDED: "undecided", CHAOTIC: "chaotic"}
ENDLESS = 999  # impacts without end, of complete chatter
PERIODS, LEFT = 1_000_000, 1_000
RULE = "1000000 n + 1000 p + q for P n p q, 999 for inf; 1 chaotic, 0 undecided, -1 not done"


def codes(
    periods: Int[ArrayLike, "..."],
    left: Int[ArrayLike, "..."],
    right: Int[ArrayLike, "..."],
    endless: Int[ArrayLike, "..."] = 0,
) -> Int[np.ndarray, "..."]:
    """Those of orbits of so many drive periods, with so many impacts on the walls; more than 998 count as 998.

    endless: on which walls the mass comes to rest by complete chatter: 1 left, 2 right, 3 both.
    """
    rests = [np.asarray(endless) & bit for bit in (1, 2)]
    left, right = (
        np.where(rest, ENDLESS, np.minimum(hits, ENDLESS - 1)) for rest, hits in zip(rests, (left, right), strict=True)
    )
    return np.asarray(PERIODS * np.asarray(periods) + LEFT * left + right, np.int32)


def period_of(code: Int[ArrayLike, "..."]) -> Int[np.ndarray, "..."]:
    """Drive periods of the orbits with these codes; 0 of chaos and of what is undecided."""
    return np.asarray(np.maximum(code, 0) // PERIODS)


def label_of(code: int | np.integer) -> str:
    """The label of a code, as of an attractor: P111, P1-0-inf, "chaotic", "undecided", "not done"."""
    code = int(code)
    if code in WORDS:
        return WORDS[code]
    counts = code // PERIODS, code // LEFT % 1000, code % 1000
    numbers = ["inf" if count == ENDLESS else str(count) for count in counts]
    return "P" + ("" if all(len(number) == 1 for number in numbers) else "-").join(numbers)


def code_of(label: str) -> int:
    """The code of a label; that of what is undecided for one that is none."""
    for code, word in WORDS.items():
        if label == word:
            return code
    parts = re.fullmatch(r"P(\d)(\d)(\d)|P(\d+)-(\d+|inf)-(\d+|inf)", label)
    if parts is None:
        return UNDECIDED
    n, p, q = (ENDLESS if part == "inf" else int(part) for part in parts.groups() if part is not None)
    return PERIODS * n + LEFT * p + q

"""Shares of random starts, and how well they are known."""

import scipy

LEVEL = 0.05  # how often the bounds may be wrong


def share_bounds(count, starts):
    """(lowest, highest) share that `count` of so many starts speak for: exact at 95 % (Clopper and Pearson, 1934).

    Where no start did, or each, there is one bound alone, which has all of the 5 %: 0 of 200 is below 1.5 %.
    """
    one_sided = count in (0, starts)
    tail = LEVEL if one_sided else 0.5 * LEVEL
    low = float(scipy.special.betaincinv(count, starts - count + 1, tail)) if count else 0.0
    high = float(scipy.special.betaincinv(count + 1, starts - count, 1.0 - tail)) if count < starts else 1.0
    return low, high


def share_text(one):
    """An `Attractor`'s share for reading: "46.0 % of starts (38.9 to 53.2 %)", "0 of 200 starts: below 1.5 %"."""
    low, high = (f"{100.0 * bound:.1f} %" for bound in one.share_bounds)
    count = round(one.share * one.starts)
    if count == 0:
        return f"0 of {one.starts} starts: below {high}"
    if count == one.starts:
        return f"{count} of {one.starts} starts: above {low}"
    return f"{100.0 * one.share:.1f} % of starts ({low[:-2]} to {high})"

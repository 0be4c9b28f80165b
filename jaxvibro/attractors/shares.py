"""Shares of random starts, and how well they are known."""

import scipy

SIGNIFICANCE_LEVEL = 0.05  # how often the bounds may be wrong


def share_bounds(n_settled, n_starts):
    """(lowest, highest) share that `n_settled` of so many starts speak for: exact at 95 % (Clopper and Pearson, 1934).

    Where no start did, or each, there is one bound alone, which has all of the 5 %: 0 of 200 is below 1.5 %.
    """
    is_one_sided = n_settled in (0, n_starts)
    tail_probability = SIGNIFICANCE_LEVEL if is_one_sided else 0.5 * SIGNIFICANCE_LEVEL
    lower = float(scipy.special.betaincinv(n_settled, n_starts - n_settled + 1, tail_probability)) if n_settled else 0.0
    upper = (
        float(scipy.special.betaincinv(n_settled + 1, n_starts - n_settled, 1.0 - tail_probability))
        if n_settled < n_starts
        else 1.0
    )
    return lower, upper


def share_text(attractor):
    """An `Attractor`'s share for reading: "46.0 % of starts (38.9 to 53.2 %)", "0 of 200 starts: below 1.5 %"."""
    lower, upper = (f"{100.0 * bound:.1f} %" for bound in attractor.share_bounds)
    n_settled = round(attractor.share * attractor.starts)
    if n_settled == 0:
        return f"0 of {attractor.starts} starts: below {upper}"
    if n_settled == attractor.starts:
        return f"{n_settled} of {attractor.starts} starts: above {lower}"
    return f"{100.0 * attractor.share:.1f} % of starts ({lower[:-2]} to {upper})"

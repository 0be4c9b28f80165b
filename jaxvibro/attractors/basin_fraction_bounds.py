"""Compute bounds of basin fractions and format them."""

import scipy

SIGNIFICANCE_LEVEL = 0.05  # probability that the bounds are wrong


def compute_share_bounds(n_settled, n_starts):
    """Return the exact bounds of a fraction at 95 % confidence (Clopper and Pearson, 1934).

    Parameters
    ----------
    n_settled : int
        Number of initial states on the attractor.
    n_starts : int
        Number of initial states.

    Returns
    -------
    lower, upper : float
        Bounds. If none or all of the initial states are on the attractor, the only nontrivial bound takes the whole
        error probability of 5 %. For 0 of 200 the upper bound is 1.5 %.
    """
    is_one_sided = n_settled in (0, n_starts)
    tail_probability = SIGNIFICANCE_LEVEL if is_one_sided else 0.5 * SIGNIFICANCE_LEVEL
    lower_bound = (
        float(scipy.special.betaincinv(n_settled, n_starts - n_settled + 1, tail_probability)) if n_settled else 0.0
    )
    upper_bound = (
        float(scipy.special.betaincinv(n_settled + 1, n_starts - n_settled, 1.0 - tail_probability))
        if n_settled < n_starts
        else 1.0
    )
    return lower_bound, upper_bound


def format_share(attractor):
    """Format the share of an attractor.

    Parameters
    ----------
    attractor : Attractor
        Attractor.

    Returns
    -------
    str
        For example ``"46.0 % of starts (38.9 to 53.2 %)"`` or ``"0 of 200 starts: below 1.5 %"``.
    """
    lower_text, upper_text = (f"{100.0 * bound:.1f} %" for bound in attractor.share_bounds)
    n_settled = round(attractor.share * attractor.starts)
    if n_settled == 0:
        return f"0 of {attractor.starts} starts: below {upper_text}"
    if n_settled == attractor.starts:
        return f"{n_settled} of {attractor.starts} starts: above {lower_text}"
    return f"{100.0 * attractor.share:.1f} % of starts ({lower_text[:-2]} to {upper_text})"

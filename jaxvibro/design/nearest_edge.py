"""The point of a boundary's edge that is nearest to a scene.

It is a root of the whole condition of Karush, Kuhn and Tucker: with w the times, speeds, null vector and offset y, and
r(w) = 0 the edge's equations, stationary is y y / 2 + m r(w), by Newton's method in w and the multipliers m.
"""

import jax
import numpy as np

from ..scene.codes import SolutionStatus
from .edge import clearances
from .nearest import Foot

CLOSING = 30  # of Gauss and Newton's steps onto the edge
ROUNDS = 40  # of Newton's on the condition
FAR = 0.3  # of 1 + the largest unknown: the longest step
APART = 1e-5  # of 1 + the largest unknown: the points of a difference
SHARP = 1e-10  # of 1 + the largest unknown: a step as short is the last
TINY = 1e-300


@jax.jit
def _terms(edge, numbers, units, rows):
    """(r, its derivative) by unknowns and offsets in rows."""
    free = len(units)

    def zero(w):
        return edge.zero(w[:-free], numbers + w[-free:] @ units)

    return jax.vmap(zero)(rows), jax.vmap(jax.jacfwd(zero))(rows)


def nearest_on(edge, unknowns, numbers, units, offset):
    """The `Foot` that Newton's method reaches from a guess; None where it reaches none, or fewer than two numbers
    are free. Arguments as of `nearest.nearest`."""
    size, free = len(unknowns), len(offset)
    if free < 2:
        return None
    joined = np.concatenate([unknowns, offset])
    wanted = np.concatenate([np.zeros(size), np.ones(free)])

    def terms(joined):
        """(r, its derivative, and that's derivative, of differences: it only points the way)."""
        apart = APART * (1.0 + abs(joined).max())
        shifts = apart * np.eye(len(joined))
        rows = joined + np.concatenate([shifts, -shifts, np.zeros((1, len(joined)))])
        left, slopes = jax.device_get(_terms(edge, numbers, units, rows))
        up, down = slopes[: len(joined)], slopes[len(joined) : -1]
        return left[-1], slopes[-1], (up - down) / (2.0 * apart)

    def bent(bends, multipliers):
        whole = np.einsum("iej,e->ij", bends, multipliers)
        return 0.5 * (whole + whole.T) + np.diag(wanted)

    for _ in range(CLOSING):
        left, slopes, _ = terms(joined)
        if not np.isfinite(slopes).all():
            return None
        step = _shortened(-np.linalg.lstsq(slopes, left, rcond=None)[0], joined)
        joined = joined + step
        if abs(step).max() <= SHARP * (1.0 + abs(joined).max()):
            break
    else:
        return None
    multipliers = -np.linalg.lstsq(slopes.T, wanted * joined, rcond=None)[0]
    for _ in range(ROUNDS):
        left, slopes, bends = terms(joined)
        if not np.isfinite(bends).all():
            return None
        whole = np.block([[bent(bends, multipliers), slopes.T], [slopes, np.zeros((size + 2, size + 2))]])
        found = np.linalg.lstsq(whole, -np.concatenate([wanted * joined, left]), rcond=None)[0]
        step = _shortened(found[: size + free], joined)
        joined, multipliers = joined + step, found[size + free :]
        if abs(step).max() <= SHARP * (1.0 + abs(joined).max()):
            break
    else:
        return None
    left, slopes, bends = terms(joined)
    along = np.linalg.svd(slopes)[2][size + 2 :]
    slope = float(abs(wanted * joined + slopes.T @ multipliers).max())
    curved = np.linalg.eigvalsh(along @ bent(bends, multipliers) @ along.T) if len(along) else np.zeros(0)
    unknowns, offset = joined[:size], joined[size:]
    seen = jax.device_get(clearances(edge.point, unknowns, numbers + offset @ units))
    real = (seen.clear >= -seen.slack).all() and (seen.speeds >= -seen.slack).all() and (seen.time > 0).all()
    status = SolutionStatus.OK if real else SolutionStatus.VIRTUAL
    return Foot(edge, unknowns, offset, slope, curved, float(abs(left).max()), int(status))


def _shortened(step, joined):
    return step * min(1.0, FAR * (1.0 + abs(joined).max()) / max(abs(step).max(), TINY))

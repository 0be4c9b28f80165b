"""How mixed a picture of labels is: basin entropy and the dimension of the boundaries. Labels below 0 are left out."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

BOX = 5  # labels along the side of a box of the entropies: 25 in it, as the source takes
LARGEST = 8  # boxes of the largest size lie across the picture, at least
BAND = 64  # rows of boxes that are looked at together
FULL = 0.2  # of the boxes: where more are mixed, several boundaries meet in a box


class Dimension(NamedTuple):
    """The boundaries' dimension by counting boxes, its error, the sides of the boxes (cells), the share mixed."""

    value: float
    error: float
    sides: Int[np.ndarray, " sides"]
    mixed: Float[np.ndarray, " sides"]


def entropies(labels, box=BOX):
    """(basin entropy, boundary basin entropy) of a picture of labels (rows, columns), in nats.

    A box of box x box labels in shares p_k has the entropy -sum p_k ln p_k. The first is the mean over all boxes, the
    second over those with more than one label, 0 where there is none: above ln 2 the boundary is fractal. nan where the
    picture holds no whole box. Daza, Wagemakers, Georgeot, Guery-Odelin and Sanjuan, Sci. Rep. 6, 31416 (2016).
    """
    rows, columns = (size // box for size in labels.shape)
    parts = [_in_boxes(labels[k * box : (k + BAND) * box], columns, box) for k in range(0, rows, BAND)]
    each, mixed = (np.concatenate(part) for part in zip(*parts, strict=True)) if parts else (np.empty(0), np.empty(0))
    if not each.size:
        return np.nan, np.nan
    return float(each.mean()), float(each[mixed].mean()) if mixed.any() else 0.0


def _in_boxes(labels, columns, box):
    """(the entropy, whether there is more than one label) of the whole boxes of some rows that have any label."""
    rows = len(labels) // box
    cut = labels[: rows * box, : columns * box].reshape(rows, box, columns, box).swapaxes(1, 2).reshape(-1, box * box)
    counts = np.array([(cut == one).sum(axis=1) for one in np.unique(cut) if one >= 0]).reshape(-1, len(cut))
    counts = counts[:, counts.any(axis=0)]
    shares = counts / counts.sum(axis=0)
    return -scipy.special.xlogy(shares, shares).sum(axis=0), (counts > 0).sum(axis=0) > 1


def dimension(labels):
    """The `Dimension` of the boundaries in a picture of labels (rows, columns), by counting boxes.

    The labels are those of the corners of a lattice's cells. A box of b x b cells is mixed if its corners, on its rim
    too, have more than one label: the share of mixed boxes goes like b^(2 - D). A line is fitted through the logarithms
    for b = 1, 2, 4, ... as long as at most a fifth of the boxes are mixed, or through the first three. error: the fit's
    standard error, or half of the difference between the slopes of its two halves where that is larger. value and error
    are nan where no box is mixed or the picture has no three sizes.
    """
    labels = labels.astype(np.int8) if labels.max(initial=0) < np.iinfo(np.int8).max else labels
    none = np.iinfo(labels.dtype).max
    low = _corners(np.where(labels < 0, none, labels), np.minimum)
    high = _corners(np.maximum(labels, -1), np.maximum)
    sides = 2 ** np.arange(max(0, (min(low.shape) // LARGEST).bit_length()))
    mixed = np.array([_mixed(low, high, side) for side in sides])
    few = np.flatnonzero((mixed > 0) & (mixed <= FULL))
    used = few if len(few) >= 3 else np.flatnonzero(mixed > 0)[:3]
    if len(used) < 3:
        return Dimension(np.nan, np.nan, sides, mixed)
    across, up = np.log(sides[used]), np.log(mixed[used])
    slope, error = _line(across, up)
    half = len(used) // 2
    halves = [_line(across[part], up[part])[0] for part in (slice(half + 1), slice(half, None))]
    return Dimension(2.0 - slope, max(error, 0.5 * abs(halves[0] - halves[1])), sides, mixed)


def _corners(values, most):
    """The least or the largest of the corners of each cell."""
    across = most(values[:, :-1], values[:, 1:])
    return most(across[:-1], across[1:])


def _mixed(low, high, side):
    """The share of whole boxes with more than one label, of those that have any."""
    rows, columns = (size // side for size in low.shape)

    def boxes(values):
        return values[: rows * side, : columns * side].reshape(rows, side, columns, side)

    least, largest = boxes(low).min(axis=(1, 3)), boxes(high).max(axis=(1, 3))
    known = largest >= 0
    return float((largest > least)[known].mean()) if known.any() else 0.0


def _line(across, up):
    """The slope of the line of least squares, and its standard error."""
    centred = across - across.mean()
    slope = centred @ up / (centred @ centred)
    left = up - up.mean() - slope * centred
    free = len(up) - 2
    return slope, float(np.sqrt(left @ left / free / (centred @ centred))) if free > 0 else 0.0

"""Measure basin boundaries: basin entropy and boundary dimension. Labels below 0 are left out."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

BOX_SIZE = 5  # labels along the side of a box for the entropies, 25 in a box as in the source
MIN_BOXES_ACROSS = 8  # fewest boxes of the largest size across the grid
BOX_ROWS_PER_BATCH = 64  # rows of boxes evaluated together
MAX_MIXED_SHARE = 0.2  # fraction of mixed boxes above which several boundaries meet in a box


class BoundaryDimension(NamedTuple):
    """Box-counting dimension of the basin boundaries.

    Attributes
    ----------
    value : float
        Dimension.
    error : float
        Its error.
    box_sides : ndarray
        Sides of the boxes in cells.
    mixed_shares : ndarray
        Fraction of boxes with more than one label, for each side.
    """

    value: float
    error: float
    box_sides: Int[np.ndarray, " sides"]
    mixed_shares: Float[np.ndarray, " sides"]


def basin_entropies(labels, box_size=BOX_SIZE):
    """Return (basin entropy, boundary basin entropy), in nats, of a grid of labels (rows, columns).

    A box of box_size x box_size labels with fractions p_k has the entropy ``-sum p_k ln p_k``. The basin entropy is the
    mean over all boxes. The boundary basin entropy is the mean over the boxes with more than one label, 0 without such
    a box; above ln 2 the boundary is fractal. Both are nan if the grid contains no whole box. Source: Daza, Wagemakers,
    Georgeot, Guery-Odelin and Sanjuan, Sci. Rep. 6, 31416 (2016).
    """
    n_rows, n_columns = (size // box_size for size in labels.shape)
    batches = [
        _box_entropies(labels[k * box_size : (k + BOX_ROWS_PER_BATCH) * box_size], n_columns, box_size)
        for k in range(0, n_rows, BOX_ROWS_PER_BATCH)
    ]
    box_values, is_mixed = (
        (np.concatenate(arrays) for arrays in zip(*batches, strict=True)) if batches else (np.empty(0), np.empty(0))
    )
    if not box_values.size:
        return np.nan, np.nan
    return float(box_values.mean()), float(box_values[is_mixed].mean()) if is_mixed.any() else 0.0


def _box_entropies(labels, n_columns, box_size):
    """Return (entropy, True for more than one label) of the whole boxes of some rows that have any label."""
    n_rows = len(labels) // box_size
    boxes = (
        labels[: n_rows * box_size, : n_columns * box_size]
        .reshape(n_rows, box_size, n_columns, box_size)
        .swapaxes(1, 2)
        .reshape(-1, box_size * box_size)
    )
    counts = np.array([(boxes == label).sum(axis=1) for label in np.unique(boxes) if label >= 0]).reshape(
        -1, len(boxes)
    )
    counts = counts[:, counts.any(axis=0)]
    shares = counts / counts.sum(axis=0)
    return -scipy.special.xlogy(shares, shares).sum(axis=0), (counts > 0).sum(axis=0) > 1


def boundary_dimension(labels):
    """Return the `BoundaryDimension` of a grid of labels (rows, columns), by box counting.

    The labels belong to the corners of a lattice's cells. A box of b x b cells is mixed if its corners, those on its
    rim included, have more than one label. The fraction of mixed boxes scales as ``b^(2 - D)``. A line is fitted to the
    logarithms for b = 1, 2, 4, ... as long as at most a fifth of the boxes are mixed, or to the first three sides. The
    error is the standard error of the fit, or half the difference between the slopes of its two halves if that is
    larger. Value and error are nan if no box is mixed or fewer than three sides are available.
    """
    labels = labels.astype(np.int8) if labels.max(initial=0) < np.iinfo(np.int8).max else labels
    no_label = np.iinfo(labels.dtype).max
    min_labels = _corner_extremes(np.where(labels < 0, no_label, labels), np.minimum)
    max_labels = _corner_extremes(np.maximum(labels, -1), np.maximum)
    box_sides = 2 ** np.arange(max(0, (min(min_labels.shape) // MIN_BOXES_ACROSS).bit_length()))
    mixed_shares = np.array([_mixed_share(min_labels, max_labels, box_side) for box_side in box_sides])
    sparse_sizes = np.flatnonzero((mixed_shares > 0) & (mixed_shares <= MAX_MIXED_SHARE))
    fit_sizes = sparse_sizes if len(sparse_sizes) >= 3 else np.flatnonzero(mixed_shares > 0)[:3]
    if len(fit_sizes) < 3:
        return BoundaryDimension(np.nan, np.nan, box_sides, mixed_shares)
    log_sides, log_mixed = np.log(box_sides[fit_sizes]), np.log(mixed_shares[fit_sizes])
    slope, error = _fit_line(log_sides, log_mixed)
    middle = len(fit_sizes) // 2
    half_slopes = [
        _fit_line(log_sides[half_slice], log_mixed[half_slice])[0]
        for half_slice in (slice(middle + 1), slice(middle, None))
    ]
    return BoundaryDimension(
        2.0 - slope, max(error, 0.5 * abs(half_slopes[0] - half_slopes[1])), box_sides, mixed_shares
    )


def _corner_extremes(values, extreme):
    """Return the smallest or the largest label of the corners of each cell."""
    row_extremes = extreme(values[:, :-1], values[:, 1:])
    return extreme(row_extremes[:-1], row_extremes[1:])


def _mixed_share(min_labels, max_labels, box_side):
    """Return the fraction of whole boxes with more than one label, among those with any."""
    n_rows, n_columns = (size // box_side for size in min_labels.shape)

    def split_boxes(values):
        return values[: n_rows * box_side, : n_columns * box_side].reshape(n_rows, box_side, n_columns, box_side)

    box_min, box_max = split_boxes(min_labels).min(axis=(1, 3)), split_boxes(max_labels).max(axis=(1, 3))
    has_label = box_max >= 0
    return float((box_max > box_min)[has_label].mean()) if has_label.any() else 0.0


def _fit_line(x, y):
    """Return the slope of the least-squares line and its standard error."""
    x_centred = x - x.mean()
    slope = x_centred @ y / (x_centred @ x_centred)
    residual = y - y.mean() - slope * x_centred
    n_free = len(y) - 2
    return slope, float(np.sqrt(residual @ residual / n_free / (x_centred @ x_centred))) if n_free > 0 else 0.0

"""Measure basin boundaries on a grid of labels: basin entropy and boundary dimension. Labels below 0 are ignored."""

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
        Estimated error of the dimension, see `boundary_dimension`.
    box_sides : ndarray
        Side lengths of the boxes, in cells.
    mixed_fractions : ndarray
        Fraction of boxes with more than one label, for each side length.
    """

    value: float
    error: float
    box_sides: Int[np.ndarray, " sides"]
    mixed_fractions: Float[np.ndarray, " sides"]


def basin_entropies(labels, box_size=BOX_SIZE):
    """Return (basin entropy, boundary basin entropy), in nats, of a grid of labels (rows, columns).

    A box of box_size x box_size labels with fractions p_k of the labels of at least 0 has the entropy
    ``-sum p_k ln p_k``. The basin entropy is the mean over all boxes. The boundary basin entropy is the mean over the
    boxes with more than one label. The boundary basin entropy is 0 if no box has more than one label, and above ln 2
    only for a fractal boundary. Both entropies are nan if no whole box contains a label of at least 0. Source: Daza,
    Wagemakers, Georgeot, Guery-Odelin and Sanjuan, Sci. Rep. 6, 31416 (2016).
    """
    n_box_rows, n_box_columns = (axis_length // box_size for axis_length in labels.shape)
    row_batches = [
        _box_entropies(
            labels[first_box_row * box_size : (first_box_row + BOX_ROWS_PER_BATCH) * box_size], n_box_columns, box_size
        )
        for first_box_row in range(0, n_box_rows if n_box_columns else 0, BOX_ROWS_PER_BATCH)
    ]
    entropies, is_mixed = (
        (np.concatenate(batch_arrays) for batch_arrays in zip(*row_batches, strict=True))
        if row_batches
        else (np.empty(0), np.empty(0))
    )
    if not entropies.size:
        return np.nan, np.nan
    return float(entropies.mean()), float(entropies[is_mixed].mean()) if is_mixed.any() else 0.0


def _box_entropies(labels, n_box_columns, box_size):
    """Return (entropy, True for more than one label) of each whole box in some rows of the grid.

    Boxes in which all labels are below 0 are omitted.
    """
    n_box_rows = len(labels) // box_size
    box_labels = (
        labels[: n_box_rows * box_size, : n_box_columns * box_size]
        .reshape(n_box_rows, box_size, n_box_columns, box_size)
        .swapaxes(1, 2)
        .reshape(-1, box_size * box_size)
    )
    label_counts = np.array(
        [(box_labels == label).sum(axis=1) for label in np.unique(box_labels) if label >= 0]
    ).reshape(-1, len(box_labels))
    label_counts = label_counts[:, label_counts.any(axis=0)]
    label_fractions = label_counts / label_counts.sum(axis=0)
    return -scipy.special.xlogy(label_fractions, label_fractions).sum(axis=0), (label_counts > 0).sum(axis=0) > 1


def boundary_dimension(labels):
    """Return the `BoundaryDimension` of a grid of labels (rows, columns), by box counting.

    The labels belong to the corners of square cells. A box of b x b cells is mixed if the corners of its cells, those
    on its rim included, have more than one label. The fraction of mixed boxes scales as ``b^(2 - D)`` with the
    dimension D. A line is fitted to the logarithms of side and fraction, for the sides b = 1, 2, 4, ... at which some
    boxes, but at most a fifth, are mixed. If there are fewer than three such sides, the first three sides with mixed
    boxes are used. The
    error is the standard error of the slope, or half the difference between the slopes of the two halves of the data if
    that is larger. Value and error are nan if fewer than three sides have mixed boxes.
    """
    labels = labels.astype(np.int8) if labels.max(initial=0) < np.iinfo(np.int8).max else labels
    no_label_value = np.iinfo(labels.dtype).max
    min_corner_labels = _corner_extremes(np.where(labels < 0, no_label_value, labels), np.minimum)
    max_corner_labels = _corner_extremes(np.maximum(labels, -1), np.maximum)
    box_sides = 2 ** np.arange(max(0, (min(min_corner_labels.shape) // MIN_BOXES_ACROSS).bit_length()))
    mixed_fractions = np.array(
        [_mixed_box_fraction(min_corner_labels, max_corner_labels, box_side) for box_side in box_sides]
    )
    sparse_side_indices = np.flatnonzero((mixed_fractions > 0) & (mixed_fractions <= MAX_MIXED_SHARE))
    fit_side_indices = sparse_side_indices if len(sparse_side_indices) >= 3 else np.flatnonzero(mixed_fractions > 0)[:3]
    if len(fit_side_indices) < 3:
        return BoundaryDimension(np.nan, np.nan, box_sides, mixed_fractions)
    log_sides, log_mixed_fractions = np.log(box_sides[fit_side_indices]), np.log(mixed_fractions[fit_side_indices])
    slope, error = _fit_line(log_sides, log_mixed_fractions)
    middle_index = len(fit_side_indices) // 2
    half_slopes = [
        _fit_line(log_sides[half_slice], log_mixed_fractions[half_slice])[0]
        for half_slice in (slice(middle_index + 1), slice(middle_index, None))
    ]
    return BoundaryDimension(
        2.0 - slope, max(error, 0.5 * abs(half_slopes[0] - half_slopes[1])), box_sides, mixed_fractions
    )


def _corner_extremes(corner_labels, extreme_function):
    """Return the smallest or the largest label of the four corners of each cell."""
    column_pair_extremes = extreme_function(corner_labels[:, :-1], corner_labels[:, 1:])
    return extreme_function(column_pair_extremes[:-1], column_pair_extremes[1:])


def _mixed_box_fraction(min_corner_labels, max_corner_labels, box_side):
    """Return the fraction of mixed boxes among the whole boxes that have a label of at least 0."""
    n_box_rows, n_box_columns = (axis_length // box_side for axis_length in min_corner_labels.shape)

    def split_into_boxes(cell_labels):
        return cell_labels[: n_box_rows * box_side, : n_box_columns * box_side].reshape(
            n_box_rows, box_side, n_box_columns, box_side
        )

    min_box_labels, max_box_labels = (
        split_into_boxes(min_corner_labels).min(axis=(1, 3)),
        split_into_boxes(max_corner_labels).max(axis=(1, 3)),
    )
    has_label = max_box_labels >= 0
    return float((max_box_labels > min_box_labels)[has_label].mean()) if has_label.any() else 0.0


def _fit_line(abscissae, ordinates):
    """Return the slope of the least-squares line and its standard error."""
    centred_abscissae = abscissae - abscissae.mean()
    slope = centred_abscissae @ ordinates / (centred_abscissae @ centred_abscissae)
    residual = ordinates - ordinates.mean() - slope * centred_abscissae
    n_degrees_of_freedom = len(ordinates) - 2
    return slope, float(
        np.sqrt(residual @ residual / n_degrees_of_freedom / (centred_abscissae @ centred_abscissae))
    ) if n_degrees_of_freedom > 0 else 0.0

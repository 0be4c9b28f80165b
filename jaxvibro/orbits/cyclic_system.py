"""Solve cyclic block systems: two equations and two unknowns for each impact, coupled to the next impact.

The system may also contain parameters and as many border rows. Givens rotations eliminate the unknowns impact by
impact. The unknowns of the first impact and the parameters remain, for the closure of the cycle. There is no division
by speeds, so that a branch can pass through speed zero.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Int

from continuation.array_type import Array
from continuation.newton import LinearSolution, solve


class CyclicBlockMatrix(NamedTuple):
    """Block matrix of a cyclic system.

    Attributes
    ----------
    diagonal : Array
        Derivative of each row with respect to its own time and speed, of shape (rows, 2, 2).
    coupling : Array
        Derivative of each row with respect to the time and speed of the next row, of shape (rows, 2, 2).
    param_blocks : Array
        Derivative of each row with respect to the parameters, of shape (rows, 2, parameters).
    last_row : Array of int
        Index of the row of the last impact, which precedes the first row in the cycle. Later rows are empty.
    """

    diagonal: Float[Array, "rows 2 2"]
    coupling: Float[Array, "rows 2 2"]
    param_blocks: Float[Array, "rows 2 parameters"]
    last_row: Int[Array, ""]


def assemble_block_matrix(jacobian, param_jacobian=None):
    """Assemble the block matrix from the derivative of the equations of the impacts.

    Parameters
    ----------
    jacobian : SequenceJacobian
        Derivative with respect to times and speeds.
    param_jacobian : Array, optional
        Derivative with respect to p parameters, of shape (2 rows, p).

    Returns
    -------
    CyclicBlockMatrix
        The block matrix.
    """
    diagonal = jnp.stack([jnp.stack(equation_entries, 1) for equation_entries in jacobian.diagonal], 1)
    gap_by_next_time, speed_by_next_time = jacobian.coupling
    zero = jnp.zeros_like(gap_by_next_time)
    coupling = jnp.stack([jnp.stack([gap_by_next_time, zero], 1), jnp.stack([speed_by_next_time, zero - 1.0], 1)], 1)
    param_jacobian = (
        jnp.zeros((2 * len(gap_by_next_time), 0), gap_by_next_time.dtype) if param_jacobian is None else param_jacobian
    )
    return CyclicBlockMatrix(
        diagonal, coupling, pair_times_and_speeds(param_jacobian, len(gap_by_next_time)), jacobian.last_row
    )


@jax.jit
def solve_bordered(cyclic_matrix, border, right_sides):
    """Solve the cyclic system with border rows for the times, the speeds and the parameters.

    Parameters
    ----------
    cyclic_matrix : CyclicBlockMatrix
        The block matrix, with p parameters.
    border : Array
        Border rows, of shape (p, 2 rows + p), or (2 rows + 1,) for one parameter.
    right_sides : Array
        Right sides, of shape (2 rows + p, k), zero in empty rows.

    Returns
    -------
    LinearSolution
        Solution, pivot ratio and determinant.
    """
    n_rows, n_params = len(cyclic_matrix.diagonal), cyclic_matrix.param_blocks.shape[2]
    border = border.reshape(n_params, -1)
    blocks = jnp.concatenate(
        [
            cyclic_matrix.diagonal,
            cyclic_matrix.coupling,
            cyclic_matrix.param_blocks,
            pair_times_and_speeds(right_sides, n_rows),
        ],
        2,
    )
    border_blocks = jnp.stack([border[:, :n_rows].T, border[:, n_rows : 2 * n_rows].T], 2)
    zeros = jnp.zeros((n_params, 2), blocks.dtype)
    border_carry = jnp.concatenate([border_blocks[0], zeros, border[:, 2 * n_rows :], right_sides[2 * n_rows :]], 1)
    closure_rows, border_carry, pivot_product, pivot_rows = _eliminate_rows(
        blocks, border_blocks, border_carry, cyclic_matrix.last_row
    )
    reduced_system = jnp.concatenate([closure_rows, border_carry])
    reduced_matrix = jnp.concatenate(
        [reduced_system[:, :2] + reduced_system[:, 2:4], reduced_system[:, 4 : 4 + n_params]], 1
    )
    solution = solve(reduced_matrix, reduced_system[:, 4 + n_params :])
    row_unknowns = _back_substitute(pivot_rows, solution.x[:2], solution.x[:2], solution.x[2:], cyclic_matrix.last_row)
    unknowns = jnp.concatenate([row_unknowns[:, 0], row_unknowns[:, 1], solution.x[2:]])
    return LinearSolution(unknowns, solution.pivot_ratio, pivot_product * solution.determinant)


def closure_determinants(cyclic_matrix):
    """Compute the determinants of the system for the multipliers 1 and -1.

    Parameters
    ----------
    cyclic_matrix : CyclicBlockMatrix
        The block matrix.

    Returns
    -------
    tuple of Array
        Determinants of the derivative of the equations with respect to times and speeds. The first one is for the
        multiplier 1. The second one is for the multiplier -1, of perturbations that change sign in each period of the
        orbit.
    """
    blocks = jnp.concatenate([cyclic_matrix.diagonal, cyclic_matrix.coupling], 2)
    no_border = jnp.zeros((0, 4), blocks.dtype)
    closure_rows, _, pivot_product, _ = _eliminate_rows(
        blocks, jnp.zeros((len(blocks), 0, 2), blocks.dtype), no_border, cyclic_matrix.last_row
    )
    closed_systems = (closure_rows[:, :2] + multiplier * closure_rows[:, 2:4] for multiplier in (1.0, -1.0))
    return tuple(
        pivot_product * (first_row[0] * second_row[1] - first_row[1] * second_row[0])
        for first_row, second_row in closed_systems
    )


def null_vectors(cyclic_matrix, multiplier):
    """Compute left and right null vectors of the system for a multiplier.

    Parameters
    ----------
    cyclic_matrix : CyclicBlockMatrix
        The block matrix.
    multiplier : float
        Factor of the perturbation of the first impact in the equations of the last impact.

    Returns
    -------
    left_null, right_null : Array
        w and v, each of shape (2 rows,), for which w J and J v vanish if J is singular. J is the derivative of the
        equations with respect to times and speeds.

    Notes
    -----
    If J is not singular, w J v measures the distance of J from a singular matrix. The derivative of w J v with respect
    to a parameter is w J' v, up to terms as small as w J v. The sign of w is such that w J v increases with the
    multiplier. Along a locus this determines the sign of w J v if the multiplier is simple.
    """
    row_index = jnp.arange(len(cyclic_matrix.diagonal))
    reversed_order = jnp.where(row_index <= cyclic_matrix.last_row, cyclic_matrix.last_row - row_index, row_index)
    previous_row = jnp.where(row_index < cyclic_matrix.last_row, reversed_order - 1, cyclic_matrix.last_row)
    transposed_blocks = (
        blocks.transpose(0, 2, 1)[source_row_indices]
        for blocks, source_row_indices in (
            (cyclic_matrix.diagonal, reversed_order),
            (cyclic_matrix.coupling, previous_row),
        )
    )
    diagonal, coupling = (
        jnp.stack(blocks)
        for blocks in zip((cyclic_matrix.diagonal, cyclic_matrix.coupling), transposed_blocks, strict=True)
    )
    right_null, left_null = jax.vmap(_null_vector, (0, 0, None, None))(
        diagonal, coupling, cyclic_matrix.last_row, multiplier
    )
    left_null, right_null = _unpair_times_and_speeds(left_null[reversed_order]), _unpair_times_and_speeds(right_null)
    return jnp.where(
        derivative_by_multiplier(left_null, cyclic_matrix, right_null) < 0, -left_null, left_null
    ), right_null


def derivative_by_multiplier(left_null, cyclic_matrix, right_null):
    """Compute the derivative of w J v with respect to the multiplier, with J as in `null_vectors`.

    Parameters
    ----------
    left_null : Array
        w, of shape (2 rows,).
    cyclic_matrix : CyclicBlockMatrix
        The block matrix.
    right_null : Array
        v, of shape (2 rows,).

    Returns
    -------
    Array
        The derivative, a scalar.
    """
    left_pairs, right_pairs = (
        pair_times_and_speeds(flat_vector, len(cyclic_matrix.diagonal)) for flat_vector in (left_null, right_null)
    )
    return left_pairs[cyclic_matrix.last_row] @ cyclic_matrix.coupling[cyclic_matrix.last_row] @ right_pairs[0]


def _null_vector(diagonal, coupling, last_row_index, multiplier):
    """Return a null vector, of shape (rows, 2), of the system without one of its two closure equations.

    The closure equation with the smaller coefficients is omitted.
    """
    n_rows = len(diagonal)
    blocks = jnp.concatenate([diagonal, coupling, jnp.zeros((n_rows, 2, 1), diagonal.dtype)], 2)
    border_blocks, border_carry = (jnp.zeros(shape, blocks.dtype) for shape in ((n_rows, 0, 2), (0, 5)))
    closure_rows, _, _, pivot_rows = _eliminate_rows(blocks, border_blocks, border_carry, last_row_index)
    (m00, m01), (m10, m11) = closure_rows[:, :2] + multiplier * closure_rows[:, 2:4]
    is_first_row_longer = m00 * m00 + m01 * m01 > m10 * m10 + m11 * m11
    first_unknowns = jnp.stack([jnp.where(is_first_row_longer, -m01, -m11), jnp.where(is_first_row_longer, m00, m10)])
    first_unknowns = (first_unknowns / jnp.sqrt(jnp.sum(first_unknowns * first_unknowns)))[:, None]
    return _back_substitute(
        pivot_rows, first_unknowns, multiplier * first_unknowns, jnp.zeros((0, 1), blocks.dtype), last_row_index
    )[:, :, 0]


def bilinear_form(left_vector, cyclic_matrix, right_vector, multiplier):
    """Compute w J v, with J as in `null_vectors`.

    Parameters
    ----------
    left_vector : Array
        w, of shape (2 rows,).
    cyclic_matrix : CyclicBlockMatrix
        The block matrix.
    right_vector : Array
        v, of shape (2 rows,).
    multiplier : float
        Factor of the perturbation of the first impact in the equations of the last impact.

    Returns
    -------
    Array
        A scalar.
    """
    left_pairs, right_pairs = (
        pair_times_and_speeds(flat_vector, len(cyclic_matrix.diagonal)) for flat_vector in (left_vector, right_vector)
    )
    row_index = jnp.arange(len(right_pairs))
    next_right_pairs = (
        jnp.where(row_index == cyclic_matrix.last_row, multiplier, 1.0)[:, None]
        * right_pairs[jnp.where(row_index < cyclic_matrix.last_row, row_index + 1, 0)]
    )
    image = jnp.einsum("kij,kj->ki", cyclic_matrix.diagonal, right_pairs) + jnp.einsum(
        "kij,kj->ki", cyclic_matrix.coupling, next_right_pairs
    )
    return jnp.sum(left_pairs * image)


def left_product(left_vector, cyclic_matrix):
    """Compute w J, with J the derivative of the equations with respect to times and speeds.

    Parameters
    ----------
    left_vector : Array
        w, of shape (2 rows,).
    cyclic_matrix : CyclicBlockMatrix
        The block matrix.

    Returns
    -------
    Array
        Product of shape (2 rows,).
    """
    left_pairs, row_index = (
        pair_times_and_speeds(left_vector, len(cyclic_matrix.diagonal)),
        jnp.arange(len(cyclic_matrix.diagonal)),
    )
    coupling_part = jnp.einsum("ki,kij->kj", left_pairs, cyclic_matrix.coupling)[
        jnp.where(row_index == 0, cyclic_matrix.last_row, row_index - 1)
    ]
    product_pairs = jnp.einsum("ki,kij->kj", left_pairs, cyclic_matrix.diagonal) + coupling_part
    return _unpair_times_and_speeds(jnp.where((row_index <= cyclic_matrix.last_row)[:, None], product_pairs, 0.0))


def dense_matrix(cyclic_matrix, multiplier=1.0):
    """Convert the block matrix to a dense matrix.

    Parameters
    ----------
    cyclic_matrix : CyclicBlockMatrix
        The block matrix, with p parameters.
    multiplier : float, optional
        Factor of the perturbation of the first impact in the equations of the last impact.

    Returns
    -------
    Array
        Matrix of shape (2 rows, 2 rows + p), with 1 on the diagonal of empty rows.
    """
    n_rows = len(cyclic_matrix.diagonal)
    row_index = jnp.arange(n_rows)
    is_impact = row_index <= cyclic_matrix.last_row
    next_row = jnp.where(row_index < cyclic_matrix.last_row, row_index + 1, 0)
    closure_factor = jnp.where(row_index == cyclic_matrix.last_row, multiplier, 1.0)
    own_one_hot = jax.nn.one_hot(row_index, n_rows, dtype=cyclic_matrix.diagonal.dtype)
    next_one_hot = closure_factor[:, None] * jax.nn.one_hot(next_row, n_rows, dtype=cyclic_matrix.diagonal.dtype)
    diagonal = jnp.where(is_impact[:, None, None], cyclic_matrix.diagonal, jnp.eye(2))
    coupling = jnp.where(is_impact[:, None, None], cyclic_matrix.coupling, 0.0)
    blocks = own_one_hot[:, None, None, :] * diagonal[..., None] + next_one_hot[:, None, None, :] * coupling[..., None]
    matrix = blocks.transpose(1, 0, 2, 3).reshape(2 * n_rows, 2 * n_rows)
    param_columns = jnp.where(is_impact[:, None, None], cyclic_matrix.param_blocks, 0.0)
    return jnp.concatenate([matrix, param_columns.transpose(1, 0, 2).reshape(2 * n_rows, -1)], 1)


def pair_times_and_speeds(flat_vector, n_rows):
    """Pair the time and the speed of each row of an array of times, then speeds.

    Parameters
    ----------
    flat_vector : Array
        Numbers of shape (2 rows, k).
    n_rows : int
        Number of rows.

    Returns
    -------
    Array
        Pairs of shape (rows, 2, k).
    """
    return jnp.stack([flat_vector[:n_rows], flat_vector[n_rows : 2 * n_rows]], 1)


def _unpair_times_and_speeds(row_pairs):
    """Reorder pairs of shape (rows, 2) to times, then speeds, of shape (2 rows,)."""
    return jnp.concatenate([row_pairs[:, 0], row_pairs[:, 1]])


def _eliminate_rows(blocks, border_blocks, border_carry, last_row_index):
    """Eliminate all unknowns except those of the first row.

    Return (closing equations, border rows, product of the pivots, rows for the back substitution). The columns belong
    to the unknowns of the first row (2), the unknowns of the next row (2), the parameters, and the right sides.
    """

    def eliminate_row(carry, row_data):
        closure_rows, border_carry, pivot_product = carry
        row_index, block, border_block = row_data
        zeros = jnp.zeros((2, 2), block.dtype)
        carry_rows = jnp.concatenate([closure_rows[:, 2:4], closure_rows[:, :2], zeros, closure_rows[:, 4:]], 1)
        block_rows = jnp.concatenate([block[:, :2], zeros, block[:, 2:]], 1)
        pivot_pair, remaining_rows = _triangularise(carry_rows, block_rows)
        border_rows = jnp.concatenate(
            [
                border_carry[:, 2:4] + border_block,
                border_carry[:, :2],
                jnp.zeros_like(border_block),
                border_carry[:, 4:],
            ],
            1,
        )
        for k in (0, 1):
            border_rows = border_rows - (border_rows[:, k : k + 1] / pivot_pair[k, k]) * pivot_pair[k]
        is_impact = row_index <= last_row_index
        new_carry = remaining_rows[:, 2:], border_rows[:, 2:], pivot_product * (pivot_pair[0, 0] * pivot_pair[1, 1])
        return jax.tree.map(lambda new, old: jnp.where(is_impact, new, old), new_carry, carry), pivot_pair

    carry = blocks[0], border_carry, jnp.ones_like(blocks[0, 0, 0])
    (closure_rows, border_carry, pivot_product), pivot_rows = lax.scan(
        eliminate_row, carry, (jnp.arange(1, len(blocks)), blocks[1:], border_blocks[1:])
    )
    return closure_rows, border_carry, pivot_product, pivot_rows


@jax.jit
def _triangularise(upper_rows, lower_rows):
    """Make two columns of four rows upper triangular by Givens rotations; return the upper and the lower two rows."""
    rows = [*upper_rows, *lower_rows]
    for column, pivot_index, target_index in ((0, 0, 1), (0, 2, 3), (0, 0, 2), (1, 1, 3), (1, 1, 2)):
        pivot_entry, target_entry = rows[pivot_index][column], rows[target_index][column]
        radius = jnp.sqrt(pivot_entry * pivot_entry + target_entry * target_entry)
        cos, sin = (
            jnp.where(radius > 0, column_entry / jnp.where(radius > 0, radius, 1.0), identity_value)
            for column_entry, identity_value in ((pivot_entry, 1.0), (target_entry, 0.0))
        )
        rows[pivot_index], rows[target_index] = (
            cos * rows[pivot_index] + sin * rows[target_index],
            cos * rows[target_index] - sin * rows[pivot_index],
        )
    return jnp.stack(rows[:2]), jnp.stack(rows[2:])


def _back_substitute(pivot_rows, first_unknowns, closing_unknowns, parameters, last_row_index):
    """Return the unknowns of all rows, of shape (rows, 2, k), from the unknowns of the first row and the parameters.

    `closing_unknowns` are the unknowns of the first impact of the next cycle, which follows the last row.
    """
    n_params = len(parameters)

    def substitute_row(next_unknowns, row_data):
        row_index, pivot_pair = row_data
        right_side = (
            pivot_pair[:, 6 + n_params :]
            - pivot_pair[:, 2:4] @ first_unknowns
            - pivot_pair[:, 4:6] @ next_unknowns
            - pivot_pair[:, 6 : 6 + n_params] @ parameters
        )
        speed = right_side[1] / pivot_pair[1, 1]
        row_unknowns = jnp.stack([(right_side[0] - pivot_pair[0, 1] * speed) / pivot_pair[0, 0], speed])
        is_impact = row_index <= last_row_index
        return jnp.where(is_impact, row_unknowns, next_unknowns), jnp.where(is_impact, row_unknowns, 0.0)

    _, later_row_unknowns = lax.scan(
        substitute_row, closing_unknowns, (jnp.arange(1, len(pivot_rows) + 1), pivot_rows), reverse=True
    )
    return jnp.concatenate([first_unknowns[None], later_row_unknowns])

"""Linear systems of a cycle: two equations and two unknowns an impact, each row with its own unknowns and the next's.

With some parameters more and as many rows more (a border) they are solved by Givens' rotations, impact by impact: the
unknowns of one after the other are left to those of the first and the parameters, where the circle closes. Nothing is
divided by the speeds, so that a branch can go through speed zero.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Int

from continuation.arrays import Array
from continuation.linear import Eliminated, solve


class Ring(NamedTuple):
    """own: (rows, 2, 2), each row's derivative by its own time and speed; following: by the next row's; by:
    (rows, 2, p), by the parameters; last: the row whose next is the first; those after it are empty."""

    own: Float[Array, "rows 2 2"]
    following: Float[Array, "rows 2 2"]
    by: Float[Array, "rows 2 parameters"]
    last: Int[Array, ""]


def of(slopes, by=None):
    """The `Ring` of the `Slopes` of `impact_equations.equations`, and of their derivative by p parameters, (2 rows, p),
    None for none."""
    own = jnp.stack([jnp.stack(pair, 1) for pair in slopes.own], 1)
    e, f = slopes.following
    zero = jnp.zeros_like(e)
    following = jnp.stack([jnp.stack([e, zero], 1), jnp.stack([f, zero - 1.0], 1)], 1)
    by = jnp.zeros((2 * len(e), 0), e.dtype) if by is None else by
    return Ring(own, following, pairs(by, len(e)), slopes.last)


@jax.jit
def bordered(ring, border, right):
    """The ring's equations, then the border's rows, for times, speeds and parameters: `linear.Eliminated`.

    border: (p, 2 rows + p), or (2 rows + 1,) for one parameter; right: (2 rows + p, k), empty rows zero.
    """
    rows, size = len(ring.own), ring.by.shape[2]
    border = border.reshape(size, -1)
    blocks = jnp.concatenate([ring.own, ring.following, ring.by, pairs(right, rows)], 2)
    edges = jnp.stack([border[:, :rows].T, border[:, rows : 2 * rows].T], 2)
    blank = jnp.zeros((size, 2), blocks.dtype)
    corner = jnp.concatenate([edges[0], blank, border[:, 2 * rows :], right[2 * rows :]], 1)
    relation, corner, product, kept = _reduced(blocks, edges, corner, ring.last)
    table = jnp.concatenate([relation, corner])
    small = jnp.concatenate([table[:, :2] + table[:, 2:4], table[:, 4 : 4 + size]], 1)
    found = solve(small, table[:, 4 + size :])
    back = _back(kept, found.x[:2], found.x[:2], found.x[2:], ring.last)
    x = jnp.concatenate([back[:, 0], back[:, 1], found.x[2:]])
    return Eliminated(x, found.worst, product * found.determinant)


def determinants(ring):
    """The determinants of the equations by times and speeds: as they are, and where what comes after the last impact is
    the first's times -1, for a cycle that changes its sign each time round."""
    blocks = jnp.concatenate([ring.own, ring.following], 2)
    none = jnp.zeros((0, 4), blocks.dtype)
    relation, _, product, _ = _reduced(blocks, jnp.zeros((len(blocks), 0, 2), blocks.dtype), none, ring.last)
    closed = (relation[:, :2] + turn * relation[:, 2:4] for turn in (1.0, -1.0))
    return tuple(product * (a[0] * b[1] - a[1] * b[0]) for a, b in closed)


def nulls(ring, turn):
    """(w, v), (2 rows,) each, for which w J and J v are zero where J is singular: the equations by times and speeds,
    what comes after the last impact being the first's times turn. Elsewhere w J v measures how far that is: its
    derivative is w J' v, but for what is as small as w J v. It has one sign along a locus: w J v grows with the turn,
    at a multiplier that is not a double one."""
    place = jnp.arange(len(ring.own))
    order = jnp.where(place <= ring.last, ring.last - place, place)
    before = jnp.where(place < ring.last, order - 1, ring.last)
    turned = (each.transpose(0, 2, 1)[at] for each, at in ((ring.own, order), (ring.following, before)))
    own, following = (jnp.stack(each) for each in zip((ring.own, ring.following), turned, strict=True))
    right, left = jax.vmap(_null, (0, 0, None, None))(own, following, ring.last, turn)
    left, right = _flat(left[order]), _flat(right)
    return jnp.where(by_turn(left, ring, right) < 0, -left, left), right


def by_turn(left, ring, right):
    """How w J v, J as in `nulls`, changes with the turn."""
    w, v = (pairs(each, len(ring.own)) for each in (left, right))
    return w[ring.last] @ ring.following[ring.last] @ v[0]


def _null(own, following, last, turn):
    """(rows, 2): of all equations but one, the one that is least independent of the others, this is a solution."""
    rows = len(own)
    blocks = jnp.concatenate([own, following, jnp.zeros((rows, 2, 1), own.dtype)], 2)
    edges, corner = (jnp.zeros(shape, blocks.dtype) for shape in ((rows, 0, 2), (0, 5)))
    relation, _, _, kept = _reduced(blocks, edges, corner, last)
    (a, b), (c, d) = relation[:, :2] + turn * relation[:, 2:4]
    longer = a * a + b * b > c * c + d * d
    first = jnp.stack([jnp.where(longer, -b, -d), jnp.where(longer, a, c)])
    first = (first / jnp.sqrt(jnp.sum(first * first)))[:, None]
    return _back(kept, first, turn * first, jnp.zeros((0, 1), blocks.dtype), last)[:, :, 0]


def product(left, ring, right, turn):
    """w J v, J as in `nulls`."""
    w, v = (pairs(each, len(ring.own)) for each in (left, right))
    place = jnp.arange(len(v))
    after = jnp.where(place == ring.last, turn, 1.0)[:, None] * v[jnp.where(place < ring.last, place + 1, 0)]
    moved = jnp.einsum("kij,kj->ki", ring.own, v) + jnp.einsum("kij,kj->ki", ring.following, after)
    return jnp.sum(w * moved)


def across(left, ring):
    """w J, (2 rows,), J being the equations themselves."""
    w, place = pairs(left, len(ring.own)), jnp.arange(len(ring.own))
    by_next = jnp.einsum("ki,kij->kj", w, ring.following)[jnp.where(place == 0, ring.last, place - 1)]
    found = jnp.einsum("ki,kij->kj", w, ring.own) + by_next
    return _flat(jnp.where((place <= ring.last)[:, None], found, 0.0))


def dense(ring, turn=1.0):
    """The equations' derivative as a matrix (2 rows, 2 rows + p), closed as in `nulls`; 1 for an empty unknown."""
    rows = len(ring.own)
    place = jnp.arange(rows)
    hit = place <= ring.last
    follows = jnp.where(place < ring.last, place + 1, 0)
    sign = jnp.where(place == ring.last, turn, 1.0)
    near = jax.nn.one_hot(place, rows, dtype=ring.own.dtype)
    after = sign[:, None] * jax.nn.one_hot(follows, rows, dtype=ring.own.dtype)
    own = jnp.where(hit[:, None, None], ring.own, jnp.eye(2))
    following = jnp.where(hit[:, None, None], ring.following, 0.0)
    whole = near[:, None, None, :] * own[..., None] + after[:, None, None, :] * following[..., None]
    matrix = whole.transpose(1, 0, 2, 3).reshape(2 * rows, 2 * rows)
    by = jnp.where(hit[:, None, None], ring.by, 0.0)
    return jnp.concatenate([matrix, by.transpose(1, 0, 2).reshape(2 * rows, -1)], 1)


def pairs(flat, rows):
    """Numbers by times, then speeds, (2 rows, k), as (rows, 2, k)."""
    return jnp.stack([flat[:rows], flat[rows : 2 * rows]], 1)


def _flat(pairs):
    """(rows, 2) by times, then speeds, (2 rows,)."""
    return jnp.concatenate([pairs[:, 0], pairs[:, 1]])


def _reduced(blocks, edges, corner, last):
    """All unknowns eliminated but the first's: (the last relation, the border's rows, the product of the pivots, and
    the rows that give the others back).

    A row has columns of the first unknowns (2), of those after the present ones (2), of parameters, right sides.
    """

    def eliminate(carry, given):
        relation, corner, product = carry
        place, block, edge = given
        none = jnp.zeros((2, 2), block.dtype)
        above = jnp.concatenate([relation[:, 2:4], relation[:, :2], none, relation[:, 4:]], 1)
        below = jnp.concatenate([block[:, :2], none, block[:, 2:]], 1)
        top, rest = _rotated(above, below)
        low = jnp.concatenate([corner[:, 2:4] + edge, corner[:, :2], jnp.zeros_like(edge), corner[:, 4:]], 1)
        for k in (0, 1):
            low = low - (low[:, k : k + 1] / top[k, k]) * top[k]
        there = place <= last
        new = rest[:, 2:], low[:, 2:], product * (top[0, 0] * top[1, 1])
        return jax.tree.map(lambda new, old: jnp.where(there, new, old), new, carry), top

    carry = blocks[0], corner, jnp.ones_like(blocks[0, 0, 0])
    (relation, corner, product), kept = lax.scan(eliminate, carry, (jnp.arange(1, len(blocks)), blocks[1:], edges[1:]))
    return relation, corner, product, kept


@jax.jit
def _rotated(above, below):
    """Two and two rows turned so that the first two columns are upper triangular: ((0, 1), (2, 3)) after."""
    rows = [*above, *below]
    for column, k, j in ((0, 0, 1), (0, 2, 3), (0, 0, 2), (1, 1, 3), (1, 1, 2)):
        a, b = rows[k][column], rows[j][column]
        size = jnp.sqrt(a * a + b * b)
        c, s = (jnp.where(size > 0, each / jnp.where(size > 0, size, 1.0), one) for each, one in ((a, 1.0), (b, 0.0)))
        rows[k], rows[j] = c * rows[k] + s * rows[j], c * rows[j] - s * rows[k]
    return jnp.stack(rows[:2]), jnp.stack(rows[2:])


def _back(kept, first, again, parameters, last):
    """All unknowns, (rows, 2, k), from the first's (2, k), these as they come again, and the parameters' (p, k)."""
    size = len(parameters)

    def back(after, given):
        place, top = given
        right = top[:, 6 + size :] - top[:, 2:4] @ first - top[:, 4:6] @ after - top[:, 6 : 6 + size] @ parameters
        speed = right[1] / top[1, 1]
        found = jnp.stack([(right[0] - top[0, 1] * speed) / top[0, 0], speed])
        there = place <= last
        return jnp.where(there, found, after), jnp.where(there, found, 0.0)

    _, others = lax.scan(back, again, (jnp.arange(1, len(kept) + 1), kept), reverse=True)
    return jnp.concatenate([first[None], others])

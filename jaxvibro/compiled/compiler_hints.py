"""How the compiler is asked to treat a block of lanes: hints that cost speed, never correctness, where it ignores them.

Arithmetic here works on lanes of one shape and on scalars, the numbers that all lanes share. `jnp.where` and its kin
are jitted functions of their own and would each become a loop of their own below an un-inlined call, so the lanes use
`choose` and lax alone.
"""

import math
from functools import lru_cache

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend import core

WIDTH = 64  # lanes of a block: its arrays stay in the first-level cache, and few lanes wait for the slowest
NARROW = 32  # the same of lanes that lean steps have given up: few, and slow ones among them
ON_CARD = 1 << 20, 1 << 12  # both on a graphics card, which takes a step of many lanes in the time of one of few
NOT_EMITTED = frozenset(  # operations that cannot stand within a loop that is one kernel
    name
    for names in (
        "scatter scatter-add scatter_add scatter_mul scatter_min scatter_max sort top_k fft pure_callback io_callback",
        "lu triangular_solve cholesky qr geqrf householder_product eig eigh svd schur tridiagonal tridiagonal_solve",
    )
    for name in names.split()
)
LIBRARY_SUM, LIBRARY_SIDE = 4096, 8  # terms, rows from which on XLA calls a library for a sum, for a product
OPTIONS = {"xla_cpu_prefer_vector_width": 512}


def choose(condition, yes, no):
    """lax.select that takes Python numbers and broadcasts: yes where the condition holds, no elsewhere."""
    arrays = [each for each in (yes, no) if isinstance(each, jax.Array)]
    dtype = arrays[0].dtype if arrays else jnp.result_type(float)
    shape = jnp.broadcast_shapes(condition.shape, *(each.shape for each in arrays))
    return lax.select(*(_spread(*each, shape) for each in ((condition, bool), (yes, dtype), (no, dtype))))


def _spread(value, dtype, shape):
    if isinstance(value, jax.Array) and value.shape == shape:
        return value
    return jnp.broadcast_to(lax.convert_element_type(value, dtype), shape)


def mask(condition, like):
    """The lanes where a condition holds, for `merge`: all bits set or none, as wide as the numbers of `like`."""
    whole = jnp.int64 if like.dtype == jnp.float64 else jnp.int32
    return lax.neg(lax.convert_element_type(condition, whole))


def merge(mask, new, old):
    """new where the mask's bits are set, else old: for what a loop carries, as `choose` in place is a masked store,
    ten times as slow on some machines. The mask is to be the result of a `stage`."""
    bits = [lax.bitcast_convert_type(each, mask.dtype) for each in (new, old)]
    return lax.bitcast_convert_type((bits[0] & mask) | (bits[1] & ~mask), old.dtype)


def positive(a):
    """a where it is positive, else 0."""
    return choose(a > 0, a, 0.0)


def negative(a):
    """a where it is negative, else 0."""
    return choose(a < 0, a, 0.0)


def least(a, b):
    """The smaller of two; one instruction, as it promises nothing for nan."""
    return choose(a < b, a, b)


def most(a, b):
    """The larger of two."""
    return choose(a > b, a, b)


def two_sum(a, b):
    """The rounded sum and its error (Knuth): a path's rounding errors then grow with its length, not its steps."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def stage(function, *lanes, **static):
    """function(*lanes) as an un-inlined call, whose results are stored: XLA would compute them anew for each use.

    XLA computes each result of a call in a loop of its own, with all that it depends on within the call: a stage is to
    be short, or to have few results. Only operands that the results depend on are handed over; the emitter of a whole
    loop as one kernel aborts on any other. The function is one of a module, traced once for lanes of a kind.
    """
    call, operands, _ = _trimmed(function, lanes, static)
    if not on_processor():
        return call(*operands)
    with set_xla_metadata(inlineable="false"):
        return jax.jit(call)(*operands)


def one_kernel(function, *lanes, **static):
    """function(*lanes), its loops compiled as one kernel in place of one launch for each operation.

    Operands of one shape are handed over in one array, and given back: the emitter aborts on an operand that is a
    constant which a loop outside starts from too, and on one that XLA finds to be of no use, such as a number that a
    loop carries and no result needs. The function is one of a module, traced once for lanes of a kind. What has an
    operation that is `NOT_EMITTED` is compiled as it is.
    """
    call, operands, jaxpr = _trimmed(function, lanes, static)
    if not _is_emitted(jaxpr) or not on_processor():
        return jax.jit(call)(*operands)
    places = {}
    for place, operand in enumerate(operands):
        places.setdefault((jnp.shape(operand), jnp.result_type(operand)), []).append(place)

    def plain(*packs):
        given = [None] * len(operands)
        for pack, group in zip(packs, places.values(), strict=True):
            for row, place in enumerate(group):
                given[place] = lax.index_in_dim(pack, row, keepdims=False)
        with set_xla_metadata(inlineable=None, xla_cpu_small_call=None):
            return call(*given), packs

    packs = [jnp.stack([operands[place] for place in group]) for group in places.values()]
    with set_xla_metadata(inlineable="false", xla_cpu_small_call="true"):
        results = jax.jit(plain)(*packs)
    return lax.optimization_barrier(results)[0]  # jax would leave out what is given back and not used


def block_width():
    """Lanes of a block, for what is traced now."""
    return WIDTH if on_processor() else ON_CARD[0]


def narrow_width():
    """Lanes of a block of those that lean steps have given up."""
    return NARROW if on_processor() else ON_CARD[1]


def on_processor():
    """Whether what is traced now is for a processor: elsewhere the hints are none, and a card's compiler is led into a
    circle by them."""
    device = jax.config.jax_default_device
    return (jax.default_backend() if device is None else getattr(device, "platform", device)) == "cpu"


def _trimmed(function, lanes, static):
    """(the function of those operands alone that its results depend on, these operands, its jaxpr)."""
    flat, tree = jax.tree.flatten(lanes)
    kinds = tuple((jnp.shape(lane), jnp.result_type(lane)) for lane in flat)
    call, kept, jaxpr = _traced(function, tuple(static.items()), tree, kinds, jax.config.jax_enable_x64, on_processor())
    return call, [lane for lane, keep in zip(flat, kept, strict=True) if keep], jaxpr


@lru_cache(1024)
def _traced(function, static, tree, kinds, double, on_processor):
    """(the function of the operands that matter, which those are, its jaxpr), for operands of such shapes and types."""
    blank = [jax.ShapeDtypeStruct(*kind) for kind in kinds]
    whole = jax.make_jaxpr(lambda *a: function(*tree.unflatten(a), **dict(static)), return_shape=True)
    closed, shape = whole(*blank)
    live = _operands(closed.jaxpr)
    kept = [variable in live for variable in closed.jaxpr.invars]

    def call(*given):
        given = iter(given)
        full = [next(given) if keep else jnp.zeros(*kind) for keep, kind in zip(kept, kinds, strict=True)]
        return jax.tree.unflatten(jax.tree.structure(shape), jax.core.eval_jaxpr(closed.jaxpr, closed.consts, *full))

    return call, kept, closed.jaxpr


@lru_cache(1024)
def _is_emitted(jaxpr):
    """Whether loops of this can be one kernel."""
    return all(
        eqn.primitive.name not in NOT_EMITTED
        and not _is_left_to_library(eqn)
        and all(map(_is_emitted, core.jaxprs_in_params(eqn.params)))
        for eqn in jaxpr.eqns
    )


def _is_left_to_library(eqn):
    """Whether XLA calls a library for this operation, which a kernel cannot do."""
    if eqn.primitive.name in ("reduce_max", "reduce_min", "reduce_sum"):
        return eqn.invars[0].aval.size >= LIBRARY_SUM
    if eqn.primitive.name != "dot_general":
        return False
    left, right = (each.aval for each in eqn.invars)
    (summed, _), (alike, _) = eqn.params["dimension_numbers"]
    terms, each = (math.prod(left.shape[axis] for axis in axes) for axes in (summed, alike))
    rows, columns = (matrix.size // max(terms * each, 1) for matrix in (left, right))
    if min(rows, columns) > 1 and max(rows, columns, terms) >= LIBRARY_SIDE:
        return True
    return each * rows * terms * columns >= LIBRARY_SUM


def _operands(jaxpr):
    live = {v for v in jaxpr.outvars if not hasattr(v, "val")}
    for equation in reversed(jaxpr.eqns):
        if not live.isdisjoint(equation.outvars):
            live.update(v for v in equation.invars if not hasattr(v, "val"))
    return live

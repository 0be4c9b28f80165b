"""Compile loops over lanes as one kernel of the processor, wherever a user's program calls them.

XLA emits a call that carries the attribute ``xla_cpu_small_call`` as one kernel, in place of one launch per operation.
It aborts the process, or fails to link, where a kernel is not of the form that it expects. `one_kernel` is therefore a
primitive: its operands, their layout and what surrounds the call are the same in every program.

- XLA's emitter aborts on a parameter without a use in the called computation. Constant folding produces one: it moves
  a constant operand into the computation. Hence operands pass an optimisation barrier, which outlives constant
  folding, are stacked into arrays of at least two rows, so that none is a constant's own buffer, and are returned
  behind a second barrier, so that each is used.
- A kernel can neither call a library nor start threads: `is_emitted` and `parallel_tasks.cost_share` decide whether a
  computation may become one. Others are compiled without the attribute: slower, with the same results.
- Derivatives of a kernel are compiled without the attribute; lanes of a kernel are a kernel if they pass the same test.
"""

import math
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend import core
from jax.interpreters import ad, batching, mlir

from .parallel_tasks import cost_share

WIDTH = 64  # lanes of a block: its arrays stay in the first-level cache, and few lanes wait for the slowest
NARROW = 32  # the same of lanes that lean steps have given up: few, and slow ones among them
ON_CARD = 1 << 20, 1 << 12  # widths on a graphics card, which takes a step of many lanes in the time of one of few
NOT_EMITTED = frozenset(  # operations that cannot stand within a loop that is one kernel
    name
    for names in (
        "scatter scatter-add scatter_add scatter_mul scatter_min scatter_max sort top_k fft pure_callback",
        "io_callback custom_call ffi_call rng_bit_generator random_bits conv_general_dilated",
        "lu triangular_solve cholesky qr geqrf householder_product eig eigh svd schur tridiagonal tridiagonal_solve",
    )
    for name in names.split()
)
LIBRARY_SUM, LIBRARY_SIDE = 4096, 8  # terms, rows from which on XLA calls a library for a sum, for a product


class Sizes(NamedTuple):
    """narrowing: what the usual number of lanes in a block is divided by; strip: most blocks in a kernel."""

    narrowing: int = 1
    strip: int = 1000


SIZES = Sizes(), Sizes(1, 1), Sizes(2, 1), Sizes(4, 1)  # tried in turn until no operation of a kernel is too costly
_sizes: ContextVar[Sizes | None] = ContextVar("sizes", default=None)


class TooCostly(Exception):
    """XLA may split an operation of a kernel over threads; with fewer lanes it will not."""


class Traced:
    """A function traced for operands of given shapes and types.

    jaxpr : the closed jaxpr of all operands. kept : which operands the results depend on.
    """

    def __init__(self, function, static, tree, kinds):
        blank = [jax.ShapeDtypeStruct(*kind) for kind in kinds]
        whole = jax.make_jaxpr(lambda *a: function(*tree.unflatten(a), **dict(static)), return_shape=True)
        self.jaxpr, shape = whole(*blank)
        self.tree = jax.tree.structure(shape)
        live = _operands(self.jaxpr.jaxpr)
        self.kinds, self.kept = kinds, tuple(v in live for v in self.jaxpr.jaxpr.invars)

    def flat(self, *operands):
        """Results as a list, for all operands."""
        return jax.core.eval_jaxpr(self.jaxpr.jaxpr, self.jaxpr.consts, *operands)

    def some(self, operands):
        """The operands that the results depend on."""
        return [operand for operand, keep in zip(operands, self.kept, strict=True) if keep]

    def of_some(self, *operands):
        """Results as a list, for the operands that they depend on."""
        given = iter(operands)
        return self.flat(
            *(next(given) if k else jnp.zeros(*kind) for k, kind in zip(self.kept, self.kinds, strict=True))
        )


def traced(function, lanes, static):
    """(`Traced`, operands) of a function of a module; it is traced once for lanes of a kind."""
    flat, tree = jax.tree.flatten(lanes)
    kinds = tuple((jnp.shape(lane), jnp.result_type(lane)) for lane in flat)
    settings = jax.config.jax_enable_x64, on_processor(), _sizes.get()
    return _traced(function, tuple(static.items()), tree, kinds, settings), flat


@lru_cache(1024)
def _traced(function, static, tree, kinds, settings):
    return Traced(function, static, tree, kinds)


def one_kernel(function, *lanes, **static):
    """function(*lanes), its loops compiled as one kernel where they can be, in place of one launch per operation.

    The function is one of a module, with hashable static arguments. Raises TooCostly within `blocks.in_blocks` where
    a kernel of fewer lanes is to be tried.
    """
    kernel, operands = traced(function, lanes, static)
    jaxpr = kernel.jaxpr.jaxpr
    if is_within_blocks() and on_processor() and is_emitted(jaxpr) and cost_share(jaxpr) > 1:
        raise TooCostly
    return jax.tree.unflatten(kernel.tree, kernel_p.bind(*operands, call_jaxpr=kernel.jaxpr, kernel=kernel))


@contextmanager
def of_sizes(sizes):
    """Trace with other numbers of lanes in a block; None: the usual ones, and nothing is too costly."""
    token = _sizes.set(sizes)
    try:
        yield
    finally:
        _sizes.reset(token)


def is_within_blocks():
    """Return True within `blocks.in_blocks`, where the length of a block is already chosen."""
    return _sizes.get() is not None


def block_width():
    """Lanes of a block, for what is traced now."""
    return WIDTH // (_sizes.get() or SIZES[0]).narrowing if on_processor() else ON_CARD[0]


def narrow_width():
    """Lanes of a block of those that lean steps have given up."""
    return NARROW // (_sizes.get() or SIZES[0]).narrowing if on_processor() else ON_CARD[1]


def on_processor():
    """Whether what is traced now is for a processor: elsewhere the hints are none, and a card's compiler is led into a
    circle by them."""
    device = jax.config.jax_default_device
    return (jax.default_backend() if device is None else getattr(device, "platform", device)) == "cpu"


def _hinted(kernel, *operands):
    """Results of a kernel as a call with the attribute, in the form that the emitter takes."""
    operands = lax.optimization_barrier(kernel.some(operands))
    places = {}
    for place, operand in enumerate(operands):
        places.setdefault((jnp.shape(operand), jnp.result_type(operand)), []).append(place)

    def plain(*packs):
        given = [None] * len(operands)
        for pack, group in zip(packs, places.values(), strict=True):
            for row, place in enumerate(group):
                given[place] = lax.index_in_dim(pack, row, keepdims=False)
        with set_xla_metadata(inlineable=None, xla_cpu_small_call=None):
            return kernel.of_some(*given), packs

    packs = [jnp.stack([operands[k] for k in (group if len(group) > 1 else 2 * group)]) for group in places.values()]
    with set_xla_metadata(inlineable="false", xla_cpu_small_call="true"):
        results = jax.jit(plain)(*packs)
    return lax.optimization_barrier(results)[0]


def _lowered(hints, context, *operands, call_jaxpr, kernel):
    """MLIR of a kernel, traced without the mesh axes that its operands may vary over."""
    hinted = hints and any(kernel.kept) and can_be_kernel(call_jaxpr.jaxpr)
    blank = [ShapedArray(aval.shape, aval.dtype) for aval in context.avals_in]
    return mlir.lower_fun(partial(_hinted, kernel) if hinted else kernel.flat)(
        context.replace(avals_in=blank), *operands
    )


def can_be_kernel(jaxpr) -> bool:
    """Return True if XLA can compile the loops of a jaxpr as one kernel."""
    return is_emitted(jaxpr) and cost_share(jaxpr) <= 1


def shapes_of(*avals, call_jaxpr, **static):
    """Abstract results; in a manual mesh they vary over the axes that any operand varies over."""
    if not jax.sharding.get_abstract_mesh().manual_axes:
        return [ShapedArray(aval.shape, aval.dtype) for aval in call_jaxpr.out_avals]

    def like(*operands):
        one = sum(jnp.ravel(operand)[0].astype(float) for operand in operands)
        return [jnp.broadcast_to(one.astype(aval.dtype), aval.shape) for aval in call_jaxpr.out_avals]

    return jax.make_jaxpr(like)(*avals).out_avals


def _differentiated(primals, tangents, *, call_jaxpr, kernel):
    return jax.jvp(kernel.flat, tuple(primals), tuple(map(ad.instantiate_zeros, tangents)))


def _batched(operands, axes, *, call_jaxpr, kernel):
    results = one_kernel(_lanes_of(kernel, tuple(axes)), *operands)
    return results, [0] * len(results)


@lru_cache(1024)
def _lanes_of(kernel, axes):
    return jax.vmap(kernel.flat, axes)


kernel_p = core.Primitive("one_kernel")
kernel_p.multiple_results = True
kernel_p.def_impl(lambda *operands, **static: jax.jit(partial(kernel_p.bind, **static))(*operands))
kernel_p.def_abstract_eval(shapes_of)
mlir.register_lowering(kernel_p, partial(_lowered, False))
mlir.register_lowering(kernel_p, partial(_lowered, True), platform="cpu")
ad.primitive_jvps[kernel_p] = _differentiated
batching.primitive_batchers[kernel_p] = _batched


@lru_cache(1024)
def is_emitted(jaxpr) -> bool:
    """Return True if a kernel can hold every operation of a jaxpr."""
    return all(
        equation.primitive.name not in NOT_EMITTED
        and not _is_left_to_library(equation)
        and all(map(is_emitted, core.jaxprs_in_params(equation.params)))
        for equation in jaxpr.eqns
    )


def _is_left_to_library(eqn):
    """Return True if XLA calls a library for this operation, which a kernel cannot do."""
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

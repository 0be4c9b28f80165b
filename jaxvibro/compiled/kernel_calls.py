"""Compile loops over lanes as single CPU kernels, independently of the surrounding program.

XLA emits a call with the attribute ``xla_cpu_small_call`` as one kernel, instead of one launch per operation. XLA
aborts the process or fails to link if a kernel does not have the expected form. `call_as_kernel` is therefore a
primitive: the operands, the layout of the operands and the surroundings of the call are the same in every program.

- The emitter of XLA aborts on a parameter that the called computation does not use. Constant folding produces such a
  parameter when it moves a constant operand into the computation. Hence operands pass an optimisation barrier, which
  survives constant folding. The operands are stacked into arrays of at least two rows, so that no array is the buffer
  of a constant. The stacks are returned behind a second barrier, so that each stack is used.
- A kernel can neither call a library nor start threads. `is_emittable_as_kernel` and
  `kernel_costs.max_cost_to_limit_ratio` decide whether a computation may become a kernel. Other computations are
  compiled without the attribute. These computations are slower, with the same results.
- Derivatives of a kernel are compiled without the attribute. A vmap of a kernel is a kernel if it passes the same test.
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

from .kernel_costs import max_cost_to_limit_ratio

BLOCK_WIDTH = 64  # lanes of a block: its arrays fit into the first-level cache, and few lanes wait for the slowest
NARROW_BLOCK_WIDTH = 32  # block width for the reference path, whose lanes are few and slow
# wide and narrow block width on a GPU, where a step of many lanes takes as long as a step of few
GPU_BLOCK_WIDTHS = (
    1 << 20,
    1 << 12,
)
NOT_EMITTABLE = frozenset(  # operations that a loop compiled as one kernel cannot contain
    name
    for names in (
        "scatter scatter-add scatter_add scatter_mul scatter_min scatter_max sort top_k fft pure_callback",
        "io_callback custom_call ffi_call rng_bit_generator random_bits conv_general_dilated",
        "lu triangular_solve cholesky qr geqrf householder_product eig eigh svd schur tridiagonal tridiagonal_solve",
    )
    for name in names.split()
)
MIN_LIBRARY_SUM, MIN_LIBRARY_SIDE = 4096, 8  # terms of a sum and rows of a product from which XLA calls a library


class BlockSizes(NamedTuple):
    """Sizes of the blocks of lanes.

    Attributes
    ----------
    block_width_divisor : int
        Divisor of the usual block width.
    max_blocks_per_kernel : int
        Largest number of blocks in a kernel.
    """

    block_width_divisor: int = 1
    max_blocks_per_kernel: int = 1000


# tried in this order until no operation of a kernel is too costly
BLOCK_SIZES = (
    BlockSizes(),
    BlockSizes(1, 1),
    BlockSizes(2, 1),
    BlockSizes(4, 1),
)
_block_sizes: ContextVar[BlockSizes | None] = ContextVar("sizes", default=None)


class KernelTooCostly(Exception):
    """Raised if XLA may split an operation of a kernel over threads; a kernel of fewer lanes avoids the split."""


class TracedFunction:
    """Function traced for operands of given shapes and types.

    Attributes
    ----------
    jaxpr : ClosedJaxpr
        Closed jaxpr with all operands.
    tree : PyTreeDef
        Pytree structure of the results.
    signature : tuple of (tuple of int, dtype)
        Shape and type of each operand.
    is_used : tuple of bool
        True for the operands that the results depend on.
    """

    def __init__(self, function, static_arguments, operand_treedef, signature):
        abstract_operands = [jax.ShapeDtypeStruct(*shape_dtype) for shape_dtype in signature]
        make_jaxpr = jax.make_jaxpr(
            lambda *operands: function(*operand_treedef.unflatten(operands), **dict(static_arguments)),
            return_shape=True,
        )
        self.jaxpr, result_shapes = make_jaxpr(*abstract_operands)
        self.tree = jax.tree.structure(result_shapes)
        live_variables = _find_live_variables(self.jaxpr.jaxpr)
        self.signature, self.is_used = (
            signature,
            tuple(variable in live_variables for variable in self.jaxpr.jaxpr.invars),
        )

    def flat(self, *operands):
        """Return the results as a list, given all operands."""
        return jax.core.eval_jaxpr(self.jaxpr.jaxpr, self.jaxpr.consts, *operands)

    def select_used_operands(self, operands):
        """Return the operands that the results depend on."""
        return [operand for operand, used in zip(operands, self.is_used, strict=True) if used]

    def call_with_used_operands(self, *operands):
        """Return the results as a list, given only the operands on which the results depend."""
        used_operands = iter(operands)
        return self.flat(
            *(
                next(used_operands) if used else jnp.zeros(*shape_dtype)
                for used, shape_dtype in zip(self.is_used, self.signature, strict=True)
            )
        )


def trace_with_cache(function, lanes, static_arguments):
    """Return (`TracedFunction`, operands); a function is traced once for each set of shapes and types of lanes."""
    operands, treedef = jax.tree.flatten(lanes)
    signature = tuple((jnp.shape(lane), jnp.result_type(lane)) for lane in operands)
    trace_settings = jax.config.jax_enable_x64, is_traced_for_cpu(), _block_sizes.get()
    return _make_traced_function(
        function, tuple(static_arguments.items()), treedef, signature, trace_settings
    ), operands


@lru_cache(1024)
def _make_traced_function(function, static_arguments, operand_treedef, signature, trace_settings):
    return TracedFunction(function, static_arguments, operand_treedef, signature)


def call_as_kernel(function, *lanes, **static):
    """Call a function with its loops compiled as one kernel where possible.

    Otherwise XLA launches each operation separately.

    Parameters
    ----------
    function : callable
        Function at the top level of a module.
    *lanes : pytree of array
        Positional arguments.
    **static : hashable
        Static keyword arguments.

    Returns
    -------
    pytree of array
        Results of ``function(*lanes, **static)``.

    Raises
    ------
    KernelTooCostly
        Within `lane_blocks.run_in_blocks`, if XLA may split an operation of the kernel over threads.
    """
    kernel, operands = trace_with_cache(function, lanes, static)
    jaxpr = kernel.jaxpr.jaxpr
    if (
        is_within_run_in_blocks()
        and is_traced_for_cpu()
        and is_emittable_as_kernel(jaxpr)
        and max_cost_to_limit_ratio(jaxpr) > 1
    ):
        raise KernelTooCostly
    return jax.tree.unflatten(kernel.tree, kernel_p.bind(*operands, call_jaxpr=kernel.jaxpr, kernel=kernel))


@contextmanager
def use_block_sizes(block_sizes):
    """Set the block sizes for tracing within a context.

    None restores the usual sizes, for which `KernelTooCostly` is not raised.
    """
    reset_token = _block_sizes.set(block_sizes)
    try:
        yield
    finally:
        _block_sizes.reset(reset_token)


def is_within_run_in_blocks():
    """Return True within `lane_blocks.run_in_blocks`, that is, if block sizes are set."""
    return _block_sizes.get() is not None


def block_width():
    """Return the number of lanes in a block for the code being traced."""
    return (
        BLOCK_WIDTH // (_block_sizes.get() or BLOCK_SIZES[0]).block_width_divisor
        if is_traced_for_cpu()
        else GPU_BLOCK_WIDTHS[0]
    )


def reference_block_width():
    """Return the number of lanes in a block of the reference path, for the code being traced.

    Returns
    -------
    int
        Number of lanes. The blocks are narrow because few lanes need the reference path, and these lanes are slow.
    """
    return (
        NARROW_BLOCK_WIDTH // (_block_sizes.get() or BLOCK_SIZES[0]).block_width_divisor
        if is_traced_for_cpu()
        else GPU_BLOCK_WIDTHS[1]
    )


def is_traced_for_cpu():
    """Return True if the code being traced is for a CPU; compilation with hints for a GPU does not terminate."""
    default_device = jax.config.jax_default_device
    return (
        jax.default_backend() if default_device is None else getattr(default_device, "platform", default_device)
    ) == "cpu"


def _call_as_one_kernel(traced_function, *operands):
    """Call a function with the attribute ``xla_cpu_small_call``, in the form that XLA expects of a kernel."""
    operands = lax.optimization_barrier(traced_function.select_used_operands(operands))
    indices_by_signature = {}
    for operand_index, operand in enumerate(operands):
        indices_by_signature.setdefault((jnp.shape(operand), jnp.result_type(operand)), []).append(operand_index)

    def unpack_and_call(*stacks_by_signature):
        arguments = [None] * len(operands)
        for operand_stack, indices in zip(stacks_by_signature, indices_by_signature.values(), strict=True):
            for row, operand_index in enumerate(indices):
                arguments[operand_index] = lax.index_in_dim(operand_stack, row, keepdims=False)
        with set_xla_metadata(inlineable=None, xla_cpu_small_call=None):
            return traced_function.call_with_used_operands(*arguments), stacks_by_signature

    stacks_by_signature = [
        jnp.stack([operands[operand_index] for operand_index in (indices if len(indices) > 1 else 2 * indices)])
        for indices in indices_by_signature.values()
    ]
    with set_xla_metadata(inlineable="false", xla_cpu_small_call="true"):
        results = jax.jit(unpack_and_call)(*stacks_by_signature)
    return lax.optimization_barrier(results)[0]


def _lowering_rule(is_cpu_platform, context, *operands, call_jaxpr, kernel):
    """Return the MLIR of a kernel; mesh axes over which the operands may vary are ignored in tracing."""
    is_compiled_as_kernel = is_cpu_platform and any(kernel.is_used) and can_be_kernel(call_jaxpr.jaxpr)
    avals = [ShapedArray(aval.shape, aval.dtype) for aval in context.avals_in]
    return mlir.lower_fun(partial(_call_as_one_kernel, kernel) if is_compiled_as_kernel else kernel.flat)(
        context.replace(avals_in=avals), *operands
    )


def can_be_kernel(jaxpr) -> bool:
    """Return True if XLA can compile the loops of a jaxpr as one kernel."""
    return is_emittable_as_kernel(jaxpr) and max_cost_to_limit_ratio(jaxpr) <= 1


def compute_abstract_results(*avals, call_jaxpr, **static):
    """Return the abstract results; in a manual mesh a result varies over every axis over which an operand varies."""
    if not jax.sharding.get_abstract_mesh().manual_axes:
        return [ShapedArray(aval.shape, aval.dtype) for aval in call_jaxpr.out_avals]

    def depend_on_all_operands(*operands):
        operand_sum = sum(jnp.ravel(operand)[0].astype(float) for operand in operands)
        return [jnp.broadcast_to(operand_sum.astype(aval.dtype), aval.shape) for aval in call_jaxpr.out_avals]

    return jax.make_jaxpr(depend_on_all_operands)(*avals).out_avals


def _jvp_rule(primals, tangents, *, call_jaxpr, kernel):
    return jax.jvp(kernel.flat, tuple(primals), tuple(map(ad.instantiate_zeros, tangents)))


def _batching_rule(operands, axes, *, call_jaxpr, kernel):
    results = call_as_kernel(_vmap_kernel(kernel, tuple(axes)), *operands)
    return results, [0] * len(results)


@lru_cache(1024)
def _vmap_kernel(kernel, axes):
    return jax.vmap(kernel.flat, axes)


kernel_p = core.Primitive("one_kernel")
kernel_p.multiple_results = True
kernel_p.def_impl(lambda *operands, **static: jax.jit(partial(kernel_p.bind, **static))(*operands))
kernel_p.def_abstract_eval(compute_abstract_results)
mlir.register_lowering(kernel_p, partial(_lowering_rule, False))
mlir.register_lowering(kernel_p, partial(_lowering_rule, True), platform="cpu")
ad.primitive_jvps[kernel_p] = _jvp_rule
batching.primitive_batchers[kernel_p] = _batching_rule


@lru_cache(1024)
def is_emittable_as_kernel(jaxpr) -> bool:
    """Return True if a kernel can contain every operation of a jaxpr."""
    return all(
        equation.primitive.name not in NOT_EMITTABLE
        and not _is_library_call(equation)
        and all(map(is_emittable_as_kernel, core.jaxprs_in_params(equation.params)))
        for equation in jaxpr.eqns
    )


def _is_library_call(equation):
    """Return True if XLA calls a library for an operation; a kernel cannot call a library."""
    if equation.primitive.name in ("reduce_max", "reduce_min", "reduce_sum"):
        return equation.invars[0].aval.size >= MIN_LIBRARY_SUM
    if equation.primitive.name != "dot_general":
        return False
    lhs, rhs = (variable.aval for variable in equation.invars)
    (contracting_axes, _), (batch_axes, _) = equation.params["dimension_numbers"]
    n_contracted_terms, batch_size = (
        math.prod(lhs.shape[axis] for axis in axes) for axes in (contracting_axes, batch_axes)
    )
    n_rows, n_columns = (matrix.size // max(n_contracted_terms * batch_size, 1) for matrix in (lhs, rhs))
    if min(n_rows, n_columns) > 1 and max(n_rows, n_columns, n_contracted_terms) >= MIN_LIBRARY_SIDE:
        return True
    return batch_size * n_rows * n_contracted_terms * n_columns >= MIN_LIBRARY_SUM


def _find_live_variables(jaxpr):
    """Return the variables that the results of a jaxpr depend on."""
    live_variables = {variable for variable in jaxpr.outvars if not hasattr(variable, "val")}
    for equation in reversed(jaxpr.eqns):
        if not live_variables.isdisjoint(equation.outvars):
            live_variables.update(variable for variable in equation.invars if not hasattr(variable, "val"))
    return live_variables

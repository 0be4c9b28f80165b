"""Bound the cost of operations in a kernel, so that XLA does not split any of them over threads.

XLA splits an operation or loop fusion whose estimated cost exceeds that of two tasks. A kernel cannot start threads and
then fails to link (``Symbols not found: __xla_cpu_runtime_ParallelForkJoin``). The estimate follows the
``DefaultCostModel`` of XLA: bytes accessed if an operation reads and writes more than it computes, otherwise
flops + 2 transcendentals + 10 bytes accessed.
"""

from collections import Counter
from functools import lru_cache
from typing import NamedTuple

from jax.extend import core

COMPUTE_LIMIT = 2 * 100_000  # cost of two compute-bound tasks
MEMORY_LIMIT = 2 * (256 << 10)  # bytes of two memory-bound tasks
EXPONENTIALS = {"exp", "exp2", "log", "expm1", "log1p", "logistic", "pow", "sqrt", "rsqrt", "cbrt", "erf"}
ANGLES = {"sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"}
TRANSCENDENTAL = EXPONENTIALS | ANGLES
EXPENSIVE = TRANSCENDENTAL | {"div", "rem"}  # XLA stores such a result if several operations use it
COST_FREE = {
    "broadcast_in_dim",
    "reshape",
    "squeeze",
    "slice",
    "concatenate",
    "pad",
    "rev",
    "transpose",
    "iota",
    "copy",
}
MAX_FUSED_USES = 15  # evaluations of one operation in a fusion; XLA does not fuse beyond this number
IN_PLACE = {"dynamic_update_slice"}  # operations that XLA never splits


class FusionCone(NamedTuple):
    """Arrays that one fusion reads and operations that it computes, as bit masks over the lists of a region."""

    read_mask: int
    compute_mask: int


class FusionRegion:
    """Operations that XLA may fuse: the body of a loop, a branch, or a call that is not inlined."""

    def __init__(self):
        # bytes of each array read; (elements, is transcendental) of each operation
        self.read_sizes, self.operations = (
            [],
            [],
        )
        self.max_cost_share = 0.0  # largest ratio of a cost to its limit

    def read(self, aval):
        """Add an array in memory and return its cone."""
        self.read_sizes.append(_size_in_bytes(aval))
        return FusionCone(1 << (len(self.read_sizes) - 1), 0)

    def add_operation(self, equation, cones):
        """Add an operation and return the cone of its result."""
        name, aval = equation.primitive.name, equation.outvars[0].aval
        read_mask, compute_mask = (_union_of_masks(cone[field_index] for cone in cones) for field_index in (0, 1))
        if name not in COST_FREE:
            n_elements = max(aval.size, *(variable.aval.size for variable in equation.invars), 1)
            n_operations = max(abs(equation.params["y"]).bit_length() * 2 - 2, 1) if name == "integer_pow" else 1
            self.operations += [(n_elements, name in TRANSCENDENTAL)] * n_operations
            compute_mask |= ((1 << n_operations) - 1) << (len(self.operations) - n_operations)
        if name in EXPENSIVE:
            read_mask |= self.read(aval).read_mask
        if name == "dynamic_slice":
            return self.read(aval)
        return FusionCone(read_mask, compute_mask)

    def account_for_result(self, aval, cone):
        """Account for a fusion with this result."""
        n_elements, bytes_written = aval.size, _size_in_bytes(aval)
        bytes_read = [self.read_sizes[k] for k in _set_bits(cone.read_mask)]
        if n_elements <= 1 or (not cone.compute_mask and bytes_read == [bytes_written]):
            return  # a scalar cannot be split; an array in memory is not computed
        bytes_moved = bytes_written + sum(bytes_read)
        operations = [self.operations[k] for k in _set_bits(cone.compute_mask)]
        largest_read = max([size for size in bytes_read if size >= 8 * n_elements], default=0)
        small_operations = [operation for operation in operations if operation[0] <= n_elements]
        cost_shares = [
            _compute_cost_share(operations, bytes_moved, bytes_written + largest_read),
            _compute_cost_share(
                small_operations, bytes_moved, bytes_written if largest_read > 8 * n_elements else bytes_moved
            ),
        ]
        self.max_cost_share = max(self.max_cost_share, bytes_moved / MEMORY_LIMIT, *cost_shares)


def _compute_cost_share(operations, bytes_moved, min_bytes):
    """Return the cost share of a compute-bound fusion, and 0 for a memory-bound one."""
    flops = sum(n_elements for n_elements, transcendental in operations if not transcendental)
    if flops <= min_bytes:
        return 0.0
    transcendental = sum(n_elements for n_elements, transcendental in operations if transcendental)
    return (flops + 2 * transcendental + 10 * min(bytes_moved, flops)) / COMPUTE_LIMIT


@lru_cache(1024)
def cost_share(jaxpr) -> float:
    """Return the largest estimated cost of an operation in a jaxpr, relative to the cost at which XLA splits it."""
    region = FusionRegion()
    _visit_jaxpr(region, jaxpr, [region.read(variable.aval) for variable in jaxpr.invars])
    return region.max_cost_share


def _visit_jaxpr(region, jaxpr, input_cones):
    """Add the operations of a jaxpr to a region and return the cones of its results."""
    cones = dict(zip(jaxpr.invars, input_cones, strict=True))
    use_counts = Counter(
        variable for equation in jaxpr.eqns for variable in equation.invars if not isinstance(variable, core.Literal)
    )
    cones |= {variable: region.read(variable.aval) for variable in jaxpr.constvars}

    def cone_of(variable):
        return FusionCone(0, 0) if isinstance(variable, core.Literal) else cones[variable]

    for equation in jaxpr.eqns:
        operand_cones = [cone_of(variable) for variable in equation.invars]
        inner_jaxprs = list(core.jaxprs_in_params(equation.params))
        name = equation.primitive.name
        if name == "jit" and "inlineable" not in _compiler_hints(equation):
            output_cones = _visit_jaxpr(region, equation.params["jaxpr"].jaxpr, operand_cones)
        elif inner_jaxprs or name in IN_PLACE:
            for variable, cone in zip(equation.invars, operand_cones, strict=True):
                region.account_for_result(variable.aval, cone)
            region.max_cost_share = max([region.max_cost_share, *map(cost_share, inner_jaxprs)])
            output_cones = [region.read(variable.aval) for variable in equation.outvars]
        else:
            output_cones = [region.add_operation(equation, operand_cones)] * len(equation.outvars)
            if use_counts[equation.outvars[0]] > MAX_FUSED_USES:
                region.account_for_result(equation.outvars[0].aval, output_cones[0])
                output_cones = [region.read(equation.outvars[0].aval)]
        cones |= dict(zip(equation.outvars, output_cones, strict=True))
    for variable in jaxpr.outvars:
        region.account_for_result(variable.aval, cone_of(variable))
    return [cone_of(variable) for variable in jaxpr.outvars]


def _compiler_hints(equation):
    """Return the hints attached to an equation."""
    return getattr(equation.ctx, "xla_metadata", None) or {}


def _size_in_bytes(aval):
    return aval.size * aval.dtype.itemsize


def _union_of_masks(masks):
    """Return the bitwise union of masks."""
    union = 0
    for mask in masks:
        union |= mask
    return union


def _set_bits(mask):
    """Yield the positions of the set bits of a mask."""
    while mask:
        lowest_bit = mask & -mask
        yield lowest_bit.bit_length() - 1
        mask ^= lowest_bit

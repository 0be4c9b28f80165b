"""Estimate the cost of operations in a kernel and decide whether XLA would split an operation over threads.

XLA splits an operation or loop fusion whose estimated cost exceeds the cost of two tasks. A kernel cannot start
threads. A kernel with a split operation therefore fails to link (``Symbols not found:
__xla_cpu_runtime_ParallelForkJoin``). The estimate follows the ``DefaultCostModel`` of XLA. The cost of a memory-bound
operation, which reads and writes more than it computes, is the number of bytes accessed. The cost of other operations
is flops + 2 transcendentals + 10 bytes accessed.
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


class DependencyCone(NamedTuple):
    """Arrays and operations on which a value depends, as bit masks over the lists of a `FusionRegion`.

    Attributes
    ----------
    read_arrays_mask : int
        Mask of the arrays in memory that are read.
    operations_mask : int
        Mask of the operations that are computed.
    """

    read_arrays_mask: int
    operations_mask: int


class FusionRegion:
    """Operations that XLA may fuse: the body of a loop, a branch, or a call that is not inlined."""

    def __init__(self):
        # bytes of each array read; (elements, is transcendental) of each operation
        self.read_sizes, self.operations = (
            [],
            [],
        )
        self.max_cost_share = 0.0  # largest ratio of a cost to its limit

    def add_stored_array(self, abstract_array):
        """Add an array in memory and return its `DependencyCone`."""
        self.read_sizes.append(_size_in_bytes(abstract_array))
        return DependencyCone(1 << (len(self.read_sizes) - 1), 0)

    def add_operation(self, equation, operand_cones):
        """Add an operation and return the `DependencyCone` of its result."""
        primitive_name, aval = equation.primitive.name, equation.outvars[0].aval
        read_mask, compute_mask = (
            _union_of_masks(cone[field_index] for cone in operand_cones) for field_index in (0, 1)
        )
        if primitive_name not in COST_FREE:
            n_elements = max(aval.size, *(variable.aval.size for variable in equation.invars), 1)
            n_operations = (
                max(abs(equation.params["y"]).bit_length() * 2 - 2, 1) if primitive_name == "integer_pow" else 1
            )
            self.operations += [(n_elements, primitive_name in TRANSCENDENTAL)] * n_operations
            compute_mask |= ((1 << n_operations) - 1) << (len(self.operations) - n_operations)
        if primitive_name in EXPENSIVE:
            read_mask |= self.add_stored_array(aval).read_arrays_mask
        if primitive_name == "dynamic_slice":
            return self.add_stored_array(aval)
        return DependencyCone(read_mask, compute_mask)

    def account_for_fusion(self, result_aval, result_cone):
        """Include the fusion that computes a result in `max_cost_share`."""
        n_elements, bytes_written = result_aval.size, _size_in_bytes(result_aval)
        read_array_sizes = [
            self.read_sizes[position] for position in _positions_of_set_bits(result_cone.read_arrays_mask)
        ]
        if n_elements <= 1 or (not result_cone.operations_mask and read_array_sizes == [bytes_written]):
            return  # a scalar cannot be split; an array in memory is not computed
        bytes_moved = bytes_written + sum(read_array_sizes)
        fused_operations = [
            self.operations[position] for position in _positions_of_set_bits(result_cone.operations_mask)
        ]
        largest_read_size = max([size for size in read_array_sizes if size >= 8 * n_elements], default=0)
        small_operations = [operation for operation in fused_operations if operation[0] <= n_elements]
        cost_to_limit_ratios = [
            _cost_to_limit_ratio(fused_operations, bytes_moved, bytes_written + largest_read_size),
            _cost_to_limit_ratio(
                small_operations, bytes_moved, bytes_written if largest_read_size > 8 * n_elements else bytes_moved
            ),
        ]
        self.max_cost_share = max(self.max_cost_share, bytes_moved / MEMORY_LIMIT, *cost_to_limit_ratios)


def _cost_to_limit_ratio(operations, bytes_moved, memory_bound_flops):
    """Return the cost of a compute-bound fusion relative to `COMPUTE_LIMIT`; 0 for a memory-bound fusion."""
    n_flops = sum(n_elements for n_elements, is_transcendental in operations if not is_transcendental)
    if n_flops <= memory_bound_flops:
        return 0.0
    n_transcendentals = sum(n_elements for n_elements, is_transcendental in operations if is_transcendental)
    return (n_flops + 2 * n_transcendentals + 10 * min(bytes_moved, n_flops)) / COMPUTE_LIMIT


@lru_cache(1024)
def max_cost_to_limit_ratio(jaxpr) -> float:
    """Return the largest estimated cost of an operation in a jaxpr, relative to the cost at which XLA splits it."""
    fusion_region = FusionRegion()
    _add_jaxpr_to_region(
        fusion_region, jaxpr, [fusion_region.add_stored_array(variable.aval) for variable in jaxpr.invars]
    )
    return fusion_region.max_cost_share


def _add_jaxpr_to_region(fusion_region, jaxpr, input_cones):
    """Add the operations of a jaxpr to a `FusionRegion` and return the `DependencyCone` of each result."""
    cones_by_variable = dict(zip(jaxpr.invars, input_cones, strict=True))
    variable_use_counts = Counter(
        variable for equation in jaxpr.eqns for variable in equation.invars if not isinstance(variable, core.Literal)
    )
    cones_by_variable |= {variable: fusion_region.add_stored_array(variable.aval) for variable in jaxpr.constvars}

    def cone_of(variable):
        return DependencyCone(0, 0) if isinstance(variable, core.Literal) else cones_by_variable[variable]

    for equation in jaxpr.eqns:
        operand_cones = [cone_of(variable) for variable in equation.invars]
        inner_jaxprs = list(core.jaxprs_in_params(equation.params))
        primitive_name = equation.primitive.name
        if primitive_name == "jit" and "inlineable" not in _equation_hints(equation):
            output_cones = _add_jaxpr_to_region(fusion_region, equation.params["jaxpr"].jaxpr, operand_cones)
        elif inner_jaxprs or primitive_name in IN_PLACE:
            for variable, cone in zip(equation.invars, operand_cones, strict=True):
                fusion_region.account_for_fusion(variable.aval, cone)
            fusion_region.max_cost_share = max(
                [fusion_region.max_cost_share, *map(max_cost_to_limit_ratio, inner_jaxprs)]
            )
            output_cones = [fusion_region.add_stored_array(variable.aval) for variable in equation.outvars]
        else:
            output_cones = [fusion_region.add_operation(equation, operand_cones)] * len(equation.outvars)
            if variable_use_counts[equation.outvars[0]] > MAX_FUSED_USES:
                fusion_region.account_for_fusion(equation.outvars[0].aval, output_cones[0])
                output_cones = [fusion_region.add_stored_array(equation.outvars[0].aval)]
        cones_by_variable |= dict(zip(equation.outvars, output_cones, strict=True))
    for variable in jaxpr.outvars:
        fusion_region.account_for_fusion(variable.aval, cone_of(variable))
    return [cone_of(variable) for variable in jaxpr.outvars]


def _equation_hints(equation):
    """Return the compiler hints attached to an equation of a jaxpr."""
    return getattr(equation.ctx, "xla_metadata", None) or {}


def _size_in_bytes(aval):
    return aval.size * aval.dtype.itemsize


def _union_of_masks(masks):
    """Return the bitwise union of masks."""
    mask_union = 0
    for mask in masks:
        mask_union |= mask
    return mask_union


def _positions_of_set_bits(mask):
    """Yield the positions of the set bits of a mask."""
    while mask:
        lowest_bit = mask & -mask
        yield lowest_bit.bit_length() - 1
        mask ^= lowest_bit

"""Bound the cost of operations in a kernel, so that XLA does not split one of them over threads.

XLA splits an operation or loop fusion whose estimated cost exceeds that of two tasks, and a kernel cannot start
threads: it then fails to link (``Symbols not found: __xla_cpu_runtime_ParallelForkJoin``). The estimate is the one of
XLA's ``DefaultCostModel``: bytes accessed where an operation reads and writes more than it computes, else
flops + 2 transcendentals + 10 bytes accessed.
"""

from collections import Counter
from functools import lru_cache
from typing import NamedTuple

from jax.extend import core

COMPUTE_LIMIT = 2 * 100_000  # cost of two tasks that compute
MEMORY_LIMIT = 2 * (256 << 10)  # bytes of two tasks that read and write
EXPONENTIALS = {"exp", "exp2", "log", "expm1", "log1p", "logistic", "pow", "sqrt", "rsqrt", "cbrt", "erf"}
ANGLES = {"sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"}
TRANSCENDENTAL = EXPONENTIALS | ANGLES
EXPENSIVE = TRANSCENDENTAL | {"div", "rem"}  # XLA keeps such a result in memory where several operations use it
FREE = {"broadcast_in_dim", "reshape", "squeeze", "slice", "concatenate", "pad", "rev", "transpose", "iota", "copy"}
REPEATED = 15  # evaluations of one operation in a fusion; XLA does not fuse what would need more
IN_PLACE = {"dynamic_update_slice"}  # never split


class Cone(NamedTuple):
    """Everything that one fusion with this result may read and compute: sets as bit masks over a region's lists."""

    reads: int
    computes: int


class Region:
    """Operations among which XLA may fuse: the body of a loop, a branch, or a call that is not inlined."""

    def __init__(self):
        self.sizes, self.work = [], []  # bytes of each array read; (elements, whether transcendental) of each operation
        self.share = 0.0  # largest cost over its limit

    def read(self, aval):
        """The cone of an array in memory."""
        self.sizes.append(_bytes(aval))
        return Cone(1 << (len(self.sizes) - 1), 0)

    def computed(self, equation, cones):
        """The cone of an operation's result."""
        name, aval = equation.primitive.name, equation.outvars[0].aval
        reads, computes = (_union(cone[k] for cone in cones) for k in (0, 1))
        if name not in FREE:
            size = max(aval.size, *(v.aval.size for v in equation.invars), 1)
            times = max(abs(equation.params["y"]).bit_length() * 2 - 2, 1) if name == "integer_pow" else 1
            self.work += [(size, name in TRANSCENDENTAL)] * times
            computes |= ((1 << times) - 1) << (len(self.work) - times)
        if name in EXPENSIVE:
            reads |= self.read(aval).reads
        if name == "dynamic_slice":
            return self.read(aval)
        return Cone(reads, computes)

    def materialised(self, aval, cone):
        """Account for a fusion whose result is this array."""
        count, written = aval.size, _bytes(aval)
        reads = [self.sizes[k] for k in _bits(cone.reads)]
        if count <= 1 or (not cone.computes and reads == [written]):
            return  # a single number cannot be split; an array in memory is not computed
        moved = written + sum(reads)
        work = [self.work[k] for k in _bits(cone.computes)]
        large = max([size for size in reads if size >= 8 * count], default=0)
        small = [each for each in work if each[0] <= count]
        shares = [
            _compute(work, moved, written + large),
            _compute(small, moved, written if large > 8 * count else moved),
        ]
        self.share = max(self.share, moved / MEMORY_LIMIT, *shares)


def _compute(work, moved, least):
    """Cost share of a fusion that computes so much, where that is more flops than the bytes that it moves at least."""
    flops = sum(size for size, hard in work if not hard)
    if flops <= least:
        return 0.0
    hard = sum(size for size, hard in work if hard)
    return (flops + 2 * hard + 10 * min(moved, flops)) / COMPUTE_LIMIT


@lru_cache(1024)
def cost_share(jaxpr) -> float:
    """Largest estimated cost of an operation in a jaxpr, as a fraction of the cost from which XLA splits it."""
    region = Region()
    _walk(region, jaxpr, [region.read(v.aval) for v in jaxpr.invars])
    return region.share


def _walk(region, jaxpr, inputs):
    cones = dict(zip(jaxpr.invars, inputs, strict=True))
    uses = Counter(v for equation in jaxpr.eqns for v in equation.invars if not isinstance(v, core.Literal))
    cones |= {v: region.read(v.aval) for v in jaxpr.constvars}

    def of(v):
        return Cone(0, 0) if isinstance(v, core.Literal) else cones[v]

    for equation in jaxpr.eqns:
        given = [of(v) for v in equation.invars]
        inner = list(core.jaxprs_in_params(equation.params))
        name = equation.primitive.name
        if name == "jit" and "inlineable" not in _hints(equation):
            outputs = _walk(region, equation.params["jaxpr"].jaxpr, given)
        elif inner or name in IN_PLACE:
            for v, cone in zip(equation.invars, given, strict=True):
                region.materialised(v.aval, cone)
            region.share = max([region.share, *map(cost_share, inner)])
            outputs = [region.read(v.aval) for v in equation.outvars]
        else:
            outputs = [region.computed(equation, given)] * len(equation.outvars)
            if uses[equation.outvars[0]] > REPEATED:
                region.materialised(equation.outvars[0].aval, outputs[0])
                outputs = [region.read(equation.outvars[0].aval)]
        cones |= dict(zip(equation.outvars, outputs, strict=True))
    for v in jaxpr.outvars:
        region.materialised(v.aval, of(v))
    return [of(v) for v in jaxpr.outvars]


def _hints(equation):
    return getattr(equation.ctx, "xla_metadata", None) or {}


def _bytes(aval):
    return aval.size * aval.dtype.itemsize


def _union(masks):
    whole = 0
    for each in masks:
        whole |= each
    return whole


def _bits(mask):
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low

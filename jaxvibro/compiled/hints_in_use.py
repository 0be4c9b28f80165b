"""Which hints the compiler is given in this process, for reports of faults."""

from typing import Any

from . import compiler_hints, kernels


def describe_hints() -> dict[str, Any]:
    """Describe the compiler hints in use: options, marks of calls, and the widths of blocks of lanes.

    Returns
    -------
    dict
        ``applied`` (whether code is compiled for a processor, where alone hints are given), ``options`` of the
        compiler, ``marks`` of each kind of call, ``block_width`` and ``narrow_block_width`` in lanes.
    """
    enabled = kernels.on_cpu()
    stage = {"inlineable": "false"}
    marks = {"stage": stage, "one_kernel": {**stage, "xla_cpu_small_call": "true"}}
    return {
        "applied": enabled,
        "options": dict(compiler_hints.COMPILER_OPTIONS),
        "marks": marks if enabled else {},
        "block_width": kernels.block_width(),
        "narrow_block_width": kernels.narrow_block_width(),
    }

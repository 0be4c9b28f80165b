"""Report the compiler hints of this process."""

from typing import Any

from . import compiler_hints, kernels


def describe_hints() -> dict[str, Any]:
    """Describe the compiler hints in use: options, marks of calls, and block widths.

    Returns
    -------
    dict
        ``applied`` (True if code is compiled for a CPU; other devices get no hints), ``options`` of the compiler,
        ``marks`` of each kind of call, and ``block_width`` and ``narrow_block_width`` in lanes.
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

"""Report the compiler hints that this process uses."""

from typing import Any

from . import kernel_calls, lane_arithmetic


def describe_hints() -> dict[str, Any]:
    """Describe the compiler hints in use: options, attributes of calls, and block widths.

    Returns
    -------
    dict
        ``applied``: True if code is compiled for a CPU; code for other devices gets no hints. ``options``: compiler
        options. ``marks``: attributes of each kind of call. ``block_width``, ``narrow_block_width``: number of lanes in
        a block of the fast path and of the reference path.
    """
    is_for_cpu = kernel_calls.is_traced_for_cpu()
    no_inlining_attribute = {"inlineable": "false"}
    call_attributes = {
        "stage": no_inlining_attribute,
        "one_kernel": {**no_inlining_attribute, "xla_cpu_small_call": "true"},
    }
    return {
        "applied": is_for_cpu,
        "options": dict(lane_arithmetic.COMPILER_OPTIONS),
        "marks": call_attributes if is_for_cpu else {},
        "block_width": kernel_calls.block_width(),
        "narrow_block_width": kernel_calls.reference_block_width(),
    }

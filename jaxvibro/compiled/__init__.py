"""How XLA is asked to compile lanes.

In: functions of lanes. Out: the same, run block by block, their loops compiled as kernels where XLA can do so, whatever
program surrounds them. Start with `kernels`, then `blocks`; `compiler_hints` has the arithmetic of lanes.
"""

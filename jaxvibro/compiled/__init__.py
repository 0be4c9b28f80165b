"""How XLA is asked to compile lanes.

In: functions of lanes. Out: the same, run block by block, their loops and stages compiled as wide as the machine
is. Hints that cost speed where they are ignored, never a number. Start with `compiler_hints`.
"""

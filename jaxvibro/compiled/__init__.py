"""Run functions of many lanes block by block and compile their loops as single kernels.

`kernels` compiles a loop over lanes as one kernel wherever XLA can do so, independently of the surrounding program.
`blocks` splits lanes into blocks, and `compiler_hints` defines the arithmetic of lanes. Start with `kernels`, then
`blocks`.
"""

"""Run functions of many lanes block by block and compile their loops as single kernels.

`kernel_calls` compiles a loop over lanes as one kernel wherever XLA can do so, independently of the surrounding
program. `lane_blocks` splits lanes into blocks, and `lane_arithmetic` defines the arithmetic of lanes. Start with
`kernel_calls`, then `lane_blocks`."""

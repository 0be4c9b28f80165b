"""The equations of an orbit along parameters, as `continuation` takes them, and what bounds them.

In: an orbit's impacts and the names of parameters. Out: the residual in the unknowns z = (times, speeds, parameter)
with its tests, whether a solution is an orbit at all (`diagnostics`), and where a wall is just touched (`touches`,
`soft_grazing`). Start with `equations`.
"""

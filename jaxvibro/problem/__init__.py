"""Equations of a periodic orbit with free parameters, as `continuation` takes them, and their limits of validity.

The input is the impacts of an orbit and the names of parameters. `equations` gives the residual in the unknowns z =
(times, speeds, parameter) with its test functions, `diagnostics` checks whether a solution is an admissible orbit, and
`grazing_contact` and `soft_grazing` locate grazings. Start with `equations`.
"""

"""Equations of a periodic orbit with free parameters, in the form of `continuation`, and the limits of validity.

The input consists of the impacts of an orbit and the names of parameters. An `OrbitProblem` (`orbit_problem`) and its
unknowns z = (times, speeds, parameters) describe the orbit; `orbit_equations` has its compiled residual and test
functions. `orbit_equations` computes the quantities that decide whether a solution is an admissible orbit.
`grazing_contact` and `soft_wall_grazing` locate grazings. Start with `orbit_problem`.
"""

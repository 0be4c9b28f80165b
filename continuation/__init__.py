"""Numerical continuation of solutions of F(u, p) = 0; the package contains no oscillator.

Input is a `System`, made by `equilibria` or `fixed_points` from a function of (u, p, args), or by
`continuation.shooting.periodic_orbits`, which must be imported separately because it loads diffrax. `trace` continues
solutions in one parameter, or in several with functions held constant, and returns a `Branch` with its special points.
`switch` returns the branches that emanate from a special point. `curve` continues a special point in two parameters.
`save` and `load` write and read a branch. Start reading at `one_parameter.py`, then `driver.py`, the loop, and
`arclength.py`, the steps.
"""

from .branch import Branch, Special
from .branch_file import load, save
from .errors import ContinuationError
from .one_parameter import switch, trace
from .problem import equilibria, fixed_points
from .two_parameters import curve, sensitivity

__all__ = [
    "Branch",
    "ContinuationError",
    "Special",
    "curve",
    "equilibria",
    "fixed_points",
    "load",
    "save",
    "sensitivity",
    "switch",
    "trace",
]

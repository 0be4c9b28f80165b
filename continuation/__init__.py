"""Numerics of solution sets of F(u, p) = 0: no oscillator is known here.

In: a `System`, made by `equilibria` or `fixed_points` from a function of (u, p, args), or by
`continuation.shooting.periodic_orbits`, which is imported on its own as it loads diffrax. Out: a `Branch` of `trace`,
along one parameter, or with functions held along several, with its special points; `switch` gives the branches that
leave one, `curve` follows one in two parameters, `save` and `load` keep a branch in a file. Start reading at
`one_parameter.py`, then `driver.py`, the loop, and `arclength.py`, the steps.
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

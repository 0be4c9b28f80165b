"""Continue solutions of F(u, p) = 0 numerically; the package is independent of the oscillators of jaxvibro.

The equations are a `System`. `equilibria` and `fixed_points` make a `System` from a function of (u, p, args).
`continuation.shooting.periodic_orbits` makes the `System` of the periodic orbits of a field; it must be imported
separately, because it loads diffrax. `trace` continues solutions in one parameter, or in several parameters with
functions held constant, and returns a `Branch` with its special points. `switch` returns the branches that emanate from
a special point. `curve` continues a special point in two parameters, and `sensitivity` differentiates the parameter
value of the point with respect to other parameters. `save` and `load` write and read a branch.

To read the code, start at `one_parameter.py`. `continuation_loop.py` contains the loop and `arclength.py` the steps.
"""

from .branch import Branch, Special, load, save
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

"""Define user-defined forces, which take the place of the spring and the damper."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
from jaxtyping import ArrayLike, Real

DEFAULT_TOLERANCE = 1e-13
MIN_TOLERANCE, MAX_TOLERANCE = 1e-15, 1e-3


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Force:
    """User-defined acceleration of the mass, in place of ``-x - 2 damping v``.

    Parameters
    ----------
    function : callable or str
        ``function(t, x, v, numbers)`` of scalars, written with jax.numpy, or the name of a predefined force:
        ``"duffing"``, ``"polynomial"``, ``"pendulum"``, ``"stribeck"``, ``"van_der_pol"``, ``"tabulated"``
        (docs/force.md). Here t is the phase of the drive over its frequency. The force must repeat with the period of
        the drive.
    numbers : dict of str to array_like, optional
        Parameters of the function. They are parameters of the scene with the names ``"force.<name>"``.
    tolerance : float, optional
        Bound on the error of a step, relative to the largest of x, v, the distances of the walls and the drive
        amplitude.
    solver : object or str, optional
        Solver of diffrax with error estimates, or its name. None takes Taylor steps if all operations of the force have
        a Taylor series, else ``"Dopri8"``. A stiff force needs an implicit solver such as ``"Kvaerno5"``.

    Notes
    -----
    Compiled code is cached for the function object. Define the function once, not anew for each call.

    Examples
    --------
    >>> force = jv.Force("duffing", {"cubic": 0.5, "damping": 0.05})
    >>> scene = jv.make_scene(2.0, 2.1, restitution=0.7, walls=(-1.0, 1.0), force=force)
    >>> scene.names[-6:-4]
    ('force.cubic', 'force.damping')
    """

    function: Callable[..., Any] | str = field(metadata={"static": True})
    numbers: Mapping[str, Real[ArrayLike, "..."]] = field(default_factory=dict)
    tolerance: float = field(default=DEFAULT_TOLERANCE, metadata={"static": True})
    solver: Any = field(default=None, metadata={"static": True})


def with_positional_params(function, parameter_names, n_leading_arguments=3):
    """Return a function of positional parameters for a function that takes its parameters as a dict.

    Parameters
    ----------
    function : callable
        Function of its arguments and a dict of parameters.
    parameter_names : tuple of str
        Names of the parameters, in order.
    n_leading_arguments : int, optional
        Number of arguments before the parameters, 3 for ``(t, x, v)``.

    Returns
    -------
    callable
        ``function(t, x, v, *numbers)``, the parameters in the order of `parameter_names`.
    """

    def call_with_param_dict(*arguments):
        return function(
            *arguments[:n_leading_arguments], dict(zip(parameter_names, arguments[n_leading_arguments:], strict=True))
        )

    return call_with_param_dict


def trace_jaxpr(function, parameter_names, dtype, n_leading_arguments=3):
    """Trace a function with scalars of one type, without a cache, and return its `ClosedJaxpr`."""
    return jax.make_jaxpr(with_positional_params(function, parameter_names, n_leading_arguments))(
        *[jax.ShapeDtypeStruct((), dtype)] * (n_leading_arguments + len(parameter_names))
    )

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


def flat_function(function, names, n_arguments=3):
    """Return ``function(t, x, v, *numbers)`` for a function that takes its parameters as a dict.

    Parameters
    ----------
    function : callable
        Function of its arguments and a dict of parameters.
    names : tuple of str
        Names of the parameters, in order.
    n_arguments : int, optional
        Number of arguments before the parameters.

    Returns
    -------
    callable
        The function of positional numbers.
    """

    def call_flat(*arguments):
        return function(*arguments[:n_arguments], dict(zip(names, arguments[n_arguments:], strict=True)))

    return call_flat


def trace_jaxpr(function, names, dtype, n_arguments=3):
    """Trace a force anew with scalars of a type and return its `ClosedJaxpr`."""
    return jax.make_jaxpr(flat_function(function, names, n_arguments))(
        *[jax.ShapeDtypeStruct((), dtype)] * (n_arguments + len(names))
    )

"""Define periodic orbits of u' = f(u, p, args) by multiple shooting; the only module that imports diffrax.

`periodic_orbits` makes the `System` of a field for `trace`, `switch` and `curve`. `settled` integrates the field and
returns an approximate starting orbit, for fields without a Hopf point at which `switch` can start.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Real

from .errors import ContinuationError, check_types, error_summary
from .problem import ORBITS, System, SystemFunction

MAX_SOLVER_STEPS = 16**3  # largest number of steps of the solver in a segment; beyond it the solver fails
TOLERANCE = 1e-13  # relative and absolute tolerance of the solver


@dataclass(frozen=True)
class FieldFlow:
    """Flow of a vector field.

    Attributes
    ----------
    field : callable
        Vector field, a function of (u, p, args).
    solver : diffrax.AbstractSolver
        Solver of diffrax.
    tolerance : float
        Relative and absolute tolerance of the steps.
    """

    field: SystemFunction
    solver: diffrax.AbstractSolver
    tolerance: float

    def __call__(self, start_point: Any, time: Any, p: Any, args: Any) -> Any:
        """Return the state after a time from `start_point`. The state is not finite if the solver fails."""

        def scaled_field(_, u, ode_args):
            time, p, args = ode_args
            return time * jnp.asarray(self.field(u, p, args))

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(scaled_field),
            self.solver,
            0.0,
            1.0,
            None,
            start_point,
            (time, p, args),
            stepsize_controller=diffrax.PIDController(self.tolerance, self.tolerance),
            adjoint=diffrax.ForwardMode(),
            max_steps=MAX_SOLVER_STEPS,
            throw=False,
        )
        assert solution.ys is not None  # diffrax returns the final state
        return jnp.where(solution.result == diffrax.RESULTS.successful, solution.ys[-1], jnp.nan)


@check_types
def periodic_orbits(
    field: SystemFunction, segments: int = 8, solver: diffrax.AbstractSolver | None = None, tolerance: float = TOLERANCE
) -> System:
    """Define the periodic orbits of a vector field by multiple shooting.

    Solutions satisfy ``u' = field(u, p, args)`` and are integrated by diffrax. Period doublings (PD) and Neimark-Sacker
    points (NS) are located besides folds (SN) and branch points (BP).

    Parameters
    ----------
    field : callable
        Vector field, a JAX function of (u, p, args) that returns an array of shape (n,).
    segments : int, optional
        Number of shooting segments. More segments reduce the growth of perturbations within a segment.
    solver : diffrax.AbstractSolver, optional
        Solver of diffrax. None stands for Dopri8.
    tolerance : float, optional
        Relative and absolute tolerance of the solver.

    Returns
    -------
    System
        System for `trace`. Its u, of shape ``(segments*n + 1,)``, contains one point per segment, evenly spaced in
        time, and the period. Its eigenvalues are the n - 1 multipliers without the trivial one.

    Raises
    ------
    ContinuationError
        If an argument is invalid.

    See Also
    --------
    settled : Integrate the field and return an approximate periodic orbit.

    Notes
    -----
    The tolerance of `trace`, `switch` and `curve` is at least 10 times that of the solver, because Newton's steps do
    not shrink below this length.

    Examples
    --------
    >>> from continuation.shooting import periodic_orbits
    >>> def field(u, p, args):
    ...     return jnp.stack([u[1], p["m"] * (1 - u[0] ** 2) * u[1] - u[0]])
    >>> system = periodic_orbits(field, segments=4)
    >>> system.kind, system.segments
    ('periodic orbits', 4)
    """
    if not isinstance(segments, int) or segments < 1:
        raise ContinuationError("segments", "must be a whole number of at least 1", segments)
    if not (isinstance(tolerance, float) and 0 < tolerance < 1):
        raise ContinuationError("tolerance", "must be between 0 and 1", tolerance)
    return System(
        field, ORBITS, 1, FieldFlow(field, diffrax.Dopri8() if solver is None else solver, tolerance), segments
    )


@check_types
def settled(
    system: System,
    start: Real[ArrayLike, " size"] | Sequence[float],
    period: float,
    at: Mapping[str, float],
    args: Any = None,
    rounds: int = 0,
) -> Float[np.ndarray, " unknowns"]:
    """Integrate a field and return an approximate periodic orbit for `trace`.

    Parameters
    ----------
    system : System
        System made by `periodic_orbits`.
    start : array_like
        Initial state. Array of shape (n,).
    period : float
        Approximate period of the orbit.
    at : mapping of str to float
        Values of the parameters.
    args : Any, optional
        Further argument of the field.
    rounds : int, optional
        Number of periods that are integrated before the orbit is sampled.

    Returns
    -------
    ndarray
        Approximate solution u of the system. Array of shape ``(segments*n + 1,)``.

    Raises
    ------
    ContinuationError
        If `system` is not a system of periodic orbits or the field does not take `start`.

    See Also
    --------
    periodic_orbits : Define the system.

    Examples
    --------
    >>> from continuation.shooting import periodic_orbits, settled
    >>> def field(u, p, args):
    ...     return jnp.stack([u[1], p["m"] * (1 - u[0] ** 2) * u[1] - u[0]])
    >>> u = settled(periodic_orbits(field, segments=4), [2.0, 0.0], 6.66, {"m": 1.0}, rounds=3)
    >>> u.shape
    (9,)
    """
    if not isinstance(system, System) or system.fly is None:
        raise ContinuationError("system", "must be a system made by `periodic_orbits`", system)
    p = {name: float(value) for name, value in at.items()}
    n_segments = system.segments * system.times
    compiled_flow = jax.jit(partial(system.fly))  # a new function, which is traced anew
    orbit_points = [np.asarray(start, float)]
    if orbit_points[0].ndim != 1 or not orbit_points[0].size:
        raise ContinuationError("start", "must be a state with one number per equation", start)
    try:
        jax.eval_shape(compiled_flow, orbit_points[0], period / n_segments, p, args)
    except Exception as error:  # a user's field may raise any exception
        rule = f"must be a state that the field takes with these `at` and `args` ({error_summary(error)})"
        raise ContinuationError("start", rule, start) from error
    for _ in range(n_segments * (rounds + 1) - 1):
        orbit_points.append(np.asarray(compiled_flow(orbit_points[-1], period / n_segments, p, args)))
    return np.append(np.concatenate(orbit_points[-n_segments:]), period)

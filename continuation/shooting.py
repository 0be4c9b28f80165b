"""Periodic orbits of u' = f(u, p, args), flown by diffrax: the only file that imports it.

In: a field. Out: `periodic_orbits`, the `System` for `trace`, `switch` and `curve`; `settled`, an orbit to begin with
where there is no Hopf point to `switch` from.
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

from .errors import ContinuationError, check_types, first_line
from .problem import ORBITS, System, SystemFunction

MAX_SOLVER_STEPS = 16**3  # of a solver in a segment: more is taken for a failure
TOLERANCE = 1e-13  # of the solver, relative and absolute


@dataclass(frozen=True)
class FieldFlow:
    """Flies along a field. solver: of diffrax; tolerance: of its steps, relative and absolute."""

    field: SystemFunction
    solver: diffrax.AbstractSolver
    tolerance: float

    def __call__(self, x: Any, time: Any, p: Any, args: Any) -> Any:
        """u at a time, from x on; not finite where the solver fails."""

        def scaled_field(_, u, ode_args):
            time, p, args = ode_args
            return time * jnp.asarray(self.field(u, p, args))

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(scaled_field),
            self.solver,
            0.0,
            1.0,
            None,
            x,
            (time, p, args),
            stepsize_controller=diffrax.PIDController(self.tolerance, self.tolerance),
            adjoint=diffrax.ForwardMode(),
            max_steps=MAX_SOLVER_STEPS,
            throw=False,
        )
        assert solution.ys is not None  # it is asked for the end
        return jnp.where(solution.result == diffrax.RESULTS.successful, solution.ys[-1], jnp.nan)


@check_types
def periodic_orbits(
    field: SystemFunction, segments: int = 8, solver: diffrax.AbstractSolver | None = None, tolerance: float = TOLERANCE
) -> System:
    """The `System` of the periodic orbits of u' = field(u, p, args), by multiple shooting with diffrax. Besides folds
    (SN) and branch points (BP), period doublings (PD) and Neimark-Sacker points (NS) are watched.

    Its u is that many points, evenly spread in time, one after another, and the period: (segments n + 1,); its
    eigenvalues are the n - 1 multipliers but for that of the field's own direction, 1. segments: the more, the milder
    the growth within each; solver: of diffrax, Dopri8 where None; tolerance: of its steps, relative and absolute. The
    tolerance of `trace`, `switch` and `curve` is at least 10 times as large: Newton's steps do not become shorter.

    Raises ContinuationError for arguments that cannot be.
    """
    if not isinstance(segments, int) or segments < 1:
        raise ContinuationError("segments", "must be a whole number from 1 on", segments)
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
    """The u of `periodic_orbits` to begin a `trace` with: (segments n + 1,), from a run of its field.

    start: (n,), where it begins; period: about that of the orbit; at: {name: number}, the parameters; rounds: how
    many periods it runs before. Raises ContinuationError for what is no system of periodic orbits.
    """
    if not isinstance(system, System) or system.fly is None:
        raise ContinuationError("system", "must be one of `periodic_orbits`", system)
    p = {name: float(value) for name, value in at.items()}
    n_segments = system.segments * system.times
    fly = jax.jit(partial(_fly, system.fly))
    points = [np.asarray(start, float)]
    if points[0].ndim != 1 or not points[0].size:
        raise ContinuationError("start", "must be a state, one number for each equation", start)
    try:
        jax.eval_shape(fly, points[0], period / n_segments, p, args)
    except Exception as error:  # whatever a user's field falls over
        rule = f"must be a state that the field takes with these `at` and `args` ({first_line(error)})"
        raise ContinuationError("start", rule, start) from error
    for _ in range(n_segments * (rounds + 1) - 1):
        points.append(np.asarray(fly(points[-1], period / n_segments, p, args)))
    return np.append(np.concatenate(points[-n_segments:]), period)


def _fly(fly, x, time, p, args):
    return fly(x, time, p, args)

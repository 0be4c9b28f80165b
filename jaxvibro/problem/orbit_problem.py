"""Define the problem of a periodic orbit: a scene with free parameters, the order of the impacts, and a condition.

An `OrbitProblem` and its unknowns z describe an orbit wherever it is continued, corrected or compared. The unknowns are
z = (times, speeds, parameters), or (x and v at the section, parameters) without impacts. A `Condition` is an equation
that holds besides periodicity, for example that an impact has zero speed. Branches have none.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from continuation import augmented_systems, event_search
from continuation.arclength import Point, StepControl, make_control
from continuation.array_type import Array
from continuation.augmented_systems import RootAndResidual
from continuation.problem import Problem

from ..contact.kinds import flow_of_scene
from ..orbits.impact_equations import ImpactSequence
from ..scene.scene import Scene
from ..scene.scene_parameters import mark_parameters
from ..scene.scene_properties import typical_length
from .orbit_equations import (
    FREE_PROBLEM,
    IMPACT_PROBLEM,
    STICKING_PROBLEM,
    are_releases,
    diagnose,
    free_or_fixed_value,
    mark_impact_rows,
    sides_with_release_codes,
)

NEWTON_STEPS = 12  # Newton steps to an orbit without impacts
SINGULAR_RATIO = 1e-7  # relative to the largest singular value; directions below this are not solved for
Rows = Sequence[int] | Int[np.ndarray, " selected"]  # indices of rows of a sequence


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Condition:
    """Equation that holds besides periodicity; this base class has none.

    The fields of subclasses are arrays, because compiled functions take a condition as an argument.
    """

    relative_slack = 0.0  # `OrbitProblem.slack` relative to the length of the scene

    def equations(self, problem: "OrbitProblem") -> Problem:
        """Return the equations in the form of `continuation`.

        Parameters
        ----------
        problem : OrbitProblem
            Problem with this condition.

        Returns
        -------
        continuation.problem.Problem
            Equations of orbits without impacts, with impacts, or with sticking.
        """
        if not problem.n_rows:
            return FREE_PROBLEM
        return IMPACT_PROBLEM if problem.sequence.releases is None else STICKING_PROBLEM

    def impact_rows(self, sequence: ImpactSequence) -> Int[np.ndarray, " impacts"]:
        """Return the indices of the rows whose speeds must be positive.

        Parameters
        ----------
        sequence : ImpactSequence
            Sequence of the orbit.

        Returns
        -------
        ndarray
            Rows of the impacts, without releases.
        """
        return np.flatnonzero(mark_impact_rows(sequence))

    def sticking_margins(self, diagnostics: Any) -> tuple[Float[np.ndarray, "*points rows"], ...]:
        """Return the margins of the sticking phases that must stay positive along a curve.

        Parameters
        ----------
        diagnostics : Diagnostics
            Diagnostics of the points.

        Returns
        -------
        sticking_time, min_contact_force : ndarray
            Durations and least contact forces of the sticking phases.
        """
        return diagnostics.sticking_time, diagnostics.min_contact_force

    def select_rows(self, rows: Rows, n_rows: int) -> "Condition":
        """Return the condition on a sequence that consists of some rows of the present one.

        Parameters
        ----------
        rows : sequence of int
            Present indices of the rows.
        n_rows : int
            Number of rows of the new sequence, with empty ones.

        Returns
        -------
        Condition
            Condition on the new sequence.
        """
        return self


PERIODIC = Condition()  # nothing holds besides periodicity


class OrbitProblem(NamedTuple):
    """Problem of a periodic orbit.

    Attributes
    ----------
    scene : Scene
        Scene. The values of the free parameters have no effect on the equations, but set `length_scale`.
    parameter_marks : Scene
        Copy of the scene with 1 in place of the first free parameter, 2 for the second, and 0 elsewhere.
    sequence : ImpactSequence
        Sides, phase and periods. The times and speeds are ignored.
    condition : Condition
        Equation that holds besides periodicity.
    """

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence
    condition: Condition = PERIODIC

    @property
    def n_rows(self) -> int:
        """Number of rows of the sequence, with empty ones."""
        return len(self.sequence.sides)

    @property
    def n_used_rows(self) -> int:
        """Number of impacts and releases."""
        return int(np.sum(self.sequence.sides != 0))

    @property
    def n_orbit_unknowns(self) -> int:
        """Number of unknowns before the parameters."""
        return 2 * self.n_rows or 2

    @property
    def impact_rows(self) -> Int[np.ndarray, " impacts"]:
        """Indices of the rows that are impacts, whose speeds must be positive."""
        return self.condition.impact_rows(self.sequence)

    @property
    def length_scale(self) -> float:
        """Length of the scene, by which positions, speeds and lengths among the parameters are divided."""
        return typical_length(self.scene)

    @property
    def slack(self) -> float:
        """Depth behind a wall that an admissible flight may have; positive on a locus of grazings, for rounding."""
        relative_slack = self.condition.relative_slack
        return relative_slack * self.length_scale if relative_slack else 0.0  # the length takes time

    @property
    def equations(self) -> Problem:
        """Equations in the form of `continuation`."""
        return self.condition.equations(self)

    def parameter_value(self, z: Float[Array, " unknowns"], name: str) -> float:
        """Return the value of a parameter at z, free or fixed.

        Parameters
        ----------
        z : ndarray
            Unknowns.
        name : str
            Name of a field of the scene.

        Returns
        -------
        float
            Value of the parameter.
        """
        return free_or_fixed_value(self, z, getattr(self.parameter_marks, name), getattr(self.scene, name))

    def with_scene_at(self, z: Float[Array, " z"]) -> "OrbitProblem":
        """Return the problem with the values of the free parameters at z in its scene, which set its length scale.

        Parameters
        ----------
        z : ndarray
            Unknowns.

        Returns
        -------
        OrbitProblem
            The same equations.
        """
        parameters = z[self.n_orbit_unknowns :]

        def value_of(leaf, mark):
            return np.asarray(parameters[int(mark) - 1], leaf.dtype) if int(mark) else leaf

        return self._replace(scene=jax.tree.map(value_of, self.scene, self.parameter_marks))

    def duration(self, z: Float[Array, " unknowns"]) -> float:
        """Return the duration of the orbit.

        Parameters
        ----------
        z : ndarray
            Unknowns.

        Returns
        -------
        float
            Duration in t.
        """
        return float(self.sequence.periods) * 2.0 * np.pi / self.parameter_value(z, "frequency")

    def evaluate(
        self, z: Float[Array, " z"]
    ) -> tuple[Float[np.ndarray, " equations"], Float[np.ndarray, "equations z"]]:
        """Evaluate the equations.

        Parameters
        ----------
        z : ndarray
            Unknowns.

        Returns
        -------
        residual : ndarray
            Residual F.
        jacobian : ndarray
            dF/dz.
        """
        residual, jacobian = augmented_systems.evaluate_problem(self.equations, z, self)
        return np.asarray(residual), np.asarray(jacobian)

    def weights(self, length_scale: float | None = None) -> Float[np.ndarray, " z"]:
        """Return the weights of the unknowns in the arclength.

        Speeds, and parameters that are lengths, are divided by the length of the scene. Times are not scaled. Times and
        speeds contribute as a root mean square over the impacts. The unknowns x and v of an orbit without impacts are
        divided by the length of the scene.

        Parameters
        ----------
        length_scale : float, optional
            Another length in place of the length of the scene.

        Returns
        -------
        ndarray
            One weight for each unknown.
        """
        length_scale = self.length_scale if length_scale is None else length_scale
        impact_weight = 1.0 / max(1.0, np.sqrt(np.sum(self.sequence.sides != 0)))
        impact_weights = np.asarray(self.sequence.sides != 0, float) * impact_weight
        orbit_weights = (
            np.concatenate([impact_weights, impact_weights / length_scale])
            if self.n_rows
            else np.ones(2) / length_scale
        )
        n_parameters = max(int(parameter_number) for parameter_number in jax.tree.leaves(self.parameter_marks))
        parameter_scales = [
            _parameter_scale(self.parameter_marks, number, length_scale) for number in range(1, n_parameters + 1)
        ]
        return np.append(orbit_weights, [1.0 / scale for scale in parameter_scales])

    def tangent(self, z: Float[Array, " z"], reference: Float[Array, " z"] | None = None) -> Float[np.ndarray, " z"]:
        """Compute the unit tangent of the curve at a regular point.

        Parameters
        ----------
        z : ndarray
            Unknowns.
        reference : ndarray, optional
            Direction with which the tangent encloses an acute angle. None stands for increasing parameter.

        Returns
        -------
        ndarray
            Tangent.
        """
        return event_search.unit_tangent(self.equations, z, self.weights(), self, reference)

    def take_step(self, start: Point, arclength: float, control: StepControl) -> Point:
        """Take one step from a point.

        Parameters
        ----------
        start : Point
            Point and its tangent.
        arclength : float
            Length of the step along the tangent.
        control : StepControl
            Weights and tolerance.

        Returns
        -------
        Point
            The point of the curve; `converged` states whether Newton's method succeeded.
        """
        return event_search.take_step(self.equations, start, arclength, control, self)

    def solve_at(self, z: Float[Array, " z"], index: int, value: float, length_scale: float | None = None) -> Point:
        """Correct z by Newton's method, up to rounding, with one fixed entry.

        Parameters
        ----------
        z : ndarray
            Guess.
        index : int
            Index of the fixed entry.
        value : float
            Value of the fixed entry.
        length_scale : float, optional
            Length in the weights, as in `weights`.

        Returns
        -------
        Point
            Solution; valid if ``converged`` is true.
        """
        control = make_control(self.weights(length_scale), 0.0, 1.0, 1.0, (-np.inf, np.inf))
        return event_search.solve_with_fixed_entry(self.equations, z, index, value, control, self)

    def locate_zero(
        self,
        z: Float[Array, " z"],
        functions: Callable[[Any], Any],
        entry_indices: Sequence[int] | None = None,
        n_extra: int = 0,
    ) -> RootAndResidual:
        """Locate the zero of as many functions as there are free unknowns, along the curve.

        Parameters
        ----------
        z : ndarray
            Guess, followed by `n_extra` further unknowns.
        functions : callable
            Function of z and the further unknowns that returns one or more numbers.
        entry_indices : sequence of int, optional
            Entries on which the functions depend. None means all.
        n_extra : int, optional
            Number of further unknowns.

        Returns
        -------
        RootAndResidual
            The zero and the largest residual.
        """
        return augmented_systems.locate_zero(self.equations, z, self, functions, entry_indices, n_extra)

    def impacts(
        self, z: Float[Array, "*points z"]
    ) -> tuple[Float[Array, "*points used"], Float[Array, "*points used"], Float[np.ndarray, " used"]]:
        """Return times, speeds and sides of the impacts and releases.

        Parameters
        ----------
        z : ndarray
            Unknowns of one orbit or of several, array of shape (..., unknowns).

        Returns
        -------
        times, speeds : ndarray
            Arrays of shape (..., used rows).
        sides : ndarray
            Sides, multiplied by 2 or 3 for releases, array of shape (used rows,).
        """
        n_rows, n_used_rows = self.n_rows, self.n_used_rows
        sides = np.asarray(sides_with_release_codes(self.sequence)[:n_used_rows])
        return z[..., :n_used_rows], z[..., n_rows : n_rows + n_used_rows], sides

    def with_impacts(
        self,
        z: Float[Array, " z"],
        impacts: Sequence[tuple[Any, ...]],
        rows: Rows = (),
        periods: float | None = None,
    ) -> tuple["OrbitProblem", Float[np.ndarray, " other"]]:
        """Return the problem of an orbit with other impacts, and its unknowns.

        Parameters
        ----------
        z : ndarray
            Unknowns of this problem, with the values of the parameters.
        impacts : sequence of tuple
            Time, speed and side of each impact and release in order; the sides are multiplied by 2 or 3 for releases.
        rows : sequence of int, optional
            Rows of this problem that are the first of the impacts; they keep their part in the condition.
        periods : float, optional
            Another number of drive periods.

        Returns
        -------
        problem : OrbitProblem
            Problem whose number of rows is a power of two, at least 2, so that fewer sizes are compiled; 0 without
            impacts.
        z : ndarray
            Unknowns. Without impacts they are solved for, under a user-defined force from the state of this orbit.
        """
        n_rows = max(2, 1 << (len(impacts) - 1).bit_length()) if impacts else 0
        impact_columns = np.zeros((3, n_rows))
        for k, impact in enumerate(impacts):
            impact_columns[:, k] = impact
        times, speeds, side_codes = impact_columns
        release_codes = np.where(are_releases(side_codes), abs(side_codes) - 1.0, 0.0)
        sequence = self.sequence._replace(
            times=times,
            speeds=speeds,
            sides=np.sign(side_codes),
            grazing=None if self.sequence.grazing is None else select_rows(self.sequence.grazing, rows, n_rows),
            releases=release_codes if release_codes.any() else None,
            periods=self.sequence.periods if periods is None else np.asarray(float(periods)),
        )
        problem = self._replace(sequence=sequence, condition=self.condition.select_rows(rows, n_rows))
        parameters = z[self.n_orbit_unknowns :]
        if not impacts:
            return problem, solve_impact_free_orbit(problem, parameters, self.section_state(z))
        return problem, np.concatenate([times, speeds, parameters])

    def with_rows(self, z: Float[Array, " z"], rows: Rows) -> tuple["OrbitProblem", Float[np.ndarray, " other"]]:
        """Return the problem of an orbit with only some of the impacts, and its unknowns.

        Parameters
        ----------
        z : ndarray
            Unknowns of this problem.
        rows : sequence of int
            Rows that remain.

        Returns
        -------
        problem : OrbitProblem
            Problem, as of `with_impacts`.
        z : ndarray
            Unknowns.
        """
        impacts = list(zip(*self.impacts(z), strict=True))
        return self.with_impacts(z, [impacts[row] for row in rows], rows)

    def section_state(self, z: Float[Array, " z"]) -> tuple[float, float]:
        """Return (x, v) at the section, as a guess that is needed only under a user-defined force.

        Parameters
        ----------
        z : ndarray
            Unknowns.

        Returns
        -------
        tuple of float
            State; (0, 0) for an orbit with impacts of a linear spring.
        """
        if not self.n_rows:
            return float(z[0]), float(z[1])
        if flow_of_scene(self.scene).has_unique_free_response():
            return 0.0, 0.0
        diagnostics = diagnose(self, z[None])
        return float(diagnostics.x[0, 0]), float(diagnostics.v[0, 0])

    def repeat(
        self, z: Float[np.ndarray, " z"], n_traversals: int
    ) -> tuple["OrbitProblem", Float[np.ndarray, " other"]]:
        """Return the problem of several traversals of an orbit, and its unknowns.

        Parameters
        ----------
        z : ndarray
            Unknowns of the orbit.
        n_traversals : int
            Number of traversals.

        Returns
        -------
        problem : OrbitProblem
            Problem with `n_traversals` times as many periods.
        z : ndarray
            Unknowns.
        """
        periods = float(n_traversals * self.sequence.periods)
        if not self.n_rows:
            return self._replace(sequence=self.sequence._replace(periods=np.asarray(periods))), z
        (times, speeds, sides), duration = self.impacts(z), self.duration(z)
        impacts = [
            (time + traversal * duration, speed, side)
            for traversal in range(n_traversals)
            for time, speed, side in zip(times, speeds, sides, strict=True)
        ]
        return self.with_impacts(z, impacts, periods=periods)


def make_orbit_problem(scene, *names, periods, closure_sign=None):
    """Make the problem of an orbit without impacts at phase 0.

    Parameters
    ----------
    scene : Scene
        Scene.
    *names : str or tuple of str
        Free parameters; a tuple of names is one parameter.
    periods : float
        Number of drive periods.
    closure_sign : float, optional
        Closure sign of the sequence.

    Returns
    -------
    OrbitProblem
        Problem; `OrbitProblem.with_impacts` adds the impacts.
    """
    empty_column = np.zeros(0)
    scalars = [None if scalar is None else np.asarray(float(scalar)) for scalar in (0.0, periods, closure_sign)]
    return OrbitProblem(*mark_parameters(scene, *names), ImpactSequence(*[empty_column] * 3, *scalars))


def select_rows(column, rows, n_rows):
    """Select rows of a column.

    Parameters
    ----------
    column : ndarray
        One value for each row.
    rows : sequence of int
        Indices of the rows.
    n_rows : int
        Number of rows of the result.

    Returns
    -------
    ndarray
        Values of these rows, followed by zeros.
    """
    selected = np.zeros(n_rows)
    selected[: len(rows)] = column[list(rows)]
    return selected


def _parameter_scale(parameter_marks, parameter_number, length_scale):
    """Return the length of the scene if the parameter is a length, else 1."""
    wall_marks = parameter_marks.walls.values()
    length_marks = [
        parameter_marks.amplitude,
        *(term_marks.amplitude for term_marks in parameter_marks.drive),
        *(wall_mark.position for wall_mark in wall_marks),
    ]
    length_marks += [wall_mark.motion.amplitude for wall_mark in wall_marks if wall_mark.motion is not None]
    return length_scale if any(mark == parameter_number for mark in length_marks) else 1.0


def solve_impact_free_orbit(problem, parameters, guess_state):
    """Solve for an orbit without impacts by Newton's method.

    Parameters
    ----------
    problem : OrbitProblem
        Problem without impacts.
    parameters : array_like
        Values of the free parameters.
    guess_state : tuple of float
        Approximate x and v at the section. They are ignored if they are not finite, and with a linear spring and
        damper, for which the orbit is unique and one step is exact.

    Returns
    -------
    ndarray
        Unknowns.
    """
    needs_guess = not flow_of_scene(problem.scene).has_unique_free_response()
    z = np.array([*(guess_state if needs_guess and np.isfinite(guess_state).all() else (0.0, 0.0)), *parameters])
    for _ in range(NEWTON_STEPS if needs_guess else 1):
        residual, jacobian = problem.evaluate(z)
        # Under a force the matrix may be singular, at a fold or branch point; no step is taken along the null vector.
        state_jacobian = jacobian[:, :2]
        newton_step = (
            np.linalg.lstsq(state_jacobian, residual, SINGULAR_RATIO)[0]
            if needs_guess
            else np.linalg.solve(state_jacobian, residual)
        )
        z[:2] -= newton_step
        if abs(newton_step).max() <= augmented_systems.STEP_TOLERANCE * (1.0 + abs(z).max()):
            break
    return z

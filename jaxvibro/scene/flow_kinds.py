"""Define the kinds of flow between the walls: spring and damper, or a force by Taylor steps or by a solver.

All kinds have the same attributes and methods. `Scene.flow_kind` selects the kind of a scene.
"""

from importlib import import_module

import numpy as np

from . import check
from .force_operations import has_no_negative_damping, ops_without_series, proves_no_expansion
from .predefined_forces import force_name
from .user_function_checks import check_force_values, is_force_odd

DRIVE_TEXT = "amplitude cos(frequency t)"


class SpringFlow:
    """Flow of a spring and a damper.

    Attributes
    ----------
    parameters : tuple of str
        Names of the parameters of the scene that only this flow has, except for those of a force.
    is_linear : bool
        True for spring and damper.
    """

    parameters: tuple[str, ...] = ("damping",)
    is_linear = True

    def check_values(self, scene):
        """Accept every scene: the rules for single numbers suffice."""

    def description(self, scene):
        """Return a sentence that states how the flight is computed, and the reason."""
        return "exact: the flow of spring, damper and drive is known in closed form"

    def equation(self, scene):
        """Return the equation of motion with the first term of the drive, as text."""
        return f"x'' + 2 damping x' + x = {DRIVE_TEXT}"

    def never_expands(self, scenes):
        """Return True if areas provably do not grow in flight or in contact phases; see `areas_never_grow`."""
        return has_no_negative_damping(scenes)

    def is_odd(self, scene):
        """Return True if the force of a single scene is odd, except for the drive; see `is_force_odd`."""
        return True


class TaylorFlow:
    """Flow of a user-defined force that is integrated by Taylor steps; attributes as in `SpringFlow`."""

    parameters: tuple[str, ...] = ()
    is_linear = False

    def check_values(self, scene):
        """Check that the force is finite, periodic, and not too stiff."""
        check_force_values(scene, is_explicit=True)

    def description(self, scene):
        """Return a sentence that states the integration method, and the reason."""
        return f"Taylor steps to {scene.force.tolerance:g}: each operation of the force has a Taylor series"

    def equation(self, scene):
        """Return the equation of motion with the first term of the drive, as text."""
        return f"x'' = {force_name(scene.force.function)}(t, x, v) + {DRIVE_TEXT}"

    def never_expands(self, scenes):
        """Return True if interval arithmetic proves that areas do not grow; there is no proof for soft walls."""
        return not scenes[0].soft_sides and proves_no_expansion(scenes)

    def is_odd(self, scene):
        """Return True if the force of a single scene is odd."""
        return is_force_odd(scene)


class SolverFlow(TaylorFlow):
    """Flow of a user-defined force that a solver of diffrax integrates; attributes as in `SpringFlow`."""

    def check_values(self, scene):
        """Check the force as for Taylor steps, and that no wall is soft. Implicit solvers accept a stiff force."""
        if scene.soft_sides:
            ops_text = ", ".join(_ops_without_series(scene))
            reason = f", which do not exist for {ops_text}" if ops_text else ""
            rule = f"must be None with a soft wall, where a force needs Taylor steps{reason}"
            raise check.ArgumentError("force.solver", rule, scene.force.solver)
        implicit_solver = import_module("diffrax").AbstractImplicitSolver
        check_force_values(scene, is_explicit=not isinstance(scene.force.solver, implicit_solver))

    def description(self, scene):
        """Return a sentence that states the integration method, and the reason."""
        ops_text = ", ".join(_ops_without_series(scene))
        reason = f"no Taylor series is known for {ops_text}" if ops_text else "selected by the user"
        return f"steps of diffrax's {type(scene.force.solver).__name__} to {scene.force.tolerance:g}: {reason}"


def _ops_without_series(scene):
    """Return the names of the operations of the force of a scene that have no Taylor series."""
    return ops_without_series(scene.force.function, tuple(scene.force.numbers), np.dtype(scene.dtype))


SPRING, TAYLOR, SOLVER = SpringFlow(), TaylorFlow(), SolverFlow()

"""Numbers of a scene that may change: a unit for each, in which a change counts, and how far they may go."""

from collections.abc import Mapping

import numpy as np

from ..scene import check
from ..scene.parameters import parameter_domain
from ..scene.unit_mistakes import unit_hint, value_text


def check_units(scene, free):
    """{name: unit} of free numbers of a scene, as given. Raises ArgumentError."""
    if not isinstance(free, Mapping) or not free:
        raise check.ArgumentError("free", "must be {name: unit}, one number at least", free)
    for name, unit in free.items():
        check.require_parameter(name, scene.names, name)
        number = check.finite_array(f"free.{name}", unit, np.float64)
        if number.ndim or number <= 0:
            raise check.ArgumentError(f"free.{name}", "must be a unit, a positive number", unit)
    if len(free) > 1:
        check.require_independent(*free)
    return {name: float(unit) for name, unit in free.items()}


def allowed_changes(scene, units, bounds):
    """(low, high) of the change of each free number, in its units: to its bounds, (low, high) by name, within its
    domain. Raises ArgumentError."""
    change_bounds = []
    for name in bounds:
        if name not in units:
            raise check.ArgumentError(
                f"bounds.{name}", f"must be of a free number{check.describe_choices(name, units)}", name
            )
    for name, unit in units.items():
        value, domain_bounds = float(scene.parameter(name)), parameter_domain(scene, name)
        requested_bounds = bounds.get(name, domain_bounds)
        numeric_bounds = (
            np.asarray(requested_bounds, float) if np.shape(requested_bounds) == (2,) else np.full(2, np.nan)
        )
        if not numeric_bounds[0] <= value <= numeric_bounds[1]:
            rule = (
                "must be (low, high) about the scene's"
                f" {value_text(scene, name)}{unit_hint(scene, name, *numeric_bounds)}"
            )
            raise check.ArgumentError(f"bounds.{name}", rule, requested_bounds)
        change_bounds.append(
            [
                (max(requested_bounds[0], domain_bounds[0]) - value) / unit,
                (min(requested_bounds[1], domain_bounds[1]) - value) / unit,
            ]
        )
    lower, upper = np.array(change_bounds).T
    return lower, upper

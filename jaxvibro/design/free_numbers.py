"""Numbers of a scene that may change: a unit for each, in which a change counts, and how far they may go."""

from collections.abc import Mapping

import numpy as np

from ..scene import check
from ..scene.parameters import domain
from ..scene.unit_slips import hint, in_units


def units_of(scene, free):
    """{name: unit} of free numbers of a scene, as given. Raises ArgumentError."""
    if not isinstance(free, Mapping) or not free:
        raise check.ArgumentError("free", "must be {name: unit}, one number at least", free)
    for name, unit in free.items():
        check.require_known(name, scene.names, name)
        found = check.number(f"free.{name}", unit, np.float64)
        if found.ndim or found <= 0:
            raise check.ArgumentError(f"free.{name}", "must be a unit, a positive number", unit)
    if len(free) > 1:
        check.require_apart(*free)
    return {name: float(unit) for name, unit in free.items()}


def room_of(scene, units, bounds):
    """(low, high) of the change of each free number, in its units: to its bounds, (low, high) by name, within its
    domain. Raises ArgumentError."""
    ends = []
    for name in bounds:
        if name not in units:
            raise check.ArgumentError(f"bounds.{name}", f"must be of a free number{check.among(name, units)}", name)
    for name, unit in units.items():
        value, own = float(scene.parameter(name)), domain(scene, name)
        given = bounds.get(name, own)
        known = np.asarray(given, float) if np.shape(given) == (2,) else np.full(2, np.nan)
        if not known[0] <= value <= known[1]:
            rule = f"must be (low, high) about the scene's {in_units(scene, name)}{hint(scene, name, *known)}"
            raise check.ArgumentError(f"bounds.{name}", rule, given)
        ends.append([(max(given[0], own[0]) - value) / unit, (min(given[1], own[1]) - value) / unit])
    low, high = np.array(ends).T
    return low, high

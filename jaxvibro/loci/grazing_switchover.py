"""Continue loci through grazing switchovers, at which several walls are grazed at once.

Each contact has a locus of its own, with the contact as an impact with zero speed. This locus is valid on the side on
which the other contacts open. If all contacts persist for any change of the parameters, as for P100 between walls at
equal distances, one of them is continued. Otherwise each is valid on one side, the boundary has a corner, and its
derivatives are one-sided.
"""

import jax.numpy as jnp
import numpy as np

from ..problem.end import RESUMABLE_ENDS, End
from ..problem.equations import scene_at as at
from ..problem.orbit_point import OrbitPoint
from ..scene import check
from ..scene.scene import replace_unchecked
from .degenerate_grazing import locate_degenerate_end
from .extended_system import GrazingEquations
from .locus_start import LocusStart, locus_directions, reverse_direction
from .repartition_impacts import repartition_impacts
from .track import track_locus

MAX_PARTS = 64  # largest number of parts of a locus
SAME_GRAZING_TOLERANCE = 1e-6  # in periods: contacts closer than this coincide


def both_directions(start, names, bounds, *step_settings):
    """Return the two `LocusDirection` records of a locus from a `LocusStart`. Raises ArgumentError."""
    directions = locus_directions(start, names, bounds, *step_settings)
    if len(directions) == 1:
        return directions[0], reverse_direction(directions[0])
    open_directions = _open_directions(directions)
    for pair in open_directions:
        if len(pair) == 2:
            return tuple(pair)
    one_sided_directions = sorted(
        (pair[0] for pair in open_directions if pair), key=lambda direction: direction.start.tangent[-1]
    )
    if len(one_sided_directions) < 2:
        rule = "must be a grazing whose simultaneous contacts can be continued separately"
        raise check.ArgumentError("special", rule, len(directions))
    return one_sided_directions[-1], one_sided_directions[0]


def track_across_walls(start, direction, step_settings, segment=None):
    """Track a locus along a `LocusDirection` and across walls; return a list of (`LocusDirection`, segment).

    `segment` is the first segment if it is known, `step_settings` the arguments of `both_directions`.
    """
    parts, limits = [], None if direction is None else direction.settings.limits
    while direction is not None and len(parts) < MAX_PARTS:
        direction = direction.with_limits(limits)
        segment = segment or track_locus(direction)
        limits = limits.after(len(segment.points.z) - 1)
        if segment.end in RESUMABLE_ENDS or limits.reached(1):
            parts.append((direction, segment))
            break
        degenerate_segment = locate_degenerate_end(direction, segment)
        replacement = (
            (degenerate_segment, None)
            if degenerate_segment
            else repartition_impacts(start, direction, segment, step_settings)
        )
        final_segment, next_direction = replacement or (
            segment,
            _direction_beyond(start, direction, segment, step_settings),
        )
        parts.append((direction, final_segment))
        direction, segment = next_direction, None
    return parts


def _open_directions(directions):
    """Return, for each direction, those of its two senses in which the other contacts open or persist."""
    return [
        [sense for sense in (direction, reverse_direction(direction)) if sense.is_admissible]
        for direction in directions
    ]


def _direction_beyond(start, direction, segment, step_settings):
    """Return the `LocusDirection` beyond the point at which a motion without impacts touches another wall, or None."""
    problem, names = direction.problem, direction.settings.names
    if (
        segment.end is not End.GRAZE
        or not isinstance(problem, GrazingEquations)
        or len(problem.impact_rows)
        or float(problem.sequence.closure_sign) < 0
    ):
        return None
    z, no_impacts = segment.points.z[-1], np.zeros(0)
    values = zip(names, z[-2:], strict=True)
    scene = replace_unchecked(start.scene, {name: jnp.asarray(value, start.scene.dtype) for name, value in values})
    orbit_row = OrbitPoint(
        float(z[-2]),
        no_impacts,
        no_impacts,
        no_impacts,
        int(problem.sequence.periods),
        np.nan,
        np.nan,
        float(segment.points.residual[-1]),
    )
    open_directions = _open_directions(
        locus_directions(LocusStart("GR", names[0], scene, orbit_row), names, direction.settings.bounds, *step_settings)
    )
    candidates = (pair[0] for pair in open_directions if len(pair) == 1)
    return next(
        (
            candidate
            for candidate in candidates
            if not _is_same_grazing(candidate.problem, candidate.start.z, problem, z)
        ),
        None,
    )


def _is_same_grazing(problem, z, other_problem, other_z):
    """Check whether two motions without impacts have the same grazing contact."""
    period_shift = (z[0] - other_z[0]) * float(at(problem, z).frequency) / (2.0 * np.pi * int(problem.sequence.periods))
    return (
        problem.sequence.sides[0] == other_problem.sequence.sides[0]
        and abs(period_shift - np.round(period_shift)) < SAME_GRAZING_TOLERANCE
    )

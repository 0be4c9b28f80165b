"""Find the attractors of a scene from random initial states, with their basin fractions."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from continuation.branch_segment import EXPIRED_REASON, UNLIMITED, Results, make_limits, partial_result_reason

from ..maps.initial_conditions import draw_initial_states
from ..orbits.find import find_orbit
from ..orbits.orbit import Orbit, OrbitError
from ..orbits.orbit_from_impacts import move_section_to_phase_0
from ..scene import check
from ..scene.scales import Scales
from ..scene.scene import Scene
from ..scene.scene_properties import is_symmetric
from ..scene.state import State, Status
from . import classify_attractors
from .basin_fraction_bounds import compute_share_bounds
from .classify_attractors import AttractorCandidate, find_chaotic_attractors, find_periodic_attractors
from .transients import settle_lanes


@dataclass(frozen=True, eq=False)
class Attractor:
    """Attractor of a scene, or the set of unresolved initial states.

    Attributes
    ----------
    label : str
        P n p q for n drive periods with p impacts on the left wall and q on the right wall (``"P1-0-inf"`` with
        complete chatter on the right wall), ``"chaotic"`` or ``"unresolved"``.
    kind : {"periodic", "chaotic", "unresolved"}
        Kind of attractor. ``"unresolved"`` stands for all initial states with evidence for neither of the other kinds.
    share : float
        Fraction of the initial states that approach the attractor, 0 for an attractor that no initial state approached.
        All shares sum to 1.
    share_bounds : tuple of float
        Lower and upper bound of the share at 95 % confidence (Clopper and Pearson).
    starts : int
        Number of initial states.
    state : State
        State on the attractor at phase 0. For unresolved initial states, the first of them.
    periods : int
        Minimal number of drive periods of a periodic attractor, else 0.
    itinerary : tuple of str
        Sequence of walls hit, one word per period from `state` on; empty if the attractor is not periodic. In complete
        chatter the words contain the impacts up to the one after which the chatter is certain to be complete.
    points : ndarray
        Positions and velocities on the section from `state` on: all points of a periodic attractor, or a sample of a
        chaotic one. Array of shape (points, 2).
    least_speed : float
        Smallest impact speed; inf without impacts.
    exponent : float
        Largest Lyapunov exponent per drive period, from the multipliers if `orbit` is known; -inf if the exponent is
        too low to be measured, nan if it is unknown.
    mirror_of : int or None
        Index of the mirror image in the result of `find_attractors`; the attractor's own index if it is symmetric. None
        if no image was found or the scene has no mirror symmetry.
    note : str
        Evidence for the classification.
    orbit : Orbit or None
        Refined orbit of a periodic attractor with its multipliers, starting at phase 0 near `state`. None if the
        attractor is not periodic or the refinement fails.
    rests : bool
        True if the mass of a periodic attractor sticks to a wall for part of its period.
    scales : Scales or None
        Scales of the scene.
    """

    label: str
    kind: str
    share: float
    share_bounds: tuple[float, float]
    starts: int
    state: State
    periods: int
    itinerary: tuple[str, ...]
    points: Float[np.ndarray, "points 2"]
    least_speed: float
    exponent: float
    mirror_of: int | None
    note: str
    orbit: Orbit | None = None
    rests: bool = False
    scales: Scales | None = None


@check.host_only("use strobe")
def find_attractors(
    scene: Scene, starts: int = 200, seed: int = 0, settle: int = 300, *, max_seconds: float | None = None
) -> Results[Attractor]:
    """Find the attractors of a scene from random initial states.

    The initial states are simulated until they recur, or up to a multiple of `settle` periods. States that recur after
    at most 32 periods and attract nearby trajectories are on a periodic attractor. States that do not recur and have a
    largest Lyapunov exponent that is positive beyond doubt are chaotic, in a scene that loses energy. All other states
    are unresolved.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    starts : int, optional
        Number of initial states, at phase 0.
    seed : int, optional
        Seed of the random draw. The same seed gives the same initial states.
    settle : int, optional
        Drive periods before recurrence is tested.
    max_seconds : float, optional
        Wall-clock time, in s, after which the simulation ends. Initial states that have not settled by then are
        unresolved. None is no limit.

    Returns
    -------
    tuple of Attractor
        Attractors in order of decreasing share, the unresolved initial states last. The attribute ``stopped`` of the
        tuple states how many initial states are done if the time limit was reached; else it is ``""``.

    Raises
    ------
    ArgumentError
        If the scene has lanes or a count is invalid.

    See Also
    --------
    basins : Compute the basins of attraction on a grid.
    fractions : Compute basin fractions along a parameter.

    Notes
    -----
    Initial states are drawn uniformly from a box: x lies between the walls, and the speed is at most
    ``3 max(1, omega A / sqrt(D))`` with ``D = (1 - omega^2)^2 + 4 gamma^2 omega^2``. For several drive terms the speeds
    ``omega A / sqrt(D)`` of all terms are added. Under a `Force`, ``max(1, omega^2)`` replaces sqrt(D). On a side
    without a wall the box ends at the distance ``max(2, 2 a)`` from 0, or from the other wall if this bound is farther,
    where a is the sum of ``A / sqrt(D)`` over the drive terms. The shares refer to this box. Chaotic states that fill
    the same set are one attractor.

    The free response is included if it is stable and does not reach the walls. In a symmetric scene the mirror images
    of all attractors are included. Both are included even if no initial state approached them.

    Examples
    --------
    >>> attractors = jv.find_attractors(scene, starts=50)
    >>> [(attractor.label, round(attractor.share, 2)) for attractor in attractors]
    [('P111', 0.98), ('P100', 0.02)]
    """
    computation_limits = make_limits(None, max_seconds, None, check.ArgumentError)
    check.require_single_scene(scene)
    starts, settle = check.check_whole_number("starts", starts, 1), check.check_whole_number("settle", settle, 0)
    start_states = draw_initial_states(scene, starts, check.check_whole_number("seed", seed, 0))
    settled_starts = settle_starts(scene, start_states, settle, computation_limits)
    n_unfinished_starts = sum(reason == EXPIRED_REASON for reason in settled_starts.failure_reasons.values())
    stop_reason = partial_result_reason(starts - n_unfinished_starts, starts, "starts") if n_unfinished_starts else ""
    return Results(
        make_attractors(scene, settled_starts.candidates, starts)
        + _make_unresolved_entry(start_states, settled_starts.failure_reasons, starts),
        stop_reason,
    )


class SettledStarts(NamedTuple):
    """Outcome of the transients of some initial states.

    Attributes
    ----------
    candidates : list of AttractorCandidate
        Attractors, the most frequent first. Their lanes are the indices of the initial states.
    failure_reasons : dict of int to str
        Reason why an initial state is on no attractor, by its index.
    scale : float
        Largest magnitude of x and v.
    status : ndarray
        Status of each initial state. Array of shape (starts,).
    """

    candidates: list[AttractorCandidate]
    failure_reasons: dict[int, str]
    scale: float | np.floating
    status: Int[np.ndarray, " starts"]


def settle_starts(scene, start_states, settle, computation_limits=UNLIMITED):
    """Find the attractors that initial states approach, and derive further attractors without initial states.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    start_states : State
        Initial states at phase 0. Leaves of shape (starts,).
    settle : int
        Drive periods before recurrence is tested.
    computation_limits : Limits, optional
        Time limit of the simulation of initial states.

    Returns
    -------
    SettledStarts
        Candidates, failures, scale and status.
    """
    iterates, recurrence_periods, max_state_magnitude = settle_lanes(scene, start_states, settle, computation_limits)
    periodic_candidates, orbit_failure_reasons = find_periodic_attractors(
        scene, iterates, recurrence_periods, settle, max_state_magnitude
    )
    nonrecurrent_lanes = np.flatnonzero((recurrence_periods == 0) & (iterates.status < Status.CAP))
    chaotic_candidates, chaos_failure_reasons = find_chaotic_attractors(
        scene, iterates, nonrecurrent_lanes, max_state_magnitude, computation_limits
    )
    status_failure_reasons = {
        int(lane): f"status {Status(iterates.status[lane]).word}"
        for lane in np.flatnonzero(iterates.status >= Status.CAP)
    }
    candidates = periodic_candidates + chaotic_candidates
    candidates += classify_attractors.derive_free_response(scene, candidates)
    candidates += classify_attractors.derive_mirror_images(scene, candidates, max_state_magnitude)
    candidates.sort(
        key=lambda candidate: (
            -len(candidate.lanes),
            candidate.attractor_fields["label"],
            *candidate.attractor_fields["points"][0],
        )
    )
    return SettledStarts(
        candidates,
        orbit_failure_reasons | chaos_failure_reasons | status_failure_reasons,
        max_state_magnitude,
        iterates.status,
    )


def make_attractors(scene, candidates, n_starts):
    """Convert candidates into attractors with shares and, in a symmetric scene, mirror images.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    candidates : list of AttractorCandidate
        Candidates of the scene.
    n_starts : int
        Number of initial states.

    Returns
    -------
    tuple of Attractor
        Attractors in the order of the candidates.
    """
    is_scene_symmetric = is_symmetric(scene)
    refined_orbits = [_refine_orbit(scene, candidate.attractor_fields) for candidate in candidates]
    return tuple(
        Attractor(
            **candidate.attractor_fields | _exponent_fields(candidate.attractor_fields, orbit),
            **_share_fields(len(candidate.lanes), n_starts),
            mirror_of=classify_attractors.find_mirror_index(candidate, candidates) if is_scene_symmetric else None,
            orbit=orbit,
            scales=scene.scales,
        )
        for candidate, orbit in zip(candidates, refined_orbits, strict=True)
    )


def _exponent_fields(attractor_fields, orbit):
    """Return the fields ``exponent`` and ``note``; the multipliers of a refined orbit give its exponent."""
    exponent = attractor_fields["exponent"]
    if orbit is not None and np.isfinite(orbit.multipliers).all():
        with np.errstate(divide="ignore"):
            exponent = float(np.log(abs(orbit.multipliers).max())) / orbit.periods
    return {"exponent": exponent, "note": f"{attractor_fields['note']}; exponent {exponent:.3g} per period"}


def _share_fields(n_settled, n_starts):
    """Return the fields ``share``, ``share_bounds`` and ``starts``."""
    return {
        "share": n_settled / n_starts,
        "share_bounds": compute_share_bounds(n_settled, n_starts),
        "starts": n_starts,
    }


def _refine_orbit(scene, attractor_fields):
    """Return the refined `Orbit` of a periodic attractor from phase 0 on; None if chaotic or not refinable."""
    if not attractor_fields["periods"]:
        return None
    try:
        orbit = find_orbit(scene, attractor_fields["state"], attractor_fields["periods"], settle=0)
    except OrbitError:
        return None
    if orbit.unknowns == "impacts":
        orbit = move_section_to_phase_0(orbit, attractor_fields["itinerary"])
    return replace(orbit, state=replace(orbit.state, contact=attractor_fields["state"].contact))


def _make_unresolved_entry(start_states, failure_reasons, n_starts):
    """Return a tuple with one entry for all unresolved initial states; empty if there are none."""
    if not failure_reasons:
        return ()
    first_unresolved_lane = min(failure_reasons)
    reason_counts = Counter(failure_reasons.values()).most_common()
    attractor = Attractor(
        label="unresolved",
        kind="unresolved",
        **_share_fields(len(failure_reasons), n_starts),
        state=State(
            float(start_states.x[first_unresolved_lane]), float(start_states.v[first_unresolved_lane]), 0.0, 0.0
        ),
        periods=0,
        itinerary=(),
        points=np.empty((0, 2)),
        least_speed=np.nan,
        exponent=np.nan,
        mirror_of=None,
        note="; ".join(f"{count} starts: {reason}" for reason, count in reason_counts),
    )
    return (attractor,)

"""Find the attractors of a scene from random initial states, with their basin fractions."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from continuation.limits import EXPIRED_REASON, UNLIMITED, Results, limits_of, partial_reason

from ..maps.initial_conditions import draw_initial_states, initial_box
from ..orbits.find import find_orbit
from ..orbits.orbit import Orbit, OrbitError
from ..orbits.orbit_from_impacts import read_from_phase_zero
from ..scene import check
from ..scene.codes import Status
from ..scene.scales import Scales
from ..scene.scene import Scene
from ..scene.state import State
from ..scene.symmetry import is_symmetric
from . import derived_candidates
from .classify import AttractorCandidate, find_chaotic, find_periodic
from .shares import share_bounds
from .transients import settle_lanes


@dataclass(frozen=True, eq=False)
class Attractor:
    """Attractor of a scene, or the set of unresolved initial states.

    Attributes
    ----------
    label : str
        P n p q (``P1-0-inf`` with complete chatter on the right wall), ``"chaotic"`` or ``"unresolved"``.
    kind : {"periodic", "chaotic", "unresolved"}
        Kind of attractor. ``"unresolved"`` stands for all initial states with evidence for neither of the other kinds.
    share : float
        Fraction of the initial states that approach the attractor. All shares sum to 1. It is 0 for an attractor that
        no initial state approached.
    share_bounds : tuple of float
        Lower and upper bound of the share at 95 % confidence (Clopper and Pearson).
    starts : int
        Number of initial states.
    state : State
        State on the attractor at phase 0. For the unresolved, the first of the initial states.
    periods : int
        Minimal number of drive periods of a periodic attractor, else 0.
    itinerary : tuple of str
        Sequence of walls hit, a word for each period from `state` on; empty if the attractor is not periodic. With
        complete chatter it has the impacts up to the point from which the chatter is certain to end.
    points : ndarray
        Positions and velocities on the section from `state` on. Array of shape (periods, 2); a sample of a chaotic
        attractor.
    least_speed : float
        Smallest impact speed; inf without impacts.
    exponent : float
        Largest Lyapunov exponent per drive period. From the multipliers for an orbit; -inf if it is too low to be
        measured, and nan if it is unknown.
    mirror_of : int or None
        Index of the mirror image in the tuple, its own index if the attractor is symmetric. None if no image was found
        or the scene has no mirror symmetry.
    note : str
        Evidence for the classification.
    orbit : Orbit or None
        Refined orbit of a periodic attractor with its multipliers, read from phase 0 with the same state and itinerary.
        None if there is none or none was found.
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

    The initial states are simulated until they recur or until the time limit of the transient. States that recur after
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
        Wall-clock time, in s, after which the simulation of initial states that have not settled ends. They are then
        unresolved. None is no limit.

    Returns
    -------
    tuple of Attractor
        Attractors in order of decreasing share, the unresolved initial states last. Its attribute ``stopped`` states
        how many initial states are done if the time limit was reached; else it is ``""``.

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
    Initial states are drawn uniformly: x between the walls, the speed at most ``3 max(1, omega A / sqrt(D))``. The
    shares refer to this box. Chaotic states that fill the same set are one attractor.

    The free response is included if it is stable and clears the walls, and so are the mirror images of all attractors,
    even if no initial state approached them.

    Examples
    --------
    >>> attractors = jv.find_attractors(scene, starts=50)
    >>> [(attractor.label, round(attractor.share, 2)) for attractor in attractors]
    [('P111', 0.98), ('P100', 0.02)]
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    check.require_single(scene)
    starts, settle = check.whole_number("starts", starts, 1), check.whole_number("settle", settle, 0)
    start_states = draw_initial_states(scene, starts, check.whole_number("seed", seed, 0))
    settled_starts = settle_starts(scene, start_states, settle, limits)
    n_expired = sum(reason == EXPIRED_REASON for reason in settled_starts.failures.values())
    stopped = partial_reason(starts - n_expired, starts, "starts") if n_expired else ""
    return Results(
        make_attractors(scene, settled_starts.candidates, starts)
        + _unresolved_attractor(start_states, settled_starts.failures, starts),
        stopped,
    )


class SettledStarts(NamedTuple):
    """Outcome of the transients of some initial states.

    Attributes
    ----------
    candidates : list of AttractorCandidate
        Attractors, the most frequent first. Their lanes are the indices of the initial states.
    failures : dict of int to str
        Reason why an initial state is on no attractor, by its index.
    scale : float
        Largest magnitude of x and v.
    status : ndarray
        Status of each initial state. Array of shape (starts,).
    """

    candidates: list[AttractorCandidate]
    failures: dict[int, str]
    scale: float | np.floating
    status: Int[np.ndarray, " starts"]


def settle_starts(scene, start_states, settle, limits=UNLIMITED):
    """Find the attractors that some initial states approach, and those that are known without simulation.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    start_states : State
        Initial states at phase 0. Leaves of shape (starts,).
    settle : int
        Drive periods before recurrence is tested.
    limits : Limits, optional
        Time limit of the simulation of initial states.

    Returns
    -------
    SettledStarts
        Candidates, failures, scale and status.
    """
    x_min, x_max, _ = initial_box(scene)
    iterates, periods, scale = settle_lanes(scene, start_states, settle, max(abs(x_min), abs(x_max)), limits)
    orbit_candidates, orbit_failures = find_periodic(scene, iterates, periods, settle, scale)
    nonrecurrent_lanes = np.flatnonzero((periods == 0) & (iterates.status < Status.CAP))
    chaotic_candidates, nonrecurrent_lanes = find_chaotic(scene, iterates, nonrecurrent_lanes, scale, limits)
    status_failures = {
        int(lane): f"status {Status(iterates.status[lane]).word}"
        for lane in np.flatnonzero(iterates.status >= Status.CAP)
    }
    candidates = orbit_candidates + chaotic_candidates
    candidates += derived_candidates.free_response(scene, candidates)
    candidates += derived_candidates.mirror_images(scene, candidates, scale)
    candidates.sort(
        key=lambda candidate: (-len(candidate.lanes), candidate.fields["label"], *candidate.fields["points"][0])
    )
    return SettledStarts(candidates, orbit_failures | nonrecurrent_lanes | status_failures, scale, iterates.status)


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
    symmetric = is_symmetric(scene)
    orbits = [_polish_orbit(scene, candidate.fields) for candidate in candidates]
    return tuple(
        Attractor(
            **candidate.fields | _exponent_fields(candidate.fields, orbit),
            **_share_fields(len(candidate.lanes), n_starts),
            mirror_of=derived_candidates.mirror_index(candidate, candidates) if symmetric else None,
            orbit=orbit,
            scales=scene.scales,
        )
        for candidate, orbit in zip(candidates, orbits, strict=True)
    )


def _exponent_fields(fields, orbit):
    """Return the fields ``exponent`` and ``note``: from the multipliers for an orbit, else as measured."""
    exponent = fields["exponent"]
    if orbit is not None and np.isfinite(orbit.multipliers).all():
        with np.errstate(divide="ignore"):
            exponent = float(np.log(abs(orbit.multipliers).max())) / orbit.periods
    return {"exponent": exponent, "note": f"{fields['note']}; exponent {exponent:.3g} per period"}


def _share_fields(n_settled, n_starts):
    """Return the fields ``share``, ``share_bounds`` and ``starts``."""
    return {"share": n_settled / n_starts, "share_bounds": share_bounds(n_settled, n_starts), "starts": n_starts}


def _polish_orbit(scene, fields):
    """Return the `Orbit` of a periodic attractor at the attractor's phase and period, or None."""
    if not fields["periods"]:
        return None
    try:
        orbit = find_orbit(scene, fields["state"], fields["periods"], settle=0)
    except OrbitError:
        return None
    if orbit.unknowns == "impacts":
        orbit = read_from_phase_zero(orbit, fields["itinerary"])
    return replace(orbit, state=replace(orbit.state, contact=fields["state"].contact))


def _unresolved_attractor(start_states, reasons, n_starts):
    """Return one entry for all lanes on no attractor, or an empty tuple without such lanes."""
    if not reasons:
        return ()
    first_lane = min(reasons)
    counts = Counter(reasons.values()).most_common()
    attractor = Attractor(
        label="unresolved",
        kind="unresolved",
        **_share_fields(len(reasons), n_starts),
        state=State(float(start_states.x[first_lane]), float(start_states.v[first_lane]), 0.0, 0.0),
        periods=0,
        itinerary=(),
        points=np.empty((0, 2)),
        least_speed=np.nan,
        exponent=np.nan,
        mirror_of=None,
        note="; ".join(f"{count} starts: {reason}" for reason, count in counts),
    )
    return (attractor,)

"""Derive attractors without initial states: the free response, and mirror images of known attractors."""

import numpy as np

from ..maps.phase_shift import shift_phase
from ..orbits.free_response import free_orbit
from ..orbits.orbit_comparison import is_same_orbit, is_same_set, mirror_points
from ..scene.codes import Status
from ..scene.state import State
from ..scene.symmetry import is_symmetric
from .classify import AttractorCandidate, chaotic_candidate, periodic_candidate, record_iterates, sample_motion

MIRROR_NOTE = "mirror image of another attractor; no start settled on it"


def free_response(scene, candidates):
    """Return a list with the free response as `AttractorCandidate`, or an empty list.

    It is included if it is stable, clears the walls and is not among the candidates.
    """
    if any(
        candidate.fields["periods"] == 1 and not candidate.impact_points.size and not candidate.fields["state"].contact
        for candidate in candidates
    ):
        return []
    orbit = free_orbit(scene)
    if orbit is None or not orbit.stable:
        return []
    exponent = float(np.log(abs(orbit.multipliers[0])))
    fields = {
        "label": orbit.label,
        "kind": "periodic",
        "state": State(orbit.state.x, orbit.state.v, 0.0, 0.0),
        "periods": 1,
        "itinerary": orbit.itinerary,
        "points": np.array([[orbit.state.x, orbit.state.v]], scene.dtype),
        "least_speed": np.inf,
        "exponent": exponent,
        "note": "the free response, known in closed form; no start settled on it",
    }
    return [AttractorCandidate([], np.empty((0, 4), scene.dtype), fields)]


def mirror_images(scene, candidates, scale):
    """Derive the mirror images that are missing among the candidates of a symmetric scene.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    candidates : list of AttractorCandidate
        Known attractors.
    scale : float
        Largest magnitude of x and v.

    Returns
    -------
    list of AttractorCandidate
        Missing mirror images; empty if the scene is not symmetric.
    """
    if not is_symmetric(scene):
        return []
    image_candidates = [
        _mirror_candidate(scene, candidate, candidates, scale)
        for candidate in candidates
        if mirror_index(candidate, candidates) is None
    ]
    return [candidate for candidate in image_candidates if candidate is not None]


def mirror_index(candidate, candidates):
    """Return the index of an attractor's mirror image.

    Parameters
    ----------
    candidate : AttractorCandidate
        Attractor.
    candidates : list of AttractorCandidate
        Known attractors.

    Returns
    -------
    int or None
        Index of the image; None if it is not among the candidates.
    """
    n_periods = candidate.fields["periods"]
    is_same = is_same_orbit if n_periods else is_same_set
    indices = (index for index, other in enumerate(candidates) if other.fields["periods"] == n_periods)
    return next(
        (
            index
            for index in indices
            if is_same(mirror_points(candidate.impact_points), candidates[index].impact_points)
        ),
        None,
    )


def _mirror_candidate(scene, candidate, candidates, scale):
    """Return the mirror image of an attractor, None if it is already among the candidates."""
    fields, original = candidate.fields, candidate.fields["state"]
    mirror_state = State(-original.x, -original.v, np.pi, -original.contact)
    mirror_state = State(
        *(
            np.full(1, value, scene.dtype)
            for value in (mirror_state.x, mirror_state.v, mirror_state.phase, mirror_state.contact)
        )
    )
    state, status = shift_phase(scene, mirror_state, 0.0)
    if status[0] >= Status.CAP:
        return None
    extra_fields = {"exponent": fields["exponent"], "note": MIRROR_NOTE}
    if fields["periods"]:
        return periodic_candidate(scene, record_iterates(scene, state), [], fields["periods"], scale, extra_fields)
    iterates = sample_motion(scene, state)
    image = chaotic_candidate(scene, iterates, scale, extra_fields)
    is_known = iterates.status[0] >= Status.CAP or any(
        is_same_set(image.impact_points, other.impact_points) for other in candidates
    )
    return None if is_known else image

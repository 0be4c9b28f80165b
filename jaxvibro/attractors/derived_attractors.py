"""Derive attractors without initial states: the free response, and mirror images of known attractors."""

import numpy as np

from ..maps.phase_shift import shift_phase
from ..orbits.free_response import free_orbit
from ..orbits.orbit_comparison import is_same_orbit, mirror_points, samples_fill_same_set
from ..scene.codes import Status
from ..scene.state import State
from ..scene.symmetry import is_symmetric
from .classify_attractors import (
    AttractorCandidate,
    iterate_with_all_impacts,
    make_chaotic_attractor,
    make_periodic_attractor,
    sample_motions,
)

MIRROR_NOTE = "mirror image of another attractor; no start settled on it"


def derive_free_response(scene, candidates):
    """Return a list with the free response as `AttractorCandidate`, or an empty list.

    The list contains the free response if this orbit is stable, does not reach the walls and is not among the
    candidates.
    """
    if any(
        candidate.attractor_fields["periods"] == 1
        and not candidate.impact_points.size
        and not candidate.attractor_fields["state"].contact
        for candidate in candidates
    ):
        return []
    free_response_orbit = free_orbit(scene)
    if free_response_orbit is None or not free_response_orbit.stable:
        return []
    exponent = float(np.log(abs(free_response_orbit.multipliers[0])))
    attractor_fields = {
        "label": free_response_orbit.label,
        "kind": "periodic",
        "state": State(free_response_orbit.state.x, free_response_orbit.state.v, 0.0, 0.0),
        "periods": 1,
        "itinerary": free_response_orbit.itinerary,
        "points": np.array([[free_response_orbit.state.x, free_response_orbit.state.v]], scene.dtype),
        "least_speed": np.inf,
        "exponent": exponent,
        "note": "the free response, known in closed form; no start settled on it",
    }
    return [AttractorCandidate([], np.empty((0, 4), scene.dtype), attractor_fields)]


def derive_mirror_images(scene, candidates, max_state_magnitude):
    """Derive the mirror images that are missing among the candidates of a symmetric scene.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    candidates : list of AttractorCandidate
        Known attractors.
    max_state_magnitude : float
        Largest magnitude of x and v.

    Returns
    -------
    list of AttractorCandidate
        Missing mirror images; empty if the scene is not symmetric.
    """
    if not is_symmetric(scene):
        return []
    image_candidates = [
        _derive_mirror_image(scene, candidate, candidates, max_state_magnitude)
        for candidate in candidates
        if find_mirror_index(candidate, candidates) is None
    ]
    return [candidate for candidate in image_candidates if candidate is not None]


def find_mirror_index(candidate, candidates):
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
    return find_attractor_index(
        candidates, candidate.attractor_fields["periods"], mirror_points(candidate.impact_points)
    )


def find_attractor_index(candidates, n_periods, impact_points):
    """Return the index of the attractor with a motion.

    Parameters
    ----------
    candidates : list of AttractorCandidate
        Known attractors.
    n_periods : int
        Drive periods of the motion; 0 for a chaotic motion.
    impact_points : ndarray
        Impacts of the motion as points. Array of shape (impacts, 4).

    Returns
    -------
    int or None
        Index of the attractor; None if it is not among the candidates.
    """
    is_same_motion = is_same_orbit if n_periods else samples_fill_same_set
    return next(
        (
            index
            for index, candidate in enumerate(candidates)
            if candidate.attractor_fields["periods"] == n_periods
            and is_same_motion(impact_points, candidate.impact_points)
        ),
        None,
    )


def _derive_mirror_image(scene, candidate, candidates, max_state_magnitude):
    """Return the mirror image of an attractor; None if its simulation fails, or a chaotic image is known already."""
    attractor_fields, original_state = candidate.attractor_fields, candidate.attractor_fields["state"]
    mirror_state = State(-original_state.x, -original_state.v, np.pi, -original_state.contact)
    mirror_state = State(
        *(
            np.full(1, value, scene.dtype)
            for value in (mirror_state.x, mirror_state.v, mirror_state.phase, mirror_state.contact)
        )
    )
    state, status = shift_phase(scene, mirror_state, 0.0)
    if status[0] >= Status.CAP:
        return None
    extra_fields = {"exponent": attractor_fields["exponent"], "note": MIRROR_NOTE}
    if attractor_fields["periods"]:
        return make_periodic_attractor(
            scene,
            iterate_with_all_impacts(scene, state),
            [],
            attractor_fields["periods"],
            max_state_magnitude,
            extra_fields,
        )
    image_iterates = sample_motions(scene, state)
    image_candidate = make_chaotic_attractor(scene, image_iterates, max_state_magnitude, extra_fields)
    is_known_or_invalid = image_iterates.status[0] >= Status.CAP or any(
        samples_fill_same_set(image_candidate.impact_points, other_candidate.impact_points)
        for other_candidate in candidates
    )
    return None if is_known_or_invalid else image_candidate

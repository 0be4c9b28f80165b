"""Attractors that need no start to find them: the free response, and the mirror images of those that are known."""

import numpy as np

from ..maps.phase_shift import shift_phase
from ..orbits.free_response import free_orbit
from ..orbits.orbit_comparison import is_same_orbit, is_same_set, mirrored
from ..scene.codes import Status
from ..scene.state import State
from ..scene.symmetry import is_symmetric
from .classify import Evidence, read_orbit, read_set, roam, watch

IMAGE = "mirror image of one that starts settled on; none settled on it"


def free(scene, seen):
    """[the free response as `Evidence`] where it attracts, keeps off the walls and is not among those seen; else []."""
    if any(one.numbers["periods"] == 1 and not one.hits.size and not one.numbers["state"].contact for one in seen):
        return []
    orbit = free_orbit(scene)
    if orbit is None or not orbit.stable:
        return []
    rate = float(np.log(abs(orbit.multipliers[0])))
    numbers = {
        "label": orbit.label,
        "kind": "periodic",
        "state": State(orbit.state.x, orbit.state.v, 0.0, 0.0),
        "periods": 1,
        "itinerary": orbit.itinerary,
        "points": np.array([[orbit.state.x, orbit.state.v]], scene.dtype),
        "least_speed": np.inf,
        "exponent": rate,
        "note": "the free response, known in closed form; no start settled on it",
    }
    return [Evidence([], np.empty((0, 4), scene.dtype), numbers)]


def images(scene, seen, scale):
    """The mirror images, as `Evidence`, of those attractors seen whose image is not among them, in a symmetric
    scene."""
    if not is_symmetric(scene):
        return []
    found = [_image(scene, one, seen, scale) for one in seen if image_place(one, seen) is None]
    return [one for one in found if one is not None]


def image_place(one, seen):
    """The place of an attractor's mirror image, None where it is not among those seen."""
    n = one.numbers["periods"]
    test = is_same_orbit if n else is_same_set
    alike = (k for k, other in enumerate(seen) if other.numbers["periods"] == n)
    return next((k for k in alike if test(mirrored(one.hits), seen[k].hits)), None)


def _image(scene, one, seen, scale):
    """The mirror image of an attractor, None where it turns out to be one that is among those seen."""
    numbers, given = one.numbers, one.numbers["state"]
    turned = State(-given.x, -given.v, np.pi, -given.contact)
    turned = State(*(np.full(1, each, scene.dtype) for each in (turned.x, turned.v, turned.phase, turned.contact)))
    state, status = shift_phase(scene, turned, 0.0)
    if status[0] >= Status.CAP:
        return None
    told = {"exponent": numbers["exponent"], "note": IMAGE}
    if numbers["periods"]:
        return read_orbit(scene, watch(scene, state), [], numbers["periods"], scale, told)
    roams = roam(scene, state)
    found = read_set(scene, roams, scale, told)
    known = roams.status[0] >= Status.CAP or any(is_same_set(found.hits, other.hits) for other in seen)
    return None if known else found

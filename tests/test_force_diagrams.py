"""Forces of one's own: special points in closed form, diagrams and manifolds against other routes."""

import numpy as np
import pytest

from .force_specials import ball_errors, bounced


@pytest.mark.parametrize(("seed", "place"), [(0, None), pytest.param(1, None, marks=pytest.mark.slow), (2, 1e-6)])
def test_a_bouncing_ball_begins_and_doubles_where_closed_forms_say(seed, place):
    """place: as near to 0 it is no length of the scene, and the table's swing is."""
    orbit, known = bounced(np.random.default_rng(seed), side=(-1, 1)[seed % 2], place=place)
    assert orbit.label == ("P110", "P101")[seed % 2] and orbit.stable
    errors = ball_errors(orbit, known)
    assert errors["SN"] < 1e-10 and errors["PD"] < 1e-10

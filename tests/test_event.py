"""What is certified of a progress towards a wall, against progresses of the worst kind that its remainder allows."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxvibro.flight.event_certificates import (
    ROOT_MARGIN,
    EventPolynomial,
    certificate_horizon,
    cubic_coefficient_bound,
    first_quadratic_root,
    halley_root_step,
    make_upper_cubic,
    newton_root_step,
    root_error_bound,
    safe_step,
    safe_step_ratio,
    safe_step_to_horizon,
    slope_lower_bound,
)
from jaxvibro.flight.fast_event import (
    BEYOND_EVENT,
    JUMP_FRACTION,
    _refine_root,
    _root_certainty_level,
    _root_guess,
)

LANES, FINE = 1_500, np.linspace(0.0, 1.0, 401)


@pytest.fixture(scope="module")
def drawn():
    """Polynomials of all shapes, of lanes that are clear of their wall at first."""
    rng = np.random.default_rng(3)
    terms = 10.0 ** rng.uniform(-3.0, 0.5, (7, LANES)) * rng.normal(size=(7, LANES))
    terms[0] = -(10.0 ** rng.uniform(-5.0, 0.0, LANES))
    terms[1, ::2] = abs(terms[1, ::2])
    return EventPolynomial(tuple(map(jnp.asarray, terms)), jnp.asarray(10.0 ** rng.uniform(-14.0, 0.5, LANES)))


def worst(progress, time):
    """Return the progress at times of each lane, (times, lanes), with the remainder at each of its bounds."""
    terms, remainder = np.asarray(progress.terms), np.asarray(progress.remainder_bound)
    value = sum(term * time**k for k, term in enumerate(terms))
    return [value + sign * remainder * time**power for sign in (-1.0, 1.0) for power in (6, 7)]


def test_no_step_without_contact_passes_the_wall(drawn):
    bound = make_upper_cubic(drawn, cubic_coefficient_bound(drawn))
    above = -bound.clearance + FINE[:, None] * (
        bound.slope + FINE[:, None] * (bound.curvature + bound.cubic * FINE[:, None])
    )
    assert all((true <= above + 1e-14).all() for true in worst(drawn, FINE[:, None] + 0.0 * bound.clearance))
    free = safe_step(bound)
    sure = safe_step_to_horizon(bound, certificate_horizon(bound, first_quadratic_root(*bound[:3])), free)
    assert (sure >= free).all() and np.mean(sure > 1.5 * free) > 0.1
    steps = [(free, 1.0), (sure, 1.0)]
    for far in (1.0, 0.3):
        numerator, denominator = safe_step_ratio(bound, jnp.full(LANES, far))
        steps.append((numerator / denominator, far))
    for step, far in steps:
        assert (step > 0).all() and (step <= far).all()
        assert max(true.max() for true in worst(drawn, FINE[:, None] * np.asarray(step))) < 1e-14


def first_is(progress, root, slack, sure):
    """Return whether the worst progresses are first zero within some slack of a root, in the lanes that are sure."""
    before, after = (root - slack)[sure], (root + slack)[sure]
    near = slack[sure] < (ROOT_MARGIN - 1.0) * root[sure]  # as far the progress is known to rise
    some = EventPolynomial(tuple(np.asarray(term)[sure] for term in progress.terms), progress.remainder_bound[sure])
    ahead = worst(some, FINE[:, None] * np.maximum(before, 0.0))
    beyond = worst(some, np.minimum(after, 1.0)[None])
    return all((each < 1e-14).all() for each in ahead) and all((each[0, near] > -1e-14).all() for each in beyond)


def test_a_certain_root_is_the_first_within_its_bound(drawn):
    bound = make_upper_cubic(drawn, cubic_coefficient_bound(drawn))
    guess = first_quadratic_root(*bound[:3])
    root = newton_root_step(drawn, halley_root_step(drawn, guess))
    slack = np.asarray(root_error_bound(drawn, guess, root))
    sure = slack >= 0
    assert 0.1 < sure.mean() < 0.9 and np.mean(slack[sure] < 1e-3) > 0.5
    assert first_is(drawn, np.asarray(root), slack, sure)
    guess = _root_guess(drawn)  # of the fast path
    root = _refine_root(drawn, guess)
    known, root = np.asarray(_root_certainty_level(drawn, guess, root)), np.asarray(root)
    assert np.mean(known == 2) > 0.05 and np.mean(known == 1) > 0.01
    assert first_is(drawn, root, (1.0 - JUMP_FRACTION) * root, known > 0)
    assert first_is(drawn, root, BEYOND_EVENT + 0.0 * root, known == 2)


def test_the_lower_bound_of_the_slope_holds(drawn):
    far = np.random.default_rng(4).uniform(0.0, 1.0, LANES)
    least, time = np.asarray(slope_lower_bound(drawn, far)), FINE[:, None] * far
    for sign in (-1.0, 1.0):
        more = sign * 7.0 * np.asarray(drawn.remainder_bound) * time**6
        slope = sum(k * np.asarray(term) * time ** (k - 1) for k, term in enumerate(drawn.terms) if k) + more
        assert (slope >= least - 1e-14).all()

"""What is certified of a progress towards a wall, against progresses of the worst kind that its remainder allows."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxvibro.flight import event_certificates, fast_event

LANES, FINE = 1_500, np.linspace(0.0, 1.0, 401)


@pytest.fixture(scope="module")
def drawn():
    """Of lanes that are clear of their wall at first, of all shapes: an `event.Progress`."""
    rng = np.random.default_rng(3)
    sizes = 10.0 ** rng.uniform(-3.0, 0.5, (event_certificates.N_TERMS, LANES))
    terms = sizes * rng.normal(size=(event_certificates.N_TERMS, LANES))
    terms[0] = -(10.0 ** rng.uniform(-5.0, 0.0, LANES))
    terms[1, ::2] = abs(terms[1, ::2])
    remainder = 10.0 ** rng.uniform(-14.0, 0.5, LANES)
    return event_certificates.EventPolynomial(tuple(map(jnp.asarray, terms)), jnp.asarray(remainder))


def worst(progress, time):
    """The progress at times of each lane, (times, lanes), with the remainder at its bounds: an array each."""
    terms, remainder = np.asarray(progress.terms), np.asarray(progress.remainder_bound)
    value = sum(term * time**k for k, term in enumerate(terms))
    return [value + sign * remainder * time**power for sign in (-1.0, 1.0) for power in (6, 7)]


def test_no_step_without_contact_passes_the_wall(drawn):
    bound = event_certificates.make_upper_cubic(drawn, event_certificates.cubic_coefficient_bound(drawn))
    above = -bound.clearance + FINE[:, None] * (
        bound.slope + FINE[:, None] * (bound.curvature + bound.cubic * FINE[:, None])
    )
    free = event_certificates.safe_step(bound)
    sure = event_certificates.safe_step_to_horizon(
        bound, event_certificates.certificate_horizon(bound, event_certificates.first_quadratic_root(*bound[:3])), free
    )
    for true in worst(drawn, FINE[:, None] + 0.0 * bound.clearance):
        assert (true <= above + 1e-14).all()
    for step in (free, sure):
        assert (step > 0).all() and (step <= 1).all()
        for true in worst(drawn, FINE[:, None] * np.asarray(step)):
            assert true.max() < 1e-14
    assert (sure >= free).all() and np.mean(sure > 1.5 * free) > 0.1


def first_is(progress, root, slack, sure):
    """Whether progresses of the worst kind are first zero within so much of a root, in the lanes that are sure."""
    before, after = (root - slack)[sure], (root + slack)[sure]
    near = slack[sure] < (event_certificates.ROOT_MARGIN - 1.0) * root[sure]  # as far the progress is known to rise
    some = event_certificates.EventPolynomial(
        tuple(np.asarray(term)[sure] for term in progress.terms), progress.remainder_bound[sure]
    )
    ahead = worst(some, FINE[:, None] * np.maximum(before, 0.0))
    beyond = worst(some, np.minimum(after, 1.0)[None])
    return all((each < 1e-14).all() for each in ahead) and all((each[0, near] > -1e-14).all() for each in beyond)


def test_a_certain_root_is_the_first_within_its_bound(drawn):
    bound = event_certificates.make_upper_cubic(drawn, event_certificates.cubic_coefficient_bound(drawn))
    guess = event_certificates.first_quadratic_root(*bound[:3])
    root = event_certificates.newton_root_step(drawn, event_certificates.halley_root_step(drawn, guess))
    slack = np.asarray(event_certificates.root_error_bound(drawn, guess, root))
    sure = slack >= 0
    assert 0.1 < sure.mean() < 0.9
    assert first_is(drawn, np.asarray(root), slack, sure)
    assert np.mean(slack[sure] < 1e-3) > 0.5


def test_the_lower_bound_of_the_slope_holds(drawn):
    far = np.random.default_rng(4).uniform(0.0, 1.0, LANES)
    least, time = np.asarray(event_certificates.slope_lower_bound(drawn, far)), FINE[:, None] * far
    for sign in (-1.0, 1.0):
        more = sign * 7.0 * np.asarray(drawn.remainder_bound) * time**6
        slope = sum(k * np.asarray(term) * time ** (k - 1) for k, term in enumerate(drawn.terms) if k) + more
        assert (slope >= least - 1e-14).all()


def test_a_certain_root_of_the_fast_path_is_the_first(drawn):
    guess = fast_event._root_guess(drawn)
    root = fast_event._refine_root(drawn, guess)
    known, root = np.asarray(fast_event._root_certainty_level(drawn, guess, root)), np.asarray(root)
    assert np.mean(known == 2) > 0.05 and np.mean(known == 1) > 0.01
    for sure, slack in (
        (known > 0, (1.0 - fast_event.JUMP_FRACTION) * root),
        (known == 2, fast_event.BEYOND_EVENT + 0.0 * root),
    ):
        assert first_is(drawn, root, slack, sure)


def test_no_step_of_the_fast_path_without_contact_passes_the_wall(drawn):
    g = drawn.terms
    tail = fast_event._cubic_coefficient_bound(drawn, 1.0)
    for far in (1.0, 0.3):
        over, under = fast_event._safe_step_num_denom(-g[0], g[1], g[2], tail, jnp.full(LANES, far))
        step = np.asarray(over / under)
        assert (step > 0).all() and (step <= far).all()
        for true in worst(drawn, FINE[:, None] * step):
            assert true.max() < 1e-14

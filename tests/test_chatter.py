"""Hops that end in rest, and those that just do not: against closed forms and hops in 50 digits."""

import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mpf, workdps
from scipy.optimize import brentq

import jaxvibro as jv
from jaxvibro.flight.flight_coefficients import flow_coefficients, make_flow_coefficients
from jaxvibro.orbits import chatter, chatter_and_release
from jaxvibro.problem.orbit_conversion import orbit_point_of
from jaxvibro.problem.orbit_equations import are_releases
from tests.reference import rests
from tests.reference.special import exact
from tests.sticking_orbits import errors
from tests.truths import plain


def ratio(bounce):
    """q, the root of (1 + q)(3 q - 1)^2 = 8 R q in (1/3, 1)."""
    return brentq(lambda q: (1 + q) * (3 * q - 1) ** 2 - 8 * bounce * q, 1 / 3 + 1e-9, 1 - 1e-12, xtol=1e-15)


def released(scene, wall):
    """(the drive's cosine and sine where a still right wall lets go, how fast the press falls there)."""
    force, frequency = float(scene.amplitude), float(scene.frequency)
    phase = np.arccos(wall / force)
    return (jnp.cos(phase), jnp.sin(phase)), force * frequency * np.sin(phase)


@pytest.mark.parametrize("bounce", [0.3, 0.5, 0.9])
def test_critical_hops_near_the_release_shrink_in_proportion(bounce):
    scene = jv.make_scene(4.65, 2.1, 0.05, bounce, (-1.0, 0.7))
    release, fall = released(scene, 0.7)
    q, side = ratio(bounce), jnp.float64(1.0)
    near = [
        float(chatter.critical_speed(make_flow_coefficients(scene), side, release, jnp.float64(tau))) / tau**2
        for tau in (-1e-4, -2e-4)
    ]
    assert 2.0 * near[0] - near[1] == pytest.approx(0.375 * (1.0 - q * q) * fall, rel=1e-6)


@pytest.mark.parametrize("bounce", [0.3, 0.8])
def test_a_hop_at_the_critical_speed_is_followed_by_one(bounce):
    scene = jv.make_scene(3.0, 0.8, 0.2, bounce, (None, jv.Wall(0.4, motion=jv.Motion(0.1, 1.0))))
    built, side, phase = make_flow_coefficients(scene), jnp.float64(1.0), 2.0 * np.pi / 5.0
    times = np.linspace(0.0, 2.0 * np.pi / 0.8, 400)
    with workdps(20):
        push = [float(rests.press_alone(exact(plain(scene)), 1, mpf(time))) for time in times]
    last = next(k for k in range(1, 399) if push[k] > 0 and push[k + 1] <= 0)
    with workdps(30):
        phase = float(0.8 * rests.release(exact(plain(scene)), 1, mpf(times[last])))
    release, tau = (jnp.cos(phase), jnp.sin(phase)), jnp.float64(-0.2)
    speed = chatter.critical_speed(built, side, release, tau)
    angle = phase + 0.8 * tau
    found = chatter.evaluate_hop(built, side, (jnp.cos(angle), jnp.sin(angle)), speed)
    after = chatter.critical_speed(built, side, release, tau + found.time)
    assert bounce * float(found.landing_speed) == pytest.approx(float(after), rel=1e-11)


@pytest.mark.parametrize(("bounce", "speed"), [(0.0, 0.0), (0.3, 0.05), (0.6, 0.02), (0.6, 0.15), (0.9, 0.004)])
def test_hops_end_in_rest_when_those_of_50_digits_do(bounce, speed):
    scene = jv.make_scene(2.0, 0.9, 0.07, bounce, (None, jv.Wall(0.5, motion=jv.Motion(0.2, 0.4, 2))))
    given, phase = exact(plain(scene)), 0.25
    with workdps(50):
        now = mpf(phase) / given.omega
        end = rests.release(given, 1, mpf(1.2))
        before = speed / bounce if bounce else 1.0
        hits, began = rests.until_rest(given, 1, now, given.right.restitution * mpf(before), end)
        numbers = (np.float64(each) for each in (1.0, given.omega * end, now - end, before))
        rest, hold, _, times, speeds, _ = (
            np.asarray(each) for each in chatter_and_release._follow_bounces_compiled(scene, *numbers)
        )
        assert hold == np.inf
        assert float(rest) == pytest.approx(float(end - began), abs=1e-12) if began else rest < 0
        for hit, time, pace in zip(hits[:20], times, speeds, strict=False):
            assert float(hit.time - end) == pytest.approx(time, abs=1e-13)
            assert float(hit.speed) == pytest.approx(pace, abs=1e-13)


@pytest.mark.parametrize("early", [1e-6, 1e-3, 0.04])
def test_a_mass_pulled_off_its_wall_without_speed_sticks_again(early):
    scene = jv.make_scene(2.0, 0.9, 0.07, 0.0, (None, jv.Wall(0.5, motion=jv.Motion(0.2, 0.4, 2))))
    given = exact(plain(scene))
    with workdps(50):
        begin, end = (rests.release(given, 1, mpf(near)) for near in (-1.2, 1.2))
        tau = mpf(float(begin - early - end))
        hits, began = rests.until_rest(given, 1, end + tau, mpf(0), end)
        numbers = (np.float64(each) for each in (1.0, given.omega * end, tau, 1.0))
        rest, hold, plainly, times, speeds, lifts = (
            np.asarray(each) for each in chatter_and_release._follow_bounces_compiled(scene, *numbers)
        )
        assert lifts
        assert float(hold) == pytest.approx(-float(rests.press_alone(given, 1, end + tau)), rel=1e-7)
        assert float(plainly) == pytest.approx(
            1 - float(began - end - tau) / (0.4 * float(flow_coefficients(scene).max_step)), rel=1e-9
        )
        assert float(rest) == pytest.approx(float(end - began), abs=1e-12)
        assert float(times[0] - tau) == pytest.approx(float(hits[0].time - end - tau), rel=1e-8)
        assert float(speeds[0]) == pytest.approx(float(hits[0].speed), rel=1e-8)


@pytest.mark.parametrize(("speed", "is_plain"), [(0.1, True), (0.412, False)])
def test_a_first_bounce_beyond_its_series_is_marked(speed, is_plain):
    """At much damping it does not land by its polynomial, though in truth it does, and the mass comes to rest."""
    wall = jv.Wall(0.2869737, 0.17737789, motion=jv.Motion(0.13298062, 5.02168711, 2))
    scene = jv.make_scene(1.94542487, 0.34722585, 1.48387529, 0.5, (wall, None))
    given, tau = exact(plain(scene)), -0.64
    with workdps(50):
        end = rests.release(given, -1, mpf(31.6744))
        _, began = rests.until_rest(given, -1, end + tau, given.left.restitution * mpf(speed), end)
        numbers = (np.float64(each) for each in (-1.0, given.omega * end, tau, speed))
    rest, _, plainly, *_ = (np.asarray(each) for each in chatter_and_release._follow_bounces_compiled(scene, *numbers))
    assert (plainly > 0) == is_plain
    assert not is_plain or float(rest) == pytest.approx(float(end - began), abs=1e-12)


@pytest.mark.parametrize(
    ("scene", "label"),
    [
        ((1.5, 0.5, 0.05, 0.5, (None, 0.5)), "P1-0-inf"),
        ((1.5, 0.5, 0.05, 0.5, (-0.2, 0.5)), "P1-inf-inf"),
        ((1.5, 0.5, 0.1, 0.0, (None, 0.3)), "P102"),
    ],
)
def test_the_impacts_of_an_orbit_that_sticks_from_release_to_release(scene, label):
    scene = jv.make_scene(*scene)
    orbit = jv.find_orbit(scene, jv.State(0.0, 0.0))
    assert (orbit.label, orbit.rests) == (label, True)
    *worst, count, several = errors(scene, orbit)
    assert max(worst) < 1e-12
    frees = are_releases(orbit_point_of(orbit, 1.5).sides)
    assert several == frees.sum() >= 1
    assert count == (~frees).sum() >= several

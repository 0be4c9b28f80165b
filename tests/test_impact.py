"""What follows an impact that leaves next to no speed: rest, release, complete chatter; how a given start begins."""

from functools import partial

import mpmath
import numpy as np

import jaxvibro as jv
from jaxvibro.contact.kinds import make_flow_coefficients
from jaxvibro.flight.impact import contact_after_event, is_complete_chatter

from .lanes import one_by_one
from .properties.motions import Contact

LANES = 2_000


def built(far=None, wall=1.0):
    """The `Frame` of a scene without damping, its length 3."""
    return make_flow_coefficients(jv.make_scene(2.0, 2.1, 0.0, 0.7, (far, wall)))


def test_a_mass_sticks_if_its_bounce_is_below_rounding_or_by_the_contact_force():
    push = 10.0 ** np.random.default_rng(1).uniform(-3.0, 3.0, LANES)
    height = float(np.finfo(float).eps) * float(built().length_scale)  # of a hop: leaving^2 / (2 push)
    for share, kind in ((0.99, Contact.STUCK), (1.01, Contact.LANDED)):
        assert (contact_after_event(built(), np.sqrt(2.0 * push * share * height), push, 0.0 * push) == kind).all()
    none = np.zeros(5)
    found = contact_after_event(
        built(), none, np.array([1.0, -1.0, 0.0, 0.0, 0.0]), np.array([-1.0, 1.0, 1.0, 0.0, -1.0])
    )
    assert found.tolist() == [Contact.STUCK, Contact.LANDED, Contact.STUCK, Contact.STUCK, Contact.RELEASED]


def test_complete_chatter_is_certain_only_if_all_bounces_end_while_the_force_lasts():
    """Under a press that stays as it is all hops take 2 u / (push (1 - R)), u the speed of the first; the first is
    u^2 / (2 push) high; under one that gets weaker, even slowly, they take longer."""
    rng = np.random.default_rng(2)
    push, bounce, leaving = 10.0 ** rng.uniform(-1, 1, LANES), rng.uniform(0.05, 0.95, LANES), 1e-4
    hops, none = 2.0 * leaving / (push * (1.0 - bounce)), np.zeros(LANES)
    wide = built()

    def certain(frame, rush, time):
        return np.asarray(is_complete_chatter(frame, np.full(LANES, leaving), push, bounce, rush, time))

    assert certain(wide, none, 1e4 * hops).all() and not certain(wide, none, 0.99 * hops).any()
    assert not certain(wide, 1.01 * push / hops, 1e4 * hops).any()
    assert certain(wide, 1e-5 * push / hops, 1e4 * hops).all()
    assert not is_complete_chatter(wide, np.zeros(LANES), push, bounce, none, 1e4 * hops).any()
    assert not is_complete_chatter(wide, np.full(LANES, leaving), -push, bounce, none, 1e4 * hops).any()
    high = leaving**2 / (2.0 * push)
    assert not certain(built(-1.0, -1.0 + 0.99 * high.min()), none, 1e4 * hops).any()


def test_the_drives_period_has_a_low_part():
    frequency = np.random.default_rng(3).uniform(0.01, 50.0, 100)
    given = make_flow_coefficients(jv.make_scene(2.0, frequency, 0.05, 0.7, (-1.0, 1.0)))
    with mpmath.workdps(50):
        for k in range(100):
            true = 2 * mpmath.pi / mpmath.mpf(frequency[k])
            low = true - mpmath.mpf(float(given.period[k]))
            assert abs(low - mpmath.mpf(float(given.period_low_part[k]))) < 1e-30 * true


def test_a_mass_sticking_to_a_moving_wall_ignores_a_wall_out_of_reach():
    """It aims at the wall that holds it, be it the slower: a wall that is never reached changes nothing."""
    rng = np.random.default_rng(4)
    amplitude, phase = rng.uniform(0.2, 3.0, 200), rng.uniform(0.0, 2.0 * np.pi, 200)
    wall = jv.Wall(0.0, 0.0, motion=jv.Motion(0.3, 1.0))
    ends = []
    for far in (None, 9.0):
        scene = jv.make_scene(amplitude, 0.7, 0.1, 0.7, (wall, far))
        end, impacts = one_by_one(partial(jv.strobe, slots=0), scene, jv.State(1.0, -1.0, phase))
        ends.append((end.x, end.v, end.contact, impacts.count))
    for one, other in zip(*ends, strict=True):
        assert np.allclose(one, other, rtol=0, atol=1e-12)
    assert (ends[0][2] == -2).sum() > 20 and (ends[0][2] == 0).sum() > 20

"""The swept diagram: against closed forms and the strobe itself, in chunks and in lanes, and what it refuses."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.flight.wall_positions import adapt_to_moved_walls, wall_states
from jaxvibro.scene.check import ArgumentError
from jaxvibro.scene.codes import Status


def scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0), **more):
    return jv.make_scene(amplitude, frequency, damping, restitution, walls, **more)


def forced(amplitude, frequency, damping):
    """x and v at phase 0 of the steady motion that meets no wall."""
    d = (1 - frequency**2) ** 2 + (2 * damping * frequency) ** 2
    return amplitude * (1 - frequency**2) / d, amplitude * 2 * damping * frequency**2 / d


LEGS = np.stack([np.linspace(4.0, 1.0, 13), np.linspace(1.0, 4.0, 13)], axis=1)
STARTS = jv.State(x=np.array([0.9, 0.0]), v=np.array([-1.1, 0.0]))


@pytest.fixture(scope="module")
def legs():
    return jv.sweep(scene(), "amplitude", LEGS, STARTS, settle=300, keep=8)


def test_hysteresis_of_two_legs(legs):
    """Up from rest the mass meets no wall until it grazes at A = sqrt(D), (8); down it keeps hitting far below."""
    assert legs.x.dims == ("step", "lane", "period") and legs.x.shape == (13, 2, 8)
    assert legs.amplitude.dims == ("step", "lane") and (legs.amplitude.values == LEGS).all()
    assert (legs.status == 0).all()
    grazing = np.hypot(1 - 2.1**2, 2 * 0.05 * 2.1)
    x, v = forced(LEGS[:, 1], 2.1, 0.05)
    calm = LEGS[:, 1] + 2 * 0.25 < grazing  # a step of A sets the mass swinging about the new motion
    hits = LEGS[:, 1] > grazing
    assert calm.sum() == 8 and hits.sum() == 3
    off_x, off_v = (abs(part[:, 1].values - steady[:, None]) for part, steady in ((legs.x, x), (legs.v, v)))
    assert off_x[calm].max() < 1e-11 and off_v[calm].max() < 1e-11
    assert off_x[hits].min() > 0.1
    assert abs(legs.x[:, 0].values - forced(LEGS[:, 0], 2.1, 0.05)[0][:, None]).min() > 0.1


def test_chunks_equal_the_whole(legs):
    done = []
    parts = jv.sweep(scene(), "amplitude", LEGS, STARTS, settle=300, keep=8, chunk=5, progress=done.append)
    assert done == [5, 10, 13]
    assert parts.identical(legs)


def test_each_value_starts_where_the_last_one_ended():
    values, start = [2.0, 3.0, 2.5], jv.State(x=0.3, v=2.0)
    found = jv.sweep(scene(), "amplitude", values, start, settle=2, keep=3)
    state = start
    for k, value in enumerate(values):
        for period in range(5):
            state, _ = jv.strobe(scene(value), state)
            if period >= 2:
                x, v = found.x[k, period - 2], found.v[k, period - 2]
                assert abs(x - state.x) < 1e-12 and abs(v - state.v) < 1e-12
    assert found.x.dims == ("amplitude", "period")
    assert list(found.amplitude) == values and list(found.period) == [0, 1, 2]


def test_batches_and_what_is_written_down():
    """Lanes of the scene and of the state, on a parameter that is dotted; what has lanes becomes a coordinate."""
    many = scene(amplitude=np.array([0.5, 1.0, 3.0]), walls=(-3.0, jv.Wall(3.0, restitution=0.9)))
    found = jv.sweep(many, "right.restitution", [0.9, 0.1], jv.State(x=0.1, v=[0.0, 0.1, 0.2]), settle=200, keep=2)
    assert found.x.dims == ("right.restitution", "lane", "period") and found.x.shape == (2, 3, 2)
    assert list(found.amplitude) == [0.5, 1.0, 3.0] and found.amplitude.dims == ("lane",)
    assert (
        found.attrs["damping"] == 0.05 and found.attrs["left.position"] == -3.0 and found.attrs["walls"] == "left right"
    )
    assert found.attrs["swept"] == "right.restitution" and "right.restitution" not in found.attrs
    assert "left.restitution" not in found.attrs and found.attrs["restitution"] == 0.7
    assert found.x.attrs["units"] and found.v.attrs["units"] and found.attrs["phase"] == 0.0
    x, v = forced(np.array([0.5, 1.0, 3.0]), 2.1, 0.05)
    assert abs(found.x.values - x[:, None]).max() < 1e-10 and abs(found.v.values - v[:, None]).max() < 1e-10


def test_a_bad_lane_is_flagged_and_starts_anew_and_no_other_lane_sees_it():
    """1.0 bounces for ever between close walls: at most 1,000 impacts a period. At 0.5 it comes to rest."""
    narrow = scene(amplitude=0.0, damping=0.0, walls=(-0.01, 0.01))
    starts = jv.State(x=0.0, v=np.array([10.0, 0.02]))
    found = jv.sweep(narrow, "restitution", [1.0, 0.5, 1.0, 1.0], starts, settle=2, keep=3)
    assert found.status.values.tolist() == [[Status.CAP, 0], [0, 0], [0, 0], [0, 0]]
    assert np.isnan(found.x[0, 0]).all() and np.isfinite(found.x[1:]).all() and np.isfinite(found.x[:, 1]).all()
    calm = jv.sweep(
        narrow, "restitution", [1.0, 0.5, 1.0, 1.0], jv.State(0.0, np.array([0.01, 0.02])), settle=2, keep=3
    )
    assert (calm.x[:, 1].values == found.x[:, 1].values).all() and (calm.status == 0).all()
    fresh = jv.sweep(narrow, "restitution", [0.5, 1.0, 1.0], starts, settle=2, keep=3)
    assert (fresh.x[:, 0].values == found.x[1:, 0].values).all()


def test_a_wall_that_moves_over_the_mass_carries_it_along():
    """A mass at rest with no drive: the wall pushes it from -0.2 to 0.4, and it rests there, pressed on."""
    still = scene(amplitude=0.0, frequency=1.0, damping=0.5, restitution=0.0, walls=(-1.0, 1.0))
    values = np.array([-0.2, 0.2, 0.4, -0.5])
    found = jv.sweep(still, "left.position", values, jv.State(x=0.5, v=0.0), settle=20, keep=1)
    assert (found.status == 0).all()
    assert abs(found.x[:, 0] - [0.0, 0.2, 0.4, 0.0]).max() < 1e-12 and abs(found.v).max() < 1e-12


def test_fit_at_moving_walls():
    moving = scene(walls=(-1.0, jv.Wall(1.0, motion=jv.Motion(0.25, phase=0.5, harmonic=2))))
    (low, _), (high, pace) = wall_states(moving, 1.3)
    assert low == -1.0 and abs(high - (1.0 + 0.25 * np.cos(3.1))) < 1e-15
    assert abs(pace + 0.25 * 2 * 2.1 * np.sin(3.1)) < 1e-15
    given = jv.State(*(jnp.array(a) for a in ([2.0, 0.3, 0.2, 0.2, -1.0], [3.0, 3.0, 3.0, 3.0, 1.0])), 1.3)
    contact = jnp.array([0.0, 0.0, 2.0, 1.0, -1.0])
    kept = adapt_to_moved_walls(moving, jv.State(given.x, given.v, 1.3, contact))
    assert np.allclose(kept.x, [high, 0.3, high, high, -1.0], rtol=0, atol=0)
    assert np.allclose(kept.v, [3.0, 3.0, pace, 3.0, 1.0], rtol=0, atol=0)
    assert list(kept.contact) == [0.0, 0.0, 2.0, 0.0, -1.0]


@pytest.mark.parametrize(
    "name, values, key, rule",
    [
        ("amplitud", [1.0], "amplitud", "is not a parameter of this scene"),
        ("left.motion.phase", [1.0], "left.motion.phase", "is not a parameter of this scene"),
        ("amplitude", [1.0, np.nan], "amplitude", "must be finite; got nan at index"),
        ("amplitude", [np.inf], "amplitude", "must be finite"),
        ("amplitude", [], "amplitude", "at least one"),
        ("amplitude", 3.0, "amplitude", "must be a sequence of at least one value"),
        ("amplitude", ["1"], "values", "must be a real number or an array"),
        ("frequency", [1.0, 0.0], "frequency", "must be greater than 0; got 0.0 at index (1,)"),
        ("restitution", [0.5, 1.5], "restitution", "must lie between 0 and 1; got 1.5"),
        ("right.position", [0.5, -1.0], "right.position", "must lie to the right of left.position; got -1.0"),
        ("right.position", [0.1, 3.0], "state.x", "must lie between the walls at the first value; got 0.5"),
        ("amplitude", [[1.0, 2.0, 3.0]], "state.x", "must broadcast"),
    ],
)
def test_refused_before_any_work(name, values, key, rule):
    state = jv.State(x=np.array([0.5, 0.2]), v=0.0)
    with pytest.raises(ArgumentError) as told:
        jv.sweep(scene(), name, values, state, progress=pytest.fail)
    assert told.value.key == key and rule in str(told.value)


@pytest.mark.parametrize(
    "more, key",
    [({"settle": -1}, "settle"), ({"keep": 0}, "keep"), ({"chunk": 1.5}, "chunk"), ({"settle": True}, "settle")],
)
def test_counts_that_cannot_be(more, key):
    with pytest.raises(ArgumentError, match=f"^{key}: must be a whole number"):
        jv.sweep(scene(), "amplitude", [1.0], jv.State(0.0, 0.0), **more)


def test_a_start_that_is_no_number():
    with pytest.raises(ArgumentError, match=r"^state\.v: must be finite; got nan"):
        jv.sweep(scene(), "amplitude", [1.0], jv.State(0.0, np.nan))

"""States at given times: against exact motions, the strobe and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from tests.properties.motions import Contact


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.2, 1.0))


def test_a_long_way_in_one_stretch_is_as_many_strobes(scene):
    # damped much, so that an attractor is reached: 40 periods have far more impacts than one of 32
    far, start, times = scene.replace(damping=0.3, amplitude=4.0), jv.State(0.5, -1.1, 0.0), [40 * 2 * np.pi / 2.1]
    end, impacts = jv.strobe(far, start, 40)

    def state(amplitude):
        last, status = jv.sample(far.replace(amplitude=amplitude), start, times)
        return jnp.stack([last.x[0], last.v[0]]), status

    assert impacts.count > 64 and state(4.0)[1] == 0
    assert np.allclose(state(4.0)[0], [end.x, end.v], rtol=0, atol=1e-11)
    slope, _ = jax.jacrev(state, has_aux=True)(4.0)
    assert np.allclose(slope, (state(4.0 + 1e-6)[0] - state(4.0 - 1e-6)[0]) / 2e-6, rtol=1e-6, atol=1e-7)


def test_at_an_impact_it_is_the_state_after_it_and_its_one_sided_slope(scene):
    start = jv.State(1.0, 0.8)  # on the right wall and into it
    _, impacts = jv.strobe(scene, start)
    hits = np.asarray(impacts.time)[: int(impacts.count)]
    times = np.append(np.insert(hits, 0, 0.0), hits[-1] + 0.3)
    assert hits[0] == 0 and len(hits) > 1
    state, _ = jv.sample(scene, start, times)
    after = -0.7 * np.asarray(impacts.side * impacts.speed)[: len(hits)]
    assert np.allclose(state.v[1:-1], after, rtol=0, atol=1e-14)
    assert state.v[0] == state.v[1]

    def speeds(a, times):
        return jv.sample(scene.replace(amplitude=a), start, times)[0].v

    slopes = jax.jit(jax.jacfwd(speeds))
    assert np.allclose(slopes(2.0, times), slopes(2.0, times + 1e-9), rtol=1e-7, atol=1e-7)


def test_the_gradient_of_a_loss_at_the_time_of_an_impact_is_one_sided():
    # no force: x = 2 t up to the wall at 10 at t = 5, then x = 20 - 2 t
    force = jv.Force("polynomial", {"damping": 0.0})
    times = np.arange(0.0, 8.1, 0.5)

    def loss(z):
        scene = jv.make_scene(0.0, 1.0, restitution=1.0, walls=(None, z[2]), force=force)
        state, _ = jv.sample(scene, jv.State(z[0], z[1]), times)
        return jnp.sum((1 - state.x) ** 2 + (1 - state.v) ** 2) / 2

    z = jnp.array([0.0, 2.0, 10.0])
    after = times >= 5.0
    x, v = np.where(after, 20.0 - 2.0 * times, 2.0 * times), np.where(after, -2.0, 2.0)
    by_x, by_v = np.where(after, -1.0, 1.0), np.where(after, -times, times)  # of x; v changes with v alone
    true = [
        np.sum((x - 1) * by_x),
        np.sum((x - 1) * by_v + (v - 1) * np.where(after, -1.0, 1.0)),
        np.sum((x - 1)[after] * 2.0),
    ]
    assert np.allclose(true[:2], (-7.0, -108.0))
    for slopes in (jax.grad(loss), jax.jacfwd(loss)):
        assert np.allclose(jax.jit(slopes)(z), true, rtol=0, atol=1e-12)


def _soft(numbers, force):
    wall = jv.Wall(numbers[2], stiffness=numbers[3], damping=numbers[4])
    return jv.make_scene(numbers[0], numbers[1], None if force else 0.0, walls=(wall, None), force=force)


@pytest.mark.parametrize("force", [None, jv.Force("duffing", {"cubic": 0.0, "damping": 0.0})])
def test_at_the_ends_of_a_contact_phase_slopes_are_those_of_the_state_returned(force):
    """The damping jumps at the wall, and so do the slopes; the contact says on which side a state is."""
    numbers, start = jnp.array([0.3, 1.1, -1.0, 60.0, 1.5]), jnp.array([-0.5, -1.3, 0.4])

    def states(z, numbers, times):
        state, _ = jv.sample(_soft(numbers, force), jv.State(*z), times)
        return jnp.stack([state.x, state.v]), state.contact

    slopes, flown = jax.jit(jax.jacfwd(states, (0, 1), has_aux=True)), jax.jit(states)

    def inside(time):
        return flown(start, numbers, jnp.array([time, 1.5]))[1][0] == -Contact.WITHIN

    def edge(low, high):
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (low, middle) if inside(middle) == inside(high) else (middle, high)
        return high

    def at(time):
        found, contact = slopes(start, numbers, jnp.array([time, 1.5]))
        found = np.concatenate(found, -1)
        return found[:, 0], found[:, 1], contact[0]

    for low, high in ((0.3, 0.6), (0.6, 1.0)):  # the mass enters at .461 and leaves at .813
        time = edge(low, high)
        before, later, _ = at(time - 1e-8)
        after = at(time + 1e-8)[0]
        assert abs(after - before).max() > 1.0
        for steps in (-6, -1, 0, 1, 6):
            own, last, contact = at(time + steps * np.spacing(time))
            side = before if (contact == -Contact.WITHIN) == (low > 0.5) else after
            assert np.allclose(own, side, rtol=0, atol=2e-6)
            assert np.allclose(last, later, rtol=0, atol=1e-13)


def test_a_mass_at_rest_goes_with_its_wall_at_any_time():
    # the spring presses it on the left wall, where it sticks at once: x = x_b, v = v_b from then on
    times = jnp.array([1.0, 2.0, 50.0])

    def states(position, swing, phase, frequency, times):
        wall = jv.Wall(position, 0.0, motion=jv.Motion(swing, phase))
        state, _ = jv.sample(jv.make_scene(0.1, frequency, 0.1, 0.5, (wall, None)), jv.State(1.1, -1.0, -0.3), times)
        return state.x, state.contact

    given = 1.0, 0.05, 0.4, 0.5, times
    assert np.array_equal(states(*given)[1], [-2, -2, -2])
    found, _ = jax.jit(jax.jacfwd(states, (0, 1, 2, 3, 4), has_aux=True))(*given)
    angle = -0.3 + 0.5 * times + 0.4
    wave = -0.05 * np.sin(angle)
    for each, true in zip(found, (np.ones(3), np.cos(angle), wave, wave * times, np.diag(0.5 * wave)), strict=True):
        assert np.allclose(each, true, rtol=0, atol=1e-13)


def test_second_derivatives(scene):
    def x(z):
        return jv.sample(scene.replace(amplitude=z[0]), jv.State(0.9, z[1]), jnp.stack([z[2], 2.0 + z[2]]))[0].x

    z, step = jnp.array([2.0, -1.1, 0.7]), 1e-5
    second = jax.jit(jax.hessian(x))(z)
    slope = jax.jit(jax.jacfwd(x))
    apart = [(slope(z.at[k].add(step)) - slope(z.at[k].add(-step))) / (2 * step) for k in range(3)]
    assert np.allclose(second, np.stack(apart, -1), rtol=1e-7, atol=1e-7)


def test_no_times_and_no_walls():
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (None, None))
    assert jv.sample(scene, jv.State(np.zeros(3), 0.0), [])[0].x.shape == (3, 0)
    state, _ = jv.sample(scene, jv.State(0.3, 1.0), [0.0, 400.0])
    forced = complex(2.0 / (1 - 2.1**2 + 2j * 0.05 * 2.1)) * np.exp(2.1j * 400.0)
    assert state.x[0] == 0.3 and abs(state.x[1] - forced.real) < 1e-8


def test_statuses(scene):
    times = jnp.array([[0.5, 1.0], [1.0, 0.5], [-1.0, 2.0], [0.5, np.nan], [0.0, 1e8]])
    state, status = jax.jit(lambda times: jv.sample(scene, jv.State(0.3, 1.0), times))(times)
    assert np.array_equal(status, [0, 3, 3, 3, 2])
    assert np.array_equal(np.isfinite(state.x), np.arange(5)[:, None] == [0, 0])
    _, status = jv.sample(scene, jv.State(np.array([0.3, 7.0]), 1.0), [1.0])
    assert np.array_equal(status, [0, 3])

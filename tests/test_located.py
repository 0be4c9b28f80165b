"""Special points as functions of their scenes: values, derivatives, statuses, lanes."""

import jax
import jax.numpy as jnp
import pytest
from mpmath import diff, workdps

import jaxvibro as jv
from tests import located_proof
from tests.reference import closed

GAMMA, OMEGA, R = 0.05, 2.1, 0.7
OK, JUMPED, VIRTUAL, NONE = jv.SolutionStatus


@pytest.fixture(scope="module")
def branch():
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0))
    return jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))


@pytest.fixture(scope="module")
def uneven():
    """P112 between unlike walls, one of which moves."""
    right = jv.Wall(1.0, 0.6, motion=jv.Motion(0.1, 0.4, 2))
    scene = jv.make_scene(6.5, OMEGA, GAMMA, R, (jv.Wall(-1.5, 0.8), right))
    orbit = jv.find_orbit(scene, jv.State(0.85, 0.64))
    return jv.follow(orbit, "amplitude", (5.0, 8.0))


@pytest.mark.parametrize(
    "kind, wall",
    [
        pytest.param("SN", None, marks=pytest.mark.slow),
        pytest.param("SB", None, marks=pytest.mark.long),
        ("GR", "left"),
        ("GR", "right"),
    ],
)
def test_gradients_between_still_walls(branch, kind, wall):
    (point,) = branch.points(kind)
    errors = located_proof.gradient_errors(point, wall)
    assert len(errors) >= 4 and max(errors.values()) < 1e-12, errors


def test_gradients_between_unlike_walls_one_of_which_moves(uneven):
    point = uneven.points("PD")[0]
    errors = located_proof.gradient_errors(point)
    assert set(errors) >= {"right.motion.amplitude", "right.motion.phase", "left.restitution"}
    assert max(errors.values()) < 1e-12, errors


def test_the_fold_in_closed_form(branch):
    """A(SN) of P111, its gradient and its Hessian by frequency and damping, against differences of the closed form."""
    value = jv.located(branch.points("SN")[0])

    def mine(numbers):
        return value(branch.scene.replace(frequency=numbers[0], damping=numbers[1]))

    def true(frequency, damping):
        return closed.fold(damping, frequency, R, 1.0, symmetric=True).amplitude

    with workdps(40):
        at = OMEGA + 0.2, GAMMA + 0.1
        slopes = [float(diff(true, at, order)) for order in ((1, 0), (0, 1))]
        bends = [float(diff(true, at, order)) for order in ((2, 0), (1, 1), (0, 2))]
        here = float(true(*at))
    numbers = jnp.array(at)
    assert abs(mine(numbers) - here) < 1e-13
    assert jax.grad(mine)(numbers) == pytest.approx(slopes, rel=1e-12)
    found = jax.hessian(mine)(numbers)
    assert [found[0, 0], found[0, 1], found[1, 1]] == pytest.approx(bends, rel=1e-10)


def test_a_second_derivative_of_a_fold_of_many_impacts():
    """From six impacts on the sum of squares of the null vector was a product of matrices that did not compile."""
    scene = jv.make_scene(1.35349688252687, 0.5681284414825132, 0.2826473694985851, 0.49, (None, 0.7418688488025945))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.3, 0.1)), "restitution", (0.48, 0.495))
    (fold,) = (one for one in branch.points("SN") if one.label == "P106")
    value, at = jv.located(fold), float(scene.frequency)
    slope = jax.grad(lambda frequency: value(fold.scene.replace(frequency=frequency)))
    apart = 1e-5
    near, far = (slope(at + k * apart) - slope(at - k * apart) for k in (1, 2))
    assert abs(jax.grad(slope)(at) - (8 * near - far) / (12 * apart)) < 1e-8

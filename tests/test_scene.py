"""Scenes: refusals, batches, names, tracing, and the gap of moving walls."""

import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxvibro as jv
from tests.scene_files import refusal

GOOD = {"amplitude": 2.0, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}
MOVING = jv.Motion(0.5)


def good_scene(**changes):
    """Return the usual scene with other arguments."""
    return jv.make_scene(**{**GOOD, **changes})


def physical(**changes):
    """Return a scene from SI quantities with other arguments."""
    given = {"mass": 2.0, "damping": 3.0, "stiffness": 8.0, "force": 5.0, "frequency": 3.0, "restitution": 0.7}
    return jv.scene_from_physical(**{**given, "walls": (-0.75, 0.5), **changes})


def right(**changes):
    return {"walls": (-1.0, jv.Wall(**{"position": 1.0, **changes}))}


def two_moving(phase):
    return jv.Wall(-1.0, motion=jv.Motion(1.2)), jv.Wall(1.0, motion=jv.Motion(1.2, phase, 2))


def test_walls_with_restitutions_of_their_own_need_no_other():
    rigid, soft = jv.Wall(-1e-3, 0.65), jv.Wall(1.2e-3, stiffness=5e6)
    scene = jv.make_scene(2.0, 2.1, 0.05, walls=(rigid, soft))
    assert scene.parameter("left.restitution") == 0.65
    made = physical(restitution=None, walls=(rigid, soft), length=1.0)
    assert made.parameter("left.restitution") == 0.65


BAD = [
    ("amplitude", {"amplitude": None}, "must be a real number"),
    ("frequency", {"frequency": 0.0}, "must be greater than 0; got 0.0"),
    ("damping", {"damping": -1e-9}, "must not be negative; got -1e-09"),
    ("damping", {"damping": np.array([0.0, 0.1, -0.2])}, "must not be negative; got -0.2 at index (2,)"),
    ("damping", {"damping": np.array([[0.0, 0.1], [0.2, np.nan]])}, "must be finite; got nan at index (1, 1)"),
    ("damping", {"damping": np.zeros(3), "amplitude": np.zeros(2)}, "must broadcast with the shape (2,)"),
    ("restitution", {"restitution": 1.0000001}, "must lie between 0 and 1; got 1.0000001"),
    ("restitution", {"restitution": None}, "must be given, unless each rigid wall has its own; got None"),
    ("restitution", right(restitution=0.5) | {"restitution": None}, "must be given, unless each"),
    ("walls", {"walls": 1.0}, "must be a pair"),
    ("walls", {"walls": (-1.0, 0.0, 1.0)}, "must be a pair"),
    ("walls", {"walls": np.array([[-1.0, 1.0]])}, "must be a pair"),
    ("left", {"walls": (MOVING, 1.0)}, "must be a position, None or a Wall"),
    ("right.position", {"walls": (1.0, -1.0)}, "must lie to the right of left.position; got -1.0"),
    ("right.position", {"walls": (0.0, np.array([1.0, 2.0, -3.0]))}, "got -3.0 at index (2,)"),
    ("right.position", right(position=None), "must be a real number; got None"),
    ("right.motion", right(motion=0.5), "must be a Motion or None; got 0.5"),
    ("right.motion", right(motion=jv.Motion(2.0)), "the smallest gap must exceed 0; got 0.0"),
    ("right.motion", right(motion=jv.Motion(np.array([0.1, -2.5]))), "must not touch or cross in their motion"),
    ("left.motion", {"walls": (jv.Wall(-1.0, motion=jv.Motion(-2.5)), 1.0)}, "must not touch or cross in their motion"),
    ("right.motion", {"walls": two_moving(phase=3.0)}, "must not touch or cross in their motion"),
    ("right.motion.phase", right(motion=jv.Motion(0.1, phase="0")), "must be a real number; got '0'"),
    ("right.motion.harmonic", right(motion=jv.Motion(0.1, harmonic=0)), "must be a whole number from 1 to 1000; got 0"),
    ("right.motion.harmonic", right(motion=jv.Motion(0.1, harmonic=2.0)), "must be a whole number from 1 to 1000"),
    ("right.motion.harmonic", right(motion=jv.Motion(0.1, harmonic=True)), "must be a whole number from 1 to 1000"),
    ("right.motion.harmonic", right(motion=jv.Motion(0.1, harmonic=1 << 40_000)), "a whole number too long to show"),
    ("dtype", {"dtype": jnp.int32}, "must be None, float32 or float64"),
    ("dtype", {"dtype": "double trouble"}, "must be None, float32 or float64"),
]


@pytest.mark.parametrize(("key", "changes", "said"), BAD)
def test_bad_scene_is_one_clear_line(key, changes, said):
    line = refusal(good_scene, **changes)
    assert line.startswith(f"{key}: ") and said in line


def test_an_error_can_be_sent_to_another_process():
    error = jv.SceneError("damping", "must not be negative", -1.0)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_double_precision_is_asked_for():
    with jax.enable_x64(False):
        with pytest.raises(jv.SceneError, match="jax_enable_x64"):
            good_scene()
        single = good_scene(dtype=jnp.float32)
    assert {leaf.dtype for leaf in jax.tree.leaves(single)} == {np.dtype(np.float32)}
    assert {leaf.dtype for leaf in jax.tree.leaves(good_scene())} == {np.dtype(np.float64)}
    with pytest.raises(jv.SceneError, match=r"right\.position"):
        good_scene(walls=(1.0, 1.0 + 1e-9), dtype=jnp.float32)


@pytest.mark.parametrize("walls", [(-1.0, 1.0), (None, 1.0), (-1.0, None), (None, None)])
def test_walls_and_harmonics_are_structure_and_numbers_are_leaves(walls):
    scene = good_scene(walls=walls)
    assert len(jax.tree.leaves(scene)) == 4 + sum(wall is not None for wall in walls)
    assert list(scene.walls) == [side for side, wall in zip(("left", "right"), walls, strict=True) if wall is not None]
    third, fourth = (good_scene(**right(motion=jv.Motion(0.1, 0.2, k))) for k in (np.int64(3), 4))
    assert len(jax.tree.leaves(third)) == 8 and type(third.right.motion.harmonic) is int
    assert jax.tree.structure(third) != jax.tree.structure(fourth)


@pytest.mark.parametrize("kind", [list, tuple])
def test_a_list_is_no_batch_and_no_pair_of_walls(kind):
    """It is refused in place of a number, with the way to write what may have been meant."""
    two = kind((0.55, 0.8))
    calls = [(key, good_scene, {key: two}) for key in ("amplitude", "frequency", "damping", "restitution")]
    calls += [("left.position", good_scene, {"walls": (two, 1.0)})]
    for key in ("position", "restitution", "stiffness", "damping"):
        wall = jv.Wall(**{"position": 1.0} | ({"stiffness": 9.0} if key == "damping" else {}) | {key: two})
        calls += [(f"right.{key}", good_scene, {"walls": (-1.0, wall)})]
        calls += [(f"right.{key}", physical, {"walls": (-1.0, wall), "length": 1.0})]
    for key in ("amplitude", "phase"):
        walls = -1.0, jv.Wall(1.0, motion=jv.Motion(**{"amplitude": 0.1, key: two}))
        calls += [(f"right.motion.{key}", make, {"walls": walls}) for make in (physical, good_scene)]
    for key in ("mass", "damping", "stiffness", "force", "frequency", "restitution", "length"):
        calls += [(key, physical, {key: two})]
    for key, make, arguments in calls:
        line = refusal(make, **arguments)
        assert line.startswith(f"{key}: must be a number or an array, not a {kind.__name__}")
        assert "walls=(Wall(...), Wall(...))" in line and "np.array([...])" in line


def test_an_array_of_two_positions_is_the_pair_of_walls():
    for pair in (np.array([-1.0, 1.5]), jnp.array([-1.0, 1.5]), np.array([None, 1.5])):
        scene = good_scene(walls=pair)
        assert scene.shape == () and scene.right.position == 1.5 and (pair[0] is None or scene.left.position == -1.0)
    assert jax.grad(lambda pair: good_scene(walls=pair).right.position)(np.array([-1.0, 1.5]))[1] == 1.0
    assert physical(walls=np.array([-0.5, 0.5])).left.position == -1.0


def test_batches_broadcast():
    assert good_scene(amplitude=np.zeros((3, 1)), walls=(-1.0, np.ones(2))).shape == (3, 2)
    assert good_scene(amplitude=np.zeros((0,))).shape == (0,)


def test_a_wall_without_a_restitution_takes_that_of_the_scene():
    scene = good_scene(**right(motion=MOVING))
    own = scene.replace(**{"right.restitution": 0.5})
    assert [own.parameter(f"{side}.restitution") for side in ("left", "right")] == [0.7, 0.5]
    assert own.replace(**{"right.restitution": None}).parameter("right.restitution") == 0.7
    with pytest.raises(jv.SceneError, match=r"amplitud: is not a parameter of this scene, perhaps amplitude \(ampl"):
        scene.replace(amplitud=1.0)
    with pytest.raises(jv.ArgumentError, match=r"left\.motion\.phase: is not a parameter"):
        scene.parameter("left.motion.phase")
    with pytest.raises(jv.SceneError, match="restitution: must lie between 0 and 1; got 2"):
        scene.replace(restitution=2.0)


def test_tracing_checks_types_and_shapes_only():
    scene = good_scene()
    assert jax.jit(lambda damping: scene.replace(damping=damping))(-1.0).damping == -1.0
    assert jax.vmap(lambda x: scene.replace(**{"right.position": x}))(jnp.arange(3.0)).right.position.shape == (3,)
    assert jax.grad(lambda x: scene.replace(frequency=x).frequency ** 2)(2.0) == 4.0
    with pytest.raises(jv.SceneError, match="amplitude: must be a real number"):
        jax.jit(lambda x: scene.replace(amplitude=x))(1j)
    with pytest.raises(jv.SceneError, match="damping: must not be negative"):
        jax.jit(lambda x: scene.replace(amplitude=x, damping=-1.0))(1.0)
    with pytest.raises(jv.SceneError, match="damping: must broadcast"):
        jax.jit(lambda x: scene.replace(amplitude=x, damping=x[:2]))(jnp.zeros(3))
    assert jax.grad(lambda force: physical(force=force).amplitude)(5.0) == 1 / (8.0 * 0.5)


def is_accepted(low, high, mean):
    """Return whether walls with these motions (amplitude, phase, harmonic) and this mean gap make a scene."""
    walls = jv.Wall(0.0, motion=jv.Motion(*low)), jv.Wall(mean, motion=jv.Motion(*high))
    try:
        good_scene(walls=walls)
    except jv.SceneError as error:
        assert "must not touch or cross in their motion" in str(error)
        return False
    return True


sizes, phases, harmonics = st.floats(-2, 2), st.floats(-7, 7), st.integers(1, 9)


@given(low=st.tuples(sizes, phases, harmonics), high=st.tuples(sizes, phases, harmonics), mean=st.floats(1e-3, 4))
def test_walls_are_accepted_if_a_dense_search_finds_a_gap(low, high, mean):
    theta = np.linspace(0.0, 2 * np.pi, 40_001)
    gap = mean + high[0] * np.cos(high[2] * theta + high[1]) - low[0] * np.cos(low[2] * theta + low[1])
    # The dense search is this far above the least value at most: (step / 2)^2 max abs f'' / 2.
    unseen = (np.pi / 40_000) ** 2 * (abs(low[0]) * low[2] ** 2 + abs(high[0]) * high[2] ** 2) / 2 + 1e-14
    assert is_accepted(low, high, mean) == (gap.min() > 0) or 0 < gap.min() < unseen


def test_walls_that_move_together_or_touch_at_a_flat_minimum():
    assert good_scene(walls=two_moving(phase=0.0)).right.motion.harmonic == 2
    # f = 3 + 4 cos(x + pi) + cos 2x = 8 sin(x/2)^4 touches with order four.
    for more, opens in ((0.0, False), (-1e-9, False), (1e-9, True)):
        assert is_accepted((4.0, 0.0, 1), (1.0, 0.0, 2), 3.0 + more) == opens


def test_a_start_beyond_a_rigid_wall_is_refused():
    draw = np.random.default_rng(1)
    for _ in range(10):
        motion, phase = jv.Motion(draw.uniform(-0.4, 0.4), draw.uniform(0.0, 6.0), 2), draw.uniform(0.0, 9.0)
        scene = good_scene(frequency=draw.uniform(0.3, 5.0), walls=(None, jv.Wall(1.0, 0.5, motion=motion)))
        position = 1.0 + motion.amplitude * np.cos(2.0 * phase + motion.phase)
        for x, rule in ((position + draw.choice([1e-12, 0.1, 5.0]), "lie between the walls"), (np.nan, "be finite")):
            state = jv.State(float(x), draw.normal(), phase)
            for call in (jv.find_orbit, jv.simulate, jv.sections):
                assert refusal(call, scene, state).startswith(f"state.x: must {rule}")
            for call in (jv.sweep, jv.spectrum):
                assert refusal(call, scene, "amplitude", np.ones(3), state).startswith(f"state.x: must {rule}")

"""Values in Hz, mm or N where a scene with scales takes its own units; and other slips with physical quantities."""

import warnings

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.scene.unit_mistakes import physical_units, require_scene_units, unit_hint
from jaxvibro.studies.run import _qualified_change

GIVEN = {"mass": 0.5, "damping_ratio": 0.05, "stiffness": 3e4, "force": 30.0, "frequency_hz": 45.0, "restitution": 0.7}
STATE = jv.State(0.0, 0.0)


def rig(**changes):
    return jv.scene_from_physical(**{**GIVEN, "gap": 0.5e-3, **changes})


@pytest.fixture(scope="module")
def scene():
    return rig()


@pytest.fixture(scope="module")
def orbit(scene):
    return jv.find_orbit(scene.replace(amplitude=0.1), STATE, 1, settle=0)


HERTZ = [30.0, 45.0, 60.0]


@pytest.mark.parametrize(
    "study",
    [
        lambda scene: jv.sweep(scene, "frequency", HERTZ, STATE),
        lambda scene: jv.spectrum(scene, "frequency", HERTZ, STATE),
        lambda scene: jv.fractions(scene, "frequency", HERTZ),
        lambda scene: jv.map_parameters(scene, {"frequency": HERTZ}),
        lambda scene: jv.explore(scene, "frequency", (30.0, 60.0)),
        lambda scene: jv.diagrams(scene, "frequency", (30.0, 60.0), "damping", [0.05]),
        lambda scene: jv.diagrams(scene, "amplitude", (0.1, 3.0), "frequency", HERTZ),
    ],
)
def test_values_in_hertz_are_refused(scene, study):
    with pytest.raises(jv.ArgumentError, match=r"look like Hz; divide them by 38\.98") as error:
        study(scene)
    assert "frequency is 1.15" in str(error.value)


@pytest.mark.parametrize(
    "study",
    [
        lambda scene, orbit: jv.follow(orbit, "frequency", (30.0, 60.0)),
        lambda scene, orbit: jv.follow_all([orbit], "frequency", (30.0, 60.0)),
        lambda scene, orbit: jv.search(scene, "SN", {"frequency": 0.1}, {"frequency": (30.0, 60.0)}),
        lambda scene, orbit: jv.margin(orbit, {"frequency": 0.1}, {"frequency": (30.0, 60.0)}),
    ],
)
def test_bounds_in_hertz_are_refused_with_the_unit(scene, orbit, study):
    with pytest.raises(jv.ArgumentError, match=r"45 Hz \(are these in Hz\? divide them by 38\.98"):
        study(scene, orbit)


@pytest.mark.parametrize("seed", range(20))
def test_every_quantity_is_told_in_its_unit(seed):
    """Values about a quantity's physical value are refused wherever they are far from the scene's own; the scene's own
    values never are."""
    draw = np.random.default_rng(seed)
    mass, stiffness = 10.0 ** draw.uniform(-2, 2), 10.0 ** draw.uniform(3, 6)
    hertz = np.sqrt(stiffness / mass) / (2 * np.pi) * draw.uniform(0.5, 4.0)
    scene = rig(mass=mass, stiffness=stiffness, frequency_hz=hertz, force=10.0 ** draw.uniform(0, 2))
    for name in scene.names:
        value = float(scene.parameter(name))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            require_scene_units("values", scene, name, np.linspace(0.5, 1.5, 5) * value)
            require_scene_units("values", scene, name, np.array([value]))
        assert unit_hint(scene, name, *sorted((0.5 * value, 1.5 * value))) == ""
        for unit, size in physical_units(scene.scales, name):
            if size > 10 or size < 0.1:
                with pytest.raises(jv.ArgumentError, match="divide them by"):
                    require_scene_units("values", scene, name, np.linspace(0.8, 1.3, 5) * value * size)
                low, high = sorted((0.8 * value * size, 1.3 * value * size))
                assert "are these in" in unit_hint(scene, name, low, high), unit


def test_what_may_be_hertz_is_asked_about(scene):
    with pytest.warns(UserWarning, match=r"in which it is 1\.15.*are these in Hz\? Divide them by 38\.98"):
        require_scene_units("values", scene, "frequency", np.array([12.0, 15.0]))
    plain = jv.make_scene(0.5, 2.1, 0.05, 0.7, (-1.0, 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        require_scene_units("values", plain, "frequency", np.array(HERTZ))
        require_scene_units("values", scene, "frequency", np.array([0.5, 4.0]))


def test_a_force_in_time_makes_no_scenes():
    time = np.linspace(0.0, 1.0, 4096)
    with pytest.raises(
        jv.SceneError, match=r"force: must be the drive amplitude, not a force in time.*shape \(4096,\)"
    ):
        rig(force=30.0 * np.sin(9.0 * time))
    with pytest.warns(UserWarning, match="its 4096 values make a batch of 4096 scenes"):
        rig(force=30.0 * np.exp(-time))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert rig(force=np.linspace(10.0, 30.0, 50)).shape == (50,)
        assert rig(mass=np.array([0.5, 0.6])).shape == (2,)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"stiffness": 0.0}, r"stiffness: must be greater than 0: .*make_scene with a Force; got 0\.0"),
        ({"gap": 0.0}, "length: must be given if the gap, or the right wall's position, is 0"),
        ({"gap": (1e-3, 0.0)}, "length: must be given if the gap"),
        ({"gap": None, "walls": (-1e-3, 0.0)}, "length: must be given if the gap"),
        ({"gap": -1e-3}, "are the walls in the wrong order"),
    ],
)
def test_what_leaves_no_units_says_what_to_do(changes, told):
    with pytest.raises(jv.SceneError, match=told):
        rig(**changes)


def test_a_wall_at_zero_is_one_beside_a_length():
    scene = rig(gap=(1e-3, 0.0), length=1e-3)
    assert float(scene.right.position) == 0.0 and float(scene.left.position) == -1.0


def test_a_gap_is_no_parameter_yet(orbit):
    for call in (lambda: jv.follow(orbit, "gap", (0.5, 1.5)), lambda: orbit.scene.replace(gap=1.0)):
        with pytest.raises(jv.ArgumentError, match=r"vary left\.position or right\.position instead"):
            call()


def test_a_misspelt_change_is_told_the_nearest_name(tmp_path):
    assert _qualified_change("freqency=2") == "scene.freqency=2" and _qualified_change("swep.count=2") == "swep.count=2"
    jv.save_scene(jv.make_scene(0.5, 2.1, 0.05, 0.7, (-1.0, 1.0)), tmp_path / "one.toml")
    with pytest.raises(jv.SceneError, match=r"scene\.freqency: is not a key here, perhaps frequency"):
        jv.run(tmp_path / "one.toml", tmp_path / "out", ["freqency=2"])


def test_a_picture_says_which_one_draws_a_record(orbit):
    diagram = jv.Diagram("amplitude", (0.0, 1.0), orbit.scene, (), (), True, "", {})
    with pytest.raises(jv.ArgumentError, match=r"a Diagram is drawn by plot\.branch, one call for each"):
        plot.diagram(diagram)
    with pytest.raises(jv.ArgumentError, match=r"must be given a Branch \(an Orbit is drawn by plot\.orbit"):
        plot.branch(orbit)


def test_within_a_transformation_an_orbit_is_solved_for():
    plain = jv.make_scene(0.5, 2.1, 0.05, 0.7, (-1.0, 1.0))
    with pytest.raises(jv.ArgumentError, match="inside, use solve_orbits; located has"):
        jax.jit(lambda a: jv.find_orbit(plain.replace(amplitude=a), STATE))(0.5)

"""Scene files: strict reading, changes from the command line, and writing that loses nothing."""

import struct
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxvibro as jv
from jaxvibro.scene import scene_table
from jaxvibro.studies import scene_file
from tests.scene_files import check_refusal, each_of

FIG4 = Path(__file__).parents[1] / "scenes" / "fig4.toml"
KEYS_OF_SCENE = "(amplitude, frequency, damping, restitution, left, right, force, drive, scales)"


def test_fig4_says_what_the_figure_shows():
    file = scene_file.read_scene_file(FIG4)
    scene = jv.load_scene(FIG4)
    assert [float(scene.parameter(name)) for name in ("frequency", "damping", "restitution")] == [2.1, 0.05, 0.7]
    assert (scene.left.position, scene.right.position, scene.left.restitution) == (-1.0, 1.0, None)
    sweep = file.sweep
    assert (sweep.parameter, sweep.count, sweep.settle, sweep.keep) == ("amplitude", 1201, 300, 100)
    assert [(leg.name, leg.first, leg.last, leg.start.x, leg.start.v) for leg in sweep.legs] == [
        ("down", 6.0, 0.0, 0.9, -1.1),
        ("up", 0.0, 6.0, 0.0, 0.0),
    ]
    values = sweep.values(sweep.legs[0])
    assert (values[0], values[-1], len(values)) == (6.0, 0.0, 1201)
    assert (file.attractors.starts, file.attractors.seed, file.attractors.at) == (200, 0, {"amplitude": 4.65})


def test_reading_needs_no_double_precision_until_the_scene_is_made():
    with jax.enable_x64(False):
        assert scene_file.read_scene_file(FIG4).scene.amplitude == 4.65
        assert jv.load_scene(FIG4, dtype=jnp.float32).dtype == jnp.float32
        with pytest.raises(jv.SceneError, match="jax_enable_x64"):
            jv.load_scene(FIG4)


# The change to scenes/fig4.toml, the key that the error names, and what it says.
BAD = [
    ("scene.amplitud = 3", "scene.amplitud", f"is not a key here, perhaps amplitude {KEYS_OF_SCENE}; got 3"),
    (
        "scen = 3",
        "scen",
        "is not a key here, perhaps scene (scene, sweep, attractors, orbits, branch, explore, locus, margin, fit, "
        "map, spectrum, basins, panels, view); got 3",
    ),
    (
        "scene.left.stifness = 3",
        "scene.left.stifness",
        "is not a key here, perhaps stiffness (position, restitution, stiffness, damping, motion, law)",
    ),
    ("scene.left.stiffness = -3", "scene.left.stiffness", "must be greater than 0; got -3"),
    ("scene.left.damping = 3", "scene.left.damping", "must not be given for a wall without stiffness; got 3"),
    ("scene.left.motion = {amplitude=0, size=1}", "scene.left.motion.size", "is not a key here"),
    ("sweep.steps = 3", "sweep.steps", "is not a key here (parameter, count, settle, keep, legs, max_seconds)"),
    ("sweep.legs.1.start.y = 3", "sweep.legs[1].start.y", "is not a key here (x, v)"),
    ("attractors.start = 3", "attractors.start", "is not a key here, perhaps starts (starts, seed, at, max_seconds)"),
    ("'a\tb`x - at `$.c`' = 1", "a\tb`x - at `$.c`", "is not a key here"),
    ("'a` - at `$.c' = 1", "a` - at `$.c", "is not a key here"),
    ("scene = 3", "scene", "must be a table; got 3"),
    ("scene.left = -1.0", "scene.left", "must be a table; got -1.0"),
    ("sweep.legs = [{name='a', from=1, to=2}]", "sweep.legs[0].start", "must be given"),
    ("scene.left.motion = {phase=0.1}", "scene.left.motion.amplitude", "must be given"),
    ("scene.amplitude = '4.65'", "scene.amplitude", "must be a number; got '4.65'"),
    ("scene.amplitude = true", "scene.amplitude", "must be a number; got True"),
    ("scene.amplitude = [1.0, 2.0]", "scene.amplitude", "must be a number; got [1.0, 2.0]"),
    ("scene.amplitude = 2007-01-01", "scene.amplitude", "must be a number"),
    ("scene.amplitude = nan", "scene.amplitude", "must be finite; got nan"),
    (f"scene.amplitude = 1{400 * '0'}", "scene.amplitude", "Number out of range"),
    (f"scene.amplitude = 0x1{9000 * '0'}", "scene.amplitude", "a whole number too long to show"),
    ("scene.frequency = 0", "scene.frequency", "must be greater than 0; got 0.0"),
    ("scene.frequency = -inf", "scene.frequency", "must be finite; got -inf"),
    ("scene.damping = -0.05", "scene.damping", "must not be negative; got -0.05"),
    ("scene.restitution = 1.7", "scene.restitution", "must lie between 0 and 1; got 1.7"),
    ("scene.right.restitution = -0.7", "scene.right.restitution", "must lie between 0 and 1; got -0.7"),
    ("scene.right.restitution = 'hard'", "scene.right.restitution", "must be a number; got 'hard'"),
    ("scene.right.position = -2", "scene.right.position", "must lie to the right of left.position; got -2.0"),
    ("scene.right.position = nan", "scene.right.position", "must be finite; got nan"),
    ("scene.right.motion.amplitude = 2.5", "scene.right.motion", "must not touch or cross in their motion"),
    ("scene.right.motion = {amplitude=0.1, harmonic=0}", "scene.right.motion.harmonic", "whole number from 1 to 1000"),
    ("scene.right.motion = {amplitude=0.1, harmonic=1.5}", "scene.right.motion.harmonic", "whole number; got 1.5"),
    ("scene.right.motion = {amplitude=0.1, harmonic=true}", "scene.right.motion.harmonic", "whole number; got True"),
    ("sweep.parameter = 'force'", "sweep.parameter", "must be a parameter of the scene"),
    (
        "sweep.parameter = 'left.motion.phase'",
        "sweep.parameter",
        "a parameter of the scene, perhaps left.position",
    ),
    ("sweep.parameter = 3", "sweep.parameter", "must be a text; got 3"),
    ("sweep.count = 0", "sweep.count", "must be a whole number >= 1; got 0"),
    ("sweep.count = 1201.0", "sweep.count", "must be a whole number; got 1201.0"),
    ("sweep.count = 1000000000000", "sweep.count", "must be a whole number <= 1000000"),
    ("sweep.settle = -1", "sweep.settle", "must be a whole number >= 0; got -1"),
    ("sweep.keep = 0", "sweep.keep", "must be a whole number >= 1; got 0"),
    ("sweep.legs = []", "sweep.legs", "must be a list of length >= 1; got []"),
    ("sweep.legs = 3", "sweep.legs", "must be a list; got 3"),
    ("sweep.legs.0 = 3", "sweep.legs[0]", "must be a table; got 3"),
    ("sweep.legs.7.to = 3", "sweep.legs.7", "is not a key here (name, from, to, start)"),
    ("sweep.legs.0.name = 'up'", "sweep.legs[1].name", "must differ from the other legs' names; got 'up'"),
    ("sweep.legs.0.name = ''", "sweep.legs[0].name", "must be a text of length >= 1; got ''"),
    ("sweep.legs.1.to = inf", "sweep.legs[1].to", "must be finite; got inf"),
    ("sweep.parameter = 'restitution'", "sweep.legs[0] from 6.0 to 0.0: restitution", "got 6.0 at index (0,)"),
    ("sweep.legs.0.start.x = 1.01", "sweep.legs[0].start.x", "must lie between the walls, at -1.0 and 1.0"),
    ("sweep.legs.0.start.v = nan", "sweep.legs[0].start.v", "must be finite; got nan"),
    ("sweep.legs.0.start = [0, 0]", "sweep.legs[0].start", "must be a table; got [0, 0]"),
    ("attractors.starts = 0", "attractors.starts", "must be a whole number >= 1; got 0"),
    ("attractors.seed = -1", "attractors.seed", "must be a whole number >= 0; got -1"),
    ("attractors.at = 4.65", "attractors.at", "must be a table; got 4.65"),
    ("attractors.at.force = 1.0", "attractors.at.force", "is not a parameter of this scene, perhaps amplitude ("),
    ("attractors.at.damping = 'low'", "attractors.at.damping", "must be a number; got 'low'"),
    (f"attractors.at.damping = 1{400 * '0'}", "attractors.at.damping", "Number out of range"),
    ("attractors.at.'right.restitution' = 2", "attractors.at.right.restitution", "must lie between 0 and 1; got 2.0"),
    ("orbits.periods = 3", "orbits.periods", "is not a key here, perhaps max_period (max_period, starts, seed, at)"),
    ("orbits = 3", "orbits", "must be a table; got 3"),
    ("orbits.max_period = 0", "orbits.max_period", "must be a whole number >= 1; got 0"),
    ("orbits.max_period = 33", "orbits.max_period", "must be a whole number <= 32; got 33"),
    ("orbits.max_period = 1.5", "orbits.max_period", "must be a whole number; got 1.5"),
    ("orbits.starts = 0", "orbits.starts", "must be a whole number >= 1; got 0"),
    ("orbits.seed = -1", "orbits.seed", "must be a whole number >= 0; got -1"),
    ("orbits.at = 4.65", "orbits.at", "must be a table; got 4.65"),
    ("orbits.at.force = 1.0", "orbits.at.force", "is not a parameter of this scene, perhaps amplitude ("),
    ("orbits.at.damping = 'low'", "orbits.at.damping", "must be a number; got 'low'"),
    ("orbits.at.frequency = 0", "orbits.at.frequency", "must be greater than 0; got 0.0"),
    ("scene.amplitude", "scene.amplitude", "must be KEY=VALUE with a TOML value"),
    ("scene.amplitude = large", "scene.amplitude", "must be KEY=VALUE with a TOML value"),
]


@each_of(BAD)
def test_bad_file_is_one_clear_line(change, key, said):
    check_refusal(FIG4, change, key, said)


@pytest.mark.parametrize("content", [b"[scene", b"\xff\xfe\x00", b"a = 1\na = 2", b"a = " + b"[" * 7, b"a = \n1"])
def test_what_is_no_toml_is_refused_with_the_files_name(tmp_path, content):
    path = tmp_path / "mine.toml"
    path.write_bytes(content)
    with pytest.raises(jv.SceneError, match=r"^mine\.toml: must be a TOML file; got .*$"):
        jv.load_scene(path)


def test_an_empty_file_and_a_missing_one(tmp_path):
    path = tmp_path / "mine.toml"
    with pytest.raises(FileNotFoundError):
        jv.load_scene(path)
    path.touch()
    with pytest.raises(jv.SceneError, match="scene: must be given"):
        jv.load_scene(path)


def test_changes_go_in_before_the_check():
    file = scene_file.read_scene_file(
        FIG4,
        [
            "scene.amplitude=3",
            "scene.right.motion.amplitude=0.1",
            "sweep.legs.1.to=5",
            "sweep.parameter='right.motion.phase'",
            "attractors.at.damping=0.1",
        ],
    )
    assert (file.scene.amplitude, file.scene.right.motion.amplitude) == (3.0, 0.1)
    assert [leg.last for leg in file.sweep.legs] == [0.0, 5.0]
    assert file.attractors.at == {"amplitude": 4.65, "damping": 0.1}
    assert file.orbits is None


def test_orbits_have_defaults_and_values_of_their_own():
    asked = scene_file.read_scene_file(FIG4, ["orbits = {}"]).orbits
    assert (asked.max_period, asked.starts, asked.seed, asked.at) == (4, 200, 0, {})
    asked = scene_file.read_scene_file(FIG4, ["orbits = {max_period=32, starts=7, seed=3, at={amplitude=3}}"]).orbits
    assert (asked.max_period, asked.starts, asked.seed, asked.at) == (32, 7, 3, {"amplitude": 3.0})


def test_a_start_is_held_against_the_walls_at_phase_0_of_the_first_value():
    change = ["scene.right.motion.amplitude=0.5", "sweep.parameter='right.position'", "sweep.legs.0.to=2.0"]
    legs = ["sweep.legs.0.start.x=6.4", "sweep.legs.1.from=3.0", "sweep.legs.1.start.x=3.5"]
    assert scene_file.read_scene_file(FIG4, change + legs).sweep.legs[1].start.x == 3.5
    with pytest.raises(jv.SceneError, match=r"sweep\.legs\[1\]\.start\.x: .* at -1\.0 and 3\.5; got 3\.6"):
        scene_file.read_scene_file(FIG4, [*change, *legs, "sweep.legs.1.start.x=3.6"])


def test_a_whole_file_survives_writing(tmp_path):
    changes = ["scene.right.restitution=0.6", "attractors.at.'right.restitution'=0.5", "orbits.max_period=2"]
    file = scene_file.read_scene_file(FIG4, changes)
    scene_file.write_scene_file(file, tmp_path / "copy.toml")
    assert scene_file.read_scene_file(tmp_path / "copy.toml") == file


def test_nothing_is_overwritten_or_left_half_written(tmp_path):
    path = tmp_path / "scene.toml"
    scene = jv.load_scene(FIG4)
    jv.save_scene(scene, path)
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        jv.save_scene(scene.replace(amplitude=1.0), path)
    with pytest.raises(jv.ArgumentError, match="must be a single scene to be saved"):
        jv.save_scene(scene.replace(amplitude=np.array([1.0, 2.0])), path, force=True)
    assert path.read_bytes() == before
    jv.save_scene(scene.replace(amplitude=1.0), path, force=True)
    assert tomllib.loads(path.read_text())["scene"]["amplitude"] == 1.0
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.toml"]


def bits(scene):
    leaves, structure = jax.tree.flatten(scene)
    return structure, [struct.pack("<d", float(leaf)) for leaf in leaves]


real = st.floats(-1e300, 1e300) | st.sampled_from([-0.0, 5e-324, 0.1])
fraction = st.floats(0, 1)
motion = st.none() | st.builds(jv.Motion, st.floats(-0.4, 0.4), real, st.integers(1, 5))
positive = st.floats(0, 1e300, exclude_min=True)
kinds = [{"restitution": st.none() | fraction}, {"stiffness": positive, "damping": st.none() | st.floats(0, 1e300)}]


def wall(low, high):
    return st.one_of(st.none(), *(st.builds(jv.Wall, st.floats(low, high), motion=motion, **kind) for kind in kinds))


walls = st.tuples(wall(-9, -1), wall(1, 9))


@given(
    scene=st.builds(
        jv.make_scene,
        amplitude=real,
        frequency=st.floats(0, 1e300, exclude_min=True),
        damping=st.floats(0, 1e300) | st.just(-0.0),
        restitution=fraction,
        walls=walls,
    )
)
def test_a_scene_survives_writing_bit_for_bit(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes") / "scene.toml"
    jv.save_scene(scene, path)
    assert bits(jv.load_scene(path)) == bits(scene)
    assert scene_table.make_scene_table(scene) == scene_file.read_scene_file(path).scene

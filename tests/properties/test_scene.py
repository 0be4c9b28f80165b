"""Properties of a scene as data, for every kind: names, files, physical units, symmetry."""

import re
import warnings
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.scene.scene_parameters import physical_units, require_scene_units
from jaxvibro.scene.scene_properties import is_symmetric, symmetrise_scene
from tests.kinds import LANES
from tests.scene_files import refusal
from tests.tiers import generator, of_batches, of_numbers

from .motions import assert_alike, assert_same, strobe, take


def changed_value(name, value):
    """Return another valid value of a parameter."""
    if name.endswith("restitution"):
        return 1.0 - value
    if name.endswith("position"):
        return value + (-0.125 if name.startswith("left") else 0.125)
    return 0.5 * value + 2.0**-5


@of_batches
def test_names(kind, scene, state):
    """Each number of a scene has a name, by which it is read and replaced; all others keep their bits."""
    names = [name for name in scene.names if name != "hardness"]
    assert len(set(names)) == len(names) == len(jax.tree.leaves(scene))
    for name in names:
        with pytest.raises(jv.ArgumentError, match=re.escape(f", perhaps {name} (")):
            scene.parameter(name[:-1])
        value = changed_value(name, scene.parameter(name))
        changed = scene.replace(**{name: value})
        assert_same(*((changed.parameter(key), value if key == name else scene.parameter(key)) for key in names))
        assert jax.tree.structure(changed) == jax.tree.structure(scene)
    if scene.hardens:
        harder = scene.replace(hardness=scene.parameter("hardness") + 0.5)
        for side in scene.soft_sides:
            ratio = harder.parameter(f"{side}.stiffness") / scene.parameter(f"{side}.stiffness")
            np.testing.assert_allclose(ratio, np.sqrt(10.0), rtol=1e-12)
    for wrong in ("mass", "left.motion", "hardnes", "right.position.x"):
        with pytest.raises(jv.ArgumentError, match="is not a parameter of this scene"):
            scene.replace(**{wrong: 1.0})


WRONG = {
    "must be finite": (np.nan, np.inf, -np.inf),
    "must be a real number": ("2", 2j, True, 10**400, np.array(["a\nb"]), np.array([True])),
    "must be a number or an array, not a ": ([0.5, 0.8], (0.5,), [0.5, [0.8]]),
}


@of_numbers
def test_wrong_numbers(kind, number):
    """What is no finite real number is refused for each parameter, in one line that begins with its name."""
    scene = kind.draw_single(number)[0]
    for name in scene.names:
        for said, values in WRONG.items():
            for value in values:
                assert refusal(scene.replace, **{name: value}).startswith(f"{name}: {said}"), value


@of_batches
def test_files(kind, scene, state):
    """A scene that is written to a file and read has the same bits and the same structure; a batch is refused."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        for lane in range(LANES):
            single = take(scene, lane)
            jv.save_scene(single, path, force=True)
            loaded = jv.load_scene(path)
            assert jax.tree.structure(loaded) == jax.tree.structure(single)
            assert [np.float64(leaf).tobytes() for leaf in jax.tree.leaves(loaded)] == [
                np.float64(leaf).tobytes() for leaf in jax.tree.leaves(single)
            ]
        content = path.read_bytes()
        with pytest.raises(jv.ArgumentError, match="must be a single scene to be saved"):
            jv.save_scene(scene, path, force=True)
        with pytest.raises(FileExistsError):
            jv.save_scene(single, path)
        assert path.read_bytes() == content and list(Path(folder).iterdir()) == [path]


def physical_scene(scene, mass, stiffness, length):
    """Return the scene made from the SI quantities that it has with these scales."""
    natural = np.sqrt(stiffness / mass)

    def motion(given):
        return given and replace(given, amplitude=length * given.amplitude)

    def wall(given):
        if given is None:
            return None
        soft = {}
        if given.soft:
            soft = {"stiffness": stiffness * given.stiffness, "damping": 2.0 * mass * natural * given.damping}
        return replace(given, position=length * given.position, motion=motion(given.motion), **soft)

    drive = [replace(term, amplitude=stiffness * length * term.amplitude) for term in scene.drive]
    return jv.scene_from_physical(
        mass,
        2.0 * mass * natural * scene.damping,
        stiffness,
        stiffness * length * scene.amplitude,
        natural * scene.frequency,
        scene.restitution,
        (wall(scene.left), wall(scene.right)),
        length,
        drive=drive,
    )


def draw_scales(kind, number):
    """Return a mass in kg, a stiffness in N/m and a length in m."""
    draw = generator(kind, number)
    return 10.0 ** draw.uniform((-2.0, 3.0, -4.0), (2.0, 6.0, -2.0))


@of_numbers
def test_physical(kind, number):
    """A scene from SI quantities has the numbers and the motion of the scene without units."""
    scene, state = kind.draw(number)
    scales = draw_scales(kind, number)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = physical_scene(replace(scene, amplitude=abs(scene.amplitude)), *scales)  # both signs look like a record
    made = made.replace(amplitude=np.copysign(made.amplitude, scene.amplitude))
    for name in scene.names:
        np.testing.assert_allclose(made.parameter(name), scene.parameter(name), rtol=2e-15, atol=1e-300)
    assert_alike(kind, scene, state, strobe(scene, state), strobe(made, state))
    single = replace(take(scene, 0), scales=jv.Scales(*scales))
    assert physical_scene(single, *scales).scales.numbers == single.scales.numbers
    assert single.replace(amplitude=3.0).scales == single.scales
    assert jax.tree.structure(single) == jax.tree.structure(take(scene, 0))  # scales compile no other program


@of_numbers
def test_unit_mistakes(kind, number):
    """Values in a physical unit far from the scene's are refused with the factor; values in the scene's never are."""
    scene = replace(kind.draw_single(number)[0], scales=jv.Scales(*draw_scales(kind, number)))
    checked = 0
    for name in scene.names:
        value = float(scene.parameter(name))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            require_scene_units("values", scene, name, np.linspace(0.5, 1.5, 5) * value)
            require_scene_units("values", scene, name, np.array([value]))
        for _, factor in physical_units(scene.scales, name):
            if value != 0.0 and not 0.1 <= factor <= 10.0:
                with pytest.raises(jv.ArgumentError, match=f"look like .* divide them by {factor:.6g}"):
                    require_scene_units("values", scene, name, np.linspace(0.8, 1.3, 5) * value * factor)
                checked += 1
    assert checked


@of_batches
def test_symmetry(kind, scene, state):
    """In a symmetric scene a mirror image half a period later is a motion; one changed wall breaks the symmetry."""
    scene = jax.tree.map(np.asarray, symmetrise_scene(scene))
    image = replace(state, x=-state.x, v=-state.v, phase=state.phase + np.pi)
    assert_alike(kind, scene, state, strobe(scene, state), strobe(scene, image), -1)
    single = take(scene, 0)
    assert is_symmetric(single)
    for name in single.names:
        other = single.replace(**{name: changed_value(name, single.parameter(name))})
        breaks = name.startswith(("left", "right", "drive.0.amplitude"))  # harmonic 2
        assert is_symmetric(other) is not breaks or other.parameter(name) == single.parameter(name), name

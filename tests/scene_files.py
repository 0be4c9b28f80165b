"""What the tests of scene files share: the scene of figure 4, and that a broken rule is told in one clear line."""

import pytest

from jaxvibro import ArgumentError
from jaxvibro.studies import scene_file

SCENE = """
[scene]
amplitude = 4.65
frequency = 2.1
damping = 0.05
restitution = 0.7
[scene.left]
position = -1.0
[scene.right]
position = 1.0
"""


def each_of(bad):
    """Marks a test that takes each (change to a file, key that the error names, what it says)."""
    names = [f"{place}-{key}" for place, (_, key, _) in enumerate(bad)]
    return pytest.mark.parametrize(("change", "key", "said"), bad, ids=names)


def check_refusal(path, change, key, said):
    """A file with a change is refused in one clear line."""
    with pytest.raises(ArgumentError) as caught:
        scene_file.read_scene_file(path, [change])
    line = str(caught.value)
    assert caught.value.key == key
    assert line.startswith(" ".join(key.split()) + ": ") and said in line, line
    assert "\n" not in line and len(line) < 300, line

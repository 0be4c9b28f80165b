"""Scene files for the tests: the scene of figure 4, and the check that a broken rule is reported in one clear line."""

from pathlib import Path

import pytest

import jaxvibro as jv

SCENES = Path(__file__).parents[1] / "scenes"
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


def check_refusal(path, change, key, said):
    """Check that a run of a file with a change is refused before any work, in one clear line."""
    with pytest.raises(jv.ArgumentError) as caught:
        jv.run(path, "nowhere", [change])
    line = str(caught.value)
    assert caught.value.key == key
    assert line.startswith(" ".join(key.split()) + ": ") and said in line, line
    assert "\n" not in line and len(line) < 300 and not Path("nowhere").exists(), line

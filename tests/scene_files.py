"""Scene files and the command line for the tests: the scene of figure 4, a call, and the check of a refusal."""

from pathlib import Path

import pytest

import jaxvibro as jv
from jaxvibro.studies.command import main

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


def call_command(*words):
    """Return the exit code of a command line."""
    return main([str(word) for word in words])


def refusal(call, *given, **settings):
    """Return the message of a refused call, which is one line that is not too long."""
    with pytest.raises(jv.ArgumentError) as error:
        call(*given, **settings)
    line = str(error.value)
    assert "\n" not in line and 0 < len(line) <= 300, line
    assert line.startswith(" ".join(error.value.key.split()) + ": "), line
    return line

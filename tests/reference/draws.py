"""A random scene and a start."""

from typing import NamedTuple

from .scene import Scene


class Draw(NamedTuple):
    """A scene and a start strictly between its walls."""

    scene: Scene
    x: float
    v: float
    phase: float

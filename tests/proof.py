"""Old names, until all groups of tests are merged: import `tests.scenes_of_references`."""

from tests.scenes_of_references import SLOTS, batch, scene_of

__all__ = ["SLOTS", "batch", "scene_of"]

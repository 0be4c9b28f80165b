"""Old names, until all groups of tests are merged: import `tests.sticking_orbits`."""

from tests.sticking_orbits import errors, halved, met, resting

__all__ = ["errors", "halved", "met", "resting"]

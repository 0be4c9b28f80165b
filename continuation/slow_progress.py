"""Warn of a continuation that hardly moves along its parameter."""

import warnings

import numpy as np

SLOW, NARROW = 100, 1e-7  # points in a row, and 1 + abs of the parameter: as many within as little are slow progress


class SlowProgress(UserWarning):
    """A continuation takes many steps without a change of its parameter."""


def is_slow(one):
    """Return True if many points of a `Stretch` lie at nearly one value of the parameter."""
    values = one.points.z[:, -1]
    return len(values) > SLOW and float(np.ptp(values)) < NARROW * (1.0 + abs(values[-1]))


def warn_if_slow(control, one):
    """Warn where many points in a row lie at nearly one value of the parameter."""
    if is_slow(one):
        values, steps = one.points.z[:, -1], one.points.step
        width, count = float(np.ptp(values)), len(values) - 1
        least, most = float(steps[1:].min()), float(steps[1:].max())
        warnings.warn(
            f"slow progress: {count} points lie within {width:.1e} of the parameter value {values[-1]:.12g}, with steps"
            f" of {least:.1e} to {most:.1e} (the smallest allowed is {float(control.smallest):.1e}); the curve bends"
            " sharply or is nearly singular there; set max_points or max_seconds, or narrow the bounds",
            SlowProgress,
            stacklevel=2,
        )

"""Warn if a continuation hardly changes its parameter."""

import warnings

import numpy as np

# Number of consecutive points within a width, relative to 1 + abs(parameter), that count as slow progress.
SLOW_POINTS, NARROW_WIDTH = 100, 1e-7


class SlowProgressWarning(UserWarning):
    """Warning for a continuation that takes many steps at nearly one value of its parameter."""


def has_slow_progress(segment):
    """Return True if many points of a `BranchSegment` lie at nearly one value of the parameter."""
    parameter_values = segment.points.z[:, -1]
    return len(parameter_values) > SLOW_POINTS and float(np.ptp(parameter_values)) < NARROW_WIDTH * (
        1.0 + abs(parameter_values[-1])
    )


def warn_if_slow(control, segment):
    """Warn if many consecutive points lie at nearly one value of the parameter."""
    if has_slow_progress(segment):
        parameter_values, steps = segment.points.z[:, -1], segment.points.step
        parameter_range, n_steps = float(np.ptp(parameter_values)), len(parameter_values) - 1
        smallest_step, largest_step = float(steps[1:].min()), float(steps[1:].max())
        warnings.warn(
            f"slow progress: {n_steps} points lie within {parameter_range:.1e} of the parameter value"
            f" {parameter_values[-1]:.12g},"
            " with steps"
            f" of {smallest_step:.1e} to {largest_step:.1e} (the smallest allowed is"
            f" {float(control.min_step):.1e}); the curve bends"
            " sharply or is nearly singular there; set max_points or max_seconds, or narrow the bounds",
            SlowProgressWarning,
            stacklevel=2,
        )

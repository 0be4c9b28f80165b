"""Axes that are the plane of two parameters: what is drawn there carries the parameters in its group id."""

import numpy as np

from ..scene.check import ArgumentError
from .style import of_parameter

BETWEEN = ": "  # what is drawn, and the parameters


def in_plane(ax, names, scales):
    """(the Axes, their labels those of the two parameters; what these are multiplied by). Raises ArgumentError where
    they hold something in the plane of others."""
    gids = [artist.get_gid() or "" for artist in (*ax.lines, *ax.patches)]
    there = {gid.split(BETWEEN)[1] for gid in gids if BETWEEN in gid}
    if there - {", ".join(names)}:
        rule = f"must be in the plane of what these Axes hold already ({', '.join(sorted(there))}, in this order)"
        raise ArgumentError("one.names", rule, tuple(names))
    across, up = (of_parameter(scales, name) for name in names)
    ax.set(xlabel=across.label, ylabel=up.label)
    return ax, np.array([across.size, up.size])


def plane_gid(what, names):
    """The group id of what is drawn in the plane of two parameters."""
    return f"{what}{BETWEEN}{', '.join(names)}"


def with_gid(artists, what):
    """The artists whose group id begins with what is drawn."""
    return [each for each in artists if (each.get_gid() or "").startswith(what)]

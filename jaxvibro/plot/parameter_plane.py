"""Axes that are the plane of two parameters: what is drawn there carries the parameters in its group id."""

import numpy as np

from ..scene.check import ArgumentError
from .style import parameter_axis

GID_SEPARATOR = ": "  # what is drawn, and the parameters


def prepare_plane(ax, names, scales):
    """(the Axes, their labels those of the two parameters; what these are multiplied by). Raises ArgumentError where
    they hold something in the plane of others."""
    gids = [artist.get_gid() or "" for artist in (*ax.lines, *ax.patches)]
    planes = {gid.split(GID_SEPARATOR)[1] for gid in gids if GID_SEPARATOR in gid}
    if planes - {", ".join(names)}:
        rule = f"must be in the plane of what these Axes hold already ({', '.join(sorted(planes))}, in this order)"
        raise ArgumentError("one.names", rule, tuple(names))
    x_axis, y_axis = (parameter_axis(scales, name) for name in names)
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    return ax, np.array([x_axis.factor, y_axis.factor])


def plane_gid(kind, names):
    """The group id of what is drawn in the plane of two parameters."""
    return f"{kind}{GID_SEPARATOR}{', '.join(names)}"


def artists_with_gid(artists, kind):
    """The artists whose group id begins with what is drawn."""
    return [artist for artist in artists if (artist.get_gid() or "").startswith(kind)]

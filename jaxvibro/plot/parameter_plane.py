"""Prepare Axes for the plane of two parameters, which the group ids of its artists record."""

import numpy as np

from ..scene.check import ArgumentError
from .style import parameter_axis

GID_SEPARATOR = ": "  # between the kind of artist and the parameters


def prepare_plane(ax, names, scales):
    """Label Axes with two parameters and return (the Axes, the factors of the two axes).

    Raises ArgumentError if the Axes hold artists of another plane.
    """
    gids = [artist.get_gid() or "" for artist in (*ax.lines, *ax.patches)]
    planes = {gid.split(GID_SEPARATOR)[1] for gid in gids if GID_SEPARATOR in gid}
    if planes - {", ".join(names)}:
        rule = (
            f"must have the parameters of the curves that these Axes hold ({', '.join(sorted(planes))}, in this order)"
        )
        raise ArgumentError("one.names", rule, tuple(names))
    x_axis, y_axis = (parameter_axis(scales, name) for name in names)
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    return ax, np.array([x_axis.factor, y_axis.factor])


def plane_gid(kind, names):
    """Return the group id of an artist of this kind in the plane of two parameters."""
    return f"{kind}{GID_SEPARATOR}{', '.join(names)}"


def artists_with_gid(artists, kind):
    """Return the artists whose group id begins with this kind."""
    return [artist for artist in artists if (artist.get_gid() or "").startswith(kind)]

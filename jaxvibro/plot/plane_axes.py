"""Prepare Axes for the plane of two parameters.

The group ids of the artists contain the names of the parameters.
"""

import numpy as np

from ..scene.check import ArgumentError
from .style import parameter_axis

GID_SEPARATOR = ": "  # between the kind of artist and the parameters


def prepare_plane(ax, parameter_names, scales):
    """Label Axes with two parameters; return the Axes and the factors from scene units to the units of the two axes.

    Raises ArgumentError if the Axes hold artists of the plane of other parameters.
    """
    group_ids = [artist.get_gid() or "" for artist in (*ax.lines, *ax.patches)]
    plane_names = {group_id.split(GID_SEPARATOR)[1] for group_id in group_ids if GID_SEPARATOR in group_id}
    if plane_names - {", ".join(parameter_names)}:
        error_rule = (
            "must have the parameters of the curves that these Axes hold"
            f" ({', '.join(sorted(plane_names))}, in this order)"
        )
        raise ArgumentError("one.names", error_rule, tuple(parameter_names))
    x_axis, y_axis = (parameter_axis(scales, name) for name in parameter_names)
    ax.set(xlabel=x_axis.label, ylabel=y_axis.label)
    return ax, np.array([x_axis.factor, y_axis.factor])


def artist_gid(artist_kind, parameter_names):
    """Return the group id of an artist of this kind in the plane of two parameters."""
    return f"{artist_kind}{GID_SEPARATOR}{', '.join(parameter_names)}"


def artists_of_kind(artists, artist_kind):
    """Return the artists whose group id begins with this kind."""
    return [artist for artist in artists if (artist.get_gid() or "").startswith(artist_kind)]

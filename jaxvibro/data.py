"""The data of a run as one Dataset, as it goes to a NetCDF file: the sweep's variables and the attractors'."""

import msgspec
import numpy as np
import xarray as xr

from . import __version__

NONE = -1  # in `attractor_mirror`, where no mirror image was found


def dataset(found):
    """An xarray.Dataset of all that was `Found`, with the job as TOML in its attribute `job`."""
    parts = [found.swept] if found.swept is not None else []
    parts += [_attractors(found.attractors)] if found.attractors is not None else []
    whole = xr.merge(parts, combine_attrs="drop_conflicts")
    attrs = {
        "title": "jaxvibro run",
        "source": f"jaxvibro {__version__}",
        "job": msgspec.toml.encode(found.file).decode(),
    }
    return whole.assign_attrs(attrs)


def _attractors(attractors):
    def column(meaning, values):
        return "attractor", np.array(values), {"long_name": meaning}

    states = [one.state for one in attractors]
    return xr.Dataset(
        {
            "attractor_label": column("P n p q: periods, impacts left, right", [one.label for one in attractors]),
            "attractor_share": column("share of the starts", [one.share for one in attractors]),
            "attractor_periods": column("least number of drive periods, 0: none", [one.periods for one in attractors]),
            "attractor_x": column("position of a state on it, at phase 0", [one.x for one in states]),
            "attractor_v": column("velocity of that state", [one.v for one in states]),
            "attractor_contact": column("contact of that state", [one.contact for one in states]),
            "attractor_exponent": column("largest Lyapunov exponent per period", [one.exponent for one in attractors]),
            "attractor_mirror": column(
                f"place of its mirror image, {NONE}: none",
                [NONE if one.mirror_of is None else one.mirror_of for one in attractors],
            ),
        }
    )

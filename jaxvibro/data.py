"""The data of a run as one Dataset, as it goes to a NetCDF file: those of sweep, attractors and orbits."""

import msgspec
import numpy as np
import xarray as xr

from . import __version__

NONE = -1  # in `attractor_mirror` and `orbit_mirror`, where no mirror image was found
LENGTH, SPEED = {"units": "length"}, {"units": "length w0"}


def dataset(found):
    """An xarray.Dataset of all that was `Found`, with the job as TOML in its attribute `job`."""
    parts = [found.swept] if found.swept is not None else []
    parts += [_attractors(found.attractors)] if found.attractors is not None else []
    parts += [_orbits(found.orbits)] if found.orbits else []
    whole = xr.merge(parts, combine_attrs="drop_conflicts")
    attrs = {
        "title": "jaxvibro run",
        "source": f"jaxvibro {__version__}",
        "job": msgspec.toml.encode(found.file).decode(),
    }
    return whole.assign_attrs(attrs)


def _attractors(attractors):
    def column(meaning, values, **attrs):
        return "attractor", np.array(values), {"long_name": meaning, **attrs}

    states = [one.state for one in attractors]
    return xr.Dataset(
        {
            "attractor_label": column("P n p q: periods, impacts left, right", [one.label for one in attractors]),
            "attractor_share": column("share of the starts", [one.share for one in attractors]),
            "attractor_periods": column("least number of drive periods, 0: none", [one.periods for one in attractors]),
            "attractor_x": column("position of a state on it, at phase 0", [one.x for one in states], **LENGTH),
            "attractor_v": column("velocity of that state", [one.v for one in states], **SPEED),
            "attractor_contact": column("contact of that state", [one.contact for one in states]),
            "attractor_exponent": column("largest Lyapunov exponent per period", [one.exponent for one in attractors]),
            "attractor_mirror": column(f"place of its mirror image, {NONE}: none", _images(attractors)),
        }
    )


def _orbits(orbits):
    def column(meaning, values, **attrs):
        return "orbit", np.array(values), {"long_name": meaning, **attrs}

    states, roots = [one.state for one in orbits], np.array([one.multipliers for one in orbits])
    larger = ("orbit", "multiplier"), {"long_name": "Floquet multipliers, the larger first"}
    return xr.Dataset(
        {
            "orbit_label": column("P n p q: periods, impacts left, right", [one.label for one in orbits]),
            "orbit_periods": column("least number of drive periods", [one.periods for one in orbits], units="1"),
            "orbit_itinerary": column("walls hit, a word a period", [" ".join(one.itinerary) for one in orbits]),
            "orbit_x": column("position of a state on it", [one.x for one in states], **LENGTH),
            "orbit_v": column("velocity of that state", [one.v for one in states], **SPEED),
            "orbit_phase": column("phase of the drive of that state", [one.phase for one in states], units="rad"),
            "orbit_contact": column("contact of that state", [one.contact for one in states]),
            "orbit_stable": column("1: both multipliers are smaller than 1", [int(one.stable) for one in orbits]),
            "orbit_multiplier_real": (larger[0], roots.real, {**larger[1], "units": "1"}),
            "orbit_multiplier_imag": (larger[0], roots.imag, {**larger[1], "units": "1"}),
            "orbit_least_speed": column("least speed of its impacts", [one.least_speed for one in orbits], **SPEED),
            "orbit_least_clearance": column(
                "least distance to a wall at a turning point towards it",
                [one.least_clearance for one in orbits],
                **LENGTH,
            ),
            "orbit_residual": column("largest error left in its equations", [one.residual for one in orbits]),
            "orbit_mirror": column(f"place of its mirror image, {NONE}: none", _images(orbits)),
        }
    )


def _images(found):
    return [NONE if one.mirror_of is None else one.mirror_of for one in found]

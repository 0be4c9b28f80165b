"""The data of a run as one Dataset, as it goes to a NetCDF file: sweep, attractors, orbits, branches and loci."""

import msgspec
import numpy as np
import xarray as xr

from .. import __version__
from ..branches.branch import labels_of
from ..maps.initial_conditions import box
from ..output.units import ANGLE, LENGTH, ONE, SPEED

NONE = -1  # in `attractor_mirror` and `orbit_mirror`, where no mirror image was found


def dataset(found):
    """An xarray.Dataset of all that was `Found`, with the job as TOML in its attribute `job`."""
    parts = [found.swept] if found.swept is not None else []
    parts += [_attractors(found), _box(found)] if found.attractors is not None else []
    parts += [_orbits(found.orbits)] if found.orbits else []
    parts += [_branches(found.branches), _special(found.branches)] if found.branches else []
    parts += [_loci(found.loci), _codim2(found.loci)] if found.loci else []
    parts += [_margin(found.margin)] if found.margin is not None else []
    parts += [_fit(found.fit)] if found.fit is not None else []
    whole = xr.merge(parts, combine_attrs="drop_conflicts")
    attrs = {
        "title": "jaxvibro run",
        "source": f"jaxvibro {__version__}",
        "job": msgspec.toml.encode(found.file).decode(),
    }
    return whole.assign_attrs(attrs)


def _attractors(found):
    attractors = found.attractors

    def column(meaning, values, **attrs):
        return "attractor", np.array(values), {"long_name": meaning, **attrs}

    states, bounds = [one.state for one in attractors], np.array([one.share_bounds for one in attractors])
    return xr.Dataset(
        {
            "attractor_label": column("P n p q: periods, impacts left, right", [one.label for one in attractors]),
            "attractor_share": column("share of the starts", [one.share for one in attractors]),
            "attractor_share_low": column("lowest share that the starts speak for, at 95 %", bounds[:, 0], units="1"),
            "attractor_share_high": column("highest share that the starts speak for, at 95 %", bounds[:, 1], units="1"),
            "attractor_periods": column("least number of drive periods, 0: none", [one.periods for one in attractors]),
            "attractor_x": column("position of a state on it, at phase 0", [one.x for one in states], units=LENGTH),
            "attractor_v": column("velocity of that state", [one.v for one in states], units=SPEED),
            "attractor_contact": column("contact of that state", [one.contact for one in states]),
            "attractor_rests": column("1: the mass rests on a wall", [int(one.rests) for one in attractors], units="1"),
            "attractor_exponent": column("largest Lyapunov exponent per period", [one.exponent for one in attractors]),
            "attractor_mirror": column(f"place of its mirror image, {NONE}: none", _images(attractors)),
        }
    )


def _box(found):
    """The box of the random starts."""
    left, right, fast = box(found.there(found.file.attractors))
    return xr.Dataset(
        {
            "start_x": (
                "start_bound",
                [left, right],
                {"long_name": "of random starts, phase 0: x from, to", "units": LENGTH},
            ),
            "start_v": (
                "start_bound",
                [-fast, fast],
                {"long_name": "of random starts, phase 0: v from, to", "units": SPEED},
            ),
            "start_count": ((), found.file.attractors.starts, {"long_name": "random starts", "units": ONE}),
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
            "orbit_x": column("position of a state on it", [one.x for one in states], units=LENGTH),
            "orbit_v": column("velocity of that state", [one.v for one in states], units=SPEED),
            "orbit_phase": column("phase of the drive of that state", [one.phase for one in states], units=ANGLE),
            "orbit_contact": column("contact of that state", [one.contact for one in states]),
            "orbit_stable": column("1: both multipliers are smaller than 1", [int(one.stable) for one in orbits]),
            "orbit_rests": column("1: the mass rests on a wall", [int(one.rests) for one in orbits], units="1"),
            "orbit_multiplier_real": (larger[0], roots.real, {**larger[1], "units": ONE}),
            "orbit_multiplier_imag": (larger[0], roots.imag, {**larger[1], "units": ONE}),
            "orbit_least_speed": column("least speed of its impacts", [one.least_speed for one in orbits], units=SPEED),
            "orbit_least_clearance": column(
                "least distance to a wall at a turning point towards it",
                [one.least_clearance for one in orbits],
                units=LENGTH,
            ),
            "orbit_residual": column("largest error left in its equations", [one.residual for one in orbits]),
            "orbit_mirror": column(f"place of its mirror image, {NONE}: none", _images(orbits)),
        }
    )


def _branches(branches):
    """All branches' points, one after the other, in the variables that a branch's data have."""
    name, data = branches[0].name, [one.data for one in branches]

    def column(key):
        dims, attrs = data[0][key].dims, data[0][key].attrs
        parts = [each[key].values for each in data]
        if len(dims) > 1:
            widest = max(part.shape[1] for part in parts)
            fill = 0 if parts[0].dtype.kind == "i" else np.nan
            parts = [np.pad(part, ((0, 0), (0, widest - part.shape[1])), constant_values=fill) for part in parts]
        named = [dim if dim == "multiplier" else f"branch_{dim}" for dim in dims]
        return named, np.concatenate(parts), attrs

    number = np.repeat(np.arange(len(branches)), [len(one) for one in branches])
    found = {f"branch_{'value' if key == name else key}": column(key) for key in data[0]}
    found["branch_value"][2]["parameter"] = name
    found["branch_number"] = "branch_point", number, {"long_name": "place of the branch among the branches, from 0"}
    for place, end in enumerate(("first", "last")):
        why = [one.reasons[place] for one in branches]
        found[f"branch_{end}_reason"] = "branch", why, {"long_name": f"why the branch ends at its {end} point"}
    return xr.Dataset(found)


def _special(branches):
    """The special points of all branches, ends included."""
    firsts = np.cumsum([0] + [len(one) for one in branches])
    found = [(k, one) for k, branch in enumerate(branches) for one in branch.special]
    roots = np.array([one.multipliers for _, one in found])

    def column(meaning, values, **attrs):
        return "special", np.array(values), {"long_name": meaning, **attrs}

    larger = ("special", "multiplier"), {"long_name": "Floquet multipliers, the larger first", "units": ONE}
    return xr.Dataset(
        {
            "special_kind": column("SN, SB, BP, PD, GR, EP", [one.kind for _, one in found]),
            "special_value": column("of the parameter", [one.value for _, one in found]),
            "special_branch": column("place of its branch among the branches", [k for k, _ in found]),
            "special_point": column("its place along branch_point", [firsts[k] + one.place for k, one in found]),
            "special_label": column("P n p q: periods, impacts left, right", [one.label for _, one in found]),
            "special_itinerary": column("walls hit, a word a period", [" ".join(one.itinerary) for _, one in found]),
            "special_meets": column("orbits that meet there", [" ".join(labels_of(one)) for _, one in found]),
            "special_multiplier_real": (larger[0], roots.real, larger[1]),
            "special_multiplier_imag": (larger[0], roots.imag, larger[1]),
            "special_residual": column("largest error left in its equations", [one.residual for _, one in found]),
        }
    )


def _loci(loci):
    """All loci's points, one after the other."""
    number = np.repeat(np.arange(len(loci)), [len(one) for one in loci])
    found = {"locus_number": ("locus_point", number, {"long_name": "place of the locus among the loci, from 0"})}
    for name in loci[0].names:
        column = np.concatenate([one.data[name].values for one in loci])
        found[f"locus_{name}"] = "locus_point", column, {"long_name": "a parameter"}
    whole = {
        "kind": ("SN, PD, SB, GR", [one.kind for one in loci]),
        "label": ("P n p q: periods, impacts left, right", [one.label for one in loci]),
        "first_reason": ("why the locus ends at its first point", [one.reasons[0] for one in loci]),
        "last_reason": ("why the locus ends at its last point", [one.reasons[1] for one in loci]),
    }
    found |= {f"locus_{key}": ("locus", each, {"long_name": meaning}) for key, (meaning, each) in whole.items()}
    return xr.Dataset(found)


def _codim2(loci):
    """The special points of all loci, ends included."""
    firsts = np.cumsum([0] + [len(one) for one in loci])
    found = [(k, one) for k, locus in enumerate(loci) for one in locus.special]
    told = {
        "kind": ("CP, GPD, DSB, GR, GG, RG, SN, PD, SB, EP", [one.kind for _, one in found]),
        "locus": ("place of its locus among the loci", [k for k, _ in found]),
        "point": ("its place along locus_point", [firsts[k] + one.place for k, one in found]),
        "label": ("P n p q: periods, impacts left, right", [one.label for _, one in found]),
        "itinerary": ("walls hit, a word a period", [" ".join(one.itinerary) for _, one in found]),
        "residual": ("largest error left in its equations", [one.residual for _, one in found]),
    }
    return xr.Dataset(
        {f"codim2_{key}": ("codim2", np.array(each), {"long_name": meaning}) for key, (meaning, each) in told.items()}
    )


def _margin(near):
    """The nearest points of the kinds, and by how much each free number is another there."""
    points, names = near.points, list(near.free)
    changes = np.array([[one.change[name] for name in names] for one in points]).reshape(len(points), len(names))
    told = {
        "kind": ("SN, PD, SB, GR", [one.kind for one in points]),
        "distance": ("from the scene, in units of the free numbers", [one.distance for one in points]),
        "status": ("reached, or behind another", [one.status for one in points]),
        "edge": ("what ends the boundary there, if anything does", [one.edge for one in points]),
        "residual": ("largest number left in its equations", [one.residual for one in points]),
    }
    found = {f"near_{key}": ("near", np.array(each), {"long_name": meaning}) for key, (meaning, each) in told.items()}
    found["near_change"] = ("near", "free"), changes, {"long_name": "of each free number"}
    found["free_unit"] = "free", list(near.free.values()), {"long_name": "one unit of each free number"}
    return xr.Dataset(found, {"free": names})


def _fit(one):
    """The fitted numbers, their errors and covariance."""
    names = list(one.values)
    told = {
        "fit_value": ("fitted", list(one.values.values()), {"long_name": "of each fitted number"}),
        "fit_sigma": ("fitted", list(one.sigma.values()), {"long_name": "its standard error, inf: not in the record"}),
        "fit_covariance": (("fitted", "other"), one.covariance.values, {"long_name": "of the fitted numbers"}),
        "fit_residual": ("heard", one.residuals, {"long_name": "measured less fitted, in errors", "units": ONE}),
    }
    return xr.Dataset(told, {"fitted": names, "other": names}, {"fit_status": one.status.name})


def _images(found):
    return [NONE if one.mirror_of is None else one.mirror_of for one in found]

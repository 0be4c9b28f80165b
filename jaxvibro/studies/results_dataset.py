"""Convert the results of a run to one Dataset for a NetCDF file: sweep, attractors, orbits, branches and loci."""

import msgspec
import numpy as np
import xarray as xr

from .. import __version__
from ..branches.branch import neighbour_labels
from ..maps.initial_conditions import initial_box
from ..output.units import ANGLE, DIMENSIONLESS, LENGTH, SPEED

NO_MIRROR = -1  # value of `attractor_mirror` and `orbit_mirror` without a mirror image


def results_dataset(results):
    """Return an xarray.Dataset of all `StudyResults`, with the scene file as TOML in its attribute `job`."""
    parts = [results.swept] if results.swept is not None else []
    parts += [_attractor_dataset(results), _start_dataset(results)] if results.attractors is not None else []
    parts += [_orbit_dataset(results.orbits)] if results.orbits else []
    parts += [_branch_dataset(results.branches), _special_dataset(results.branches)] if results.branches else []
    parts += [_locus_dataset(results.loci), _codim2_dataset(results.loci)] if results.loci else []
    parts += [_margin_dataset(results.margin)] if results.margin is not None else []
    parts += [_fit_dataset(results.fit)] if results.fit is not None else []
    full_dataset = xr.merge(parts, combine_attrs="drop_conflicts")
    attrs = {
        "title": "jaxvibro run",
        "source": f"jaxvibro {__version__}",
        "job": msgspec.toml.encode(results.file).decode(),
    }
    return full_dataset.assign_attrs(attrs)


def _attractor_dataset(results):
    attractors = results.attractors

    def make_variable(meaning, values, **attrs):
        return "attractor", np.array(values), {"long_name": meaning, **attrs}

    states, share_bounds = (
        [attractor.state for attractor in attractors],
        np.array([attractor.share_bounds for attractor in attractors]),
    )
    return xr.Dataset(
        {
            "attractor_label": make_variable(
                "P n p q: periods, impacts left, right", [attractor.label for attractor in attractors]
            ),
            "attractor_share": make_variable("share of the starts", [attractor.share for attractor in attractors]),
            "attractor_share_low": make_variable(
                "lowest share that the starts speak for, at 95 %", share_bounds[:, 0], units="1"
            ),
            "attractor_share_high": make_variable(
                "highest share that the starts speak for, at 95 %", share_bounds[:, 1], units="1"
            ),
            "attractor_periods": make_variable(
                "least number of drive periods, 0: none", [attractor.periods for attractor in attractors]
            ),
            "attractor_x": make_variable(
                "position of a state on it, at phase 0", [attractor.x for attractor in states], units=LENGTH
            ),
            "attractor_v": make_variable("velocity of that state", [attractor.v for attractor in states], units=SPEED),
            "attractor_contact": make_variable("contact of that state", [attractor.contact for attractor in states]),
            "attractor_rests": make_variable(
                "1: the mass rests on a wall", [int(attractor.rests) for attractor in attractors], units="1"
            ),
            "attractor_exponent": make_variable(
                "largest Lyapunov exponent per period", [attractor.exponent for attractor in attractors]
            ),
            "attractor_mirror": make_variable(
                f"place of its mirror image, {NO_MIRROR}: none", _mirror_indices(attractors)
            ),
        }
    )


def _start_dataset(results):
    """Return the box of the random starts."""
    x_lower, x_upper, max_speed = initial_box(results.scene_of_table(results.file.attractors))
    return xr.Dataset(
        {
            "start_x": (
                "start_bound",
                [x_lower, x_upper],
                {"long_name": "of random starts, phase 0: x from, to", "units": LENGTH},
            ),
            "start_v": (
                "start_bound",
                [-max_speed, max_speed],
                {"long_name": "of random starts, phase 0: v from, to", "units": SPEED},
            ),
            "start_count": ((), results.file.attractors.starts, {"long_name": "random starts", "units": DIMENSIONLESS}),
        }
    )


def _orbit_dataset(orbits):
    def make_variable(meaning, values, **attrs):
        return "orbit", np.array(values), {"long_name": meaning, **attrs}

    states, multipliers = [orbit.state for orbit in orbits], np.array([orbit.multipliers for orbit in orbits])
    multiplier_header = ("orbit", "multiplier"), {"long_name": "Floquet multipliers, the larger first"}
    return xr.Dataset(
        {
            "orbit_label": make_variable("P n p q: periods, impacts left, right", [orbit.label for orbit in orbits]),
            "orbit_periods": make_variable(
                "least number of drive periods", [orbit.periods for orbit in orbits], units="1"
            ),
            "orbit_itinerary": make_variable(
                "walls hit, a word a period", [" ".join(orbit.itinerary) for orbit in orbits]
            ),
            "orbit_x": make_variable("position of a state on it", [orbit.x for orbit in states], units=LENGTH),
            "orbit_v": make_variable("velocity of that state", [orbit.v for orbit in states], units=SPEED),
            "orbit_phase": make_variable(
                "phase of the drive of that state", [orbit.phase for orbit in states], units=ANGLE
            ),
            "orbit_contact": make_variable("contact of that state", [orbit.contact for orbit in states]),
            "orbit_stable": make_variable(
                "1: both multipliers are smaller than 1", [int(orbit.stable) for orbit in orbits]
            ),
            "orbit_rests": make_variable(
                "1: the mass rests on a wall", [int(orbit.rests) for orbit in orbits], units="1"
            ),
            "orbit_multiplier_real": (
                multiplier_header[0],
                multipliers.real,
                {**multiplier_header[1], "units": DIMENSIONLESS},
            ),
            "orbit_multiplier_imag": (
                multiplier_header[0],
                multipliers.imag,
                {**multiplier_header[1], "units": DIMENSIONLESS},
            ),
            "orbit_least_speed": make_variable(
                "least speed of its impacts", [orbit.least_speed for orbit in orbits], units=SPEED
            ),
            "orbit_least_clearance": make_variable(
                "least distance to a wall at a turning point towards it",
                [orbit.least_clearance for orbit in orbits],
                units=LENGTH,
            ),
            "orbit_residual": make_variable(
                "largest error left in its equations", [orbit.residual for orbit in orbits]
            ),
            "orbit_mirror": make_variable(f"place of its mirror image, {NO_MIRROR}: none", _mirror_indices(orbits)),
        }
    )


def _branch_dataset(branches):
    """Return the points of all branches, one branch after the other, in the variables of a branch's data."""
    parameter, datasets = branches[0].name, [branch.data for branch in branches]

    def concatenate(key):
        dims, attrs = datasets[0][key].dims, datasets[0][key].attrs
        parts = [dataset[key].values for dataset in datasets]
        if len(dims) > 1:
            max_width = max(part.shape[1] for part in parts)
            fill = 0 if parts[0].dtype.kind == "i" else np.nan
            parts = [np.pad(part, ((0, 0), (0, max_width - part.shape[1])), constant_values=fill) for part in parts]
        dim_names = [dim if dim == "multiplier" else f"branch_{dim}" for dim in dims]
        return dim_names, np.concatenate(parts), attrs

    branch_numbers = np.repeat(np.arange(len(branches)), [len(branch) for branch in branches])
    variables = {f"branch_{'value' if key == parameter else key}": concatenate(key) for key in datasets[0]}
    variables["branch_value"][2]["parameter"] = parameter
    variables["branch_number"] = (
        "branch_point",
        branch_numbers,
        {"long_name": "place of the branch among the branches, from 0"},
    )
    for end_index, end in enumerate(("first", "last")):
        reasons = [branch.reasons[end_index] for branch in branches]
        variables[f"branch_{end}_reason"] = "branch", reasons, {"long_name": f"why the branch ends at its {end} point"}
    return xr.Dataset(variables)


def _special_dataset(branches):
    """Return the special points of all branches, ends included."""
    first_rows = np.cumsum([0] + [len(item) for item in branches])
    indexed_points = [(branch_number, item) for branch_number, branch in enumerate(branches) for item in branch.special]
    multipliers = np.array([item.multipliers for _, item in indexed_points])

    def make_variable(meaning, values, **attrs):
        return "special", np.array(values), {"long_name": meaning, **attrs}

    multiplier_header = (
        ("special", "multiplier"),
        {"long_name": "Floquet multipliers, the larger first", "units": DIMENSIONLESS},
    )
    return xr.Dataset(
        {
            "special_kind": make_variable("SN, SB, BP, PD, GR, EP", [item.kind for _, item in indexed_points]),
            "special_value": make_variable("of the parameter", [item.value for _, item in indexed_points]),
            "special_branch": make_variable(
                "place of its branch among the branches", [branch_number for branch_number, _ in indexed_points]
            ),
            "special_point": make_variable(
                "its place along branch_point",
                [first_rows[branch_number] + item.place for branch_number, item in indexed_points],
            ),
            "special_label": make_variable(
                "P n p q: periods, impacts left, right", [item.label for _, item in indexed_points]
            ),
            "special_itinerary": make_variable(
                "walls hit, a word a period", [" ".join(item.itinerary) for _, item in indexed_points]
            ),
            "special_meets": make_variable(
                "orbits that meet there", [" ".join(neighbour_labels(item)) for _, item in indexed_points]
            ),
            "special_multiplier_real": (multiplier_header[0], multipliers.real, multiplier_header[1]),
            "special_multiplier_imag": (multiplier_header[0], multipliers.imag, multiplier_header[1]),
            "special_residual": make_variable(
                "largest error left in its equations", [item.residual for _, item in indexed_points]
            ),
        }
    )


def _locus_dataset(loci):
    """Return the points of all loci, one locus after the other."""
    locus_numbers = np.repeat(np.arange(len(loci)), [len(locus) for locus in loci])
    variables = {
        "locus_number": ("locus_point", locus_numbers, {"long_name": "place of the locus among the loci, from 0"})
    }
    for parameter in loci[0].names:
        values = np.concatenate([locus.data[parameter].values for locus in loci])
        variables[f"locus_{parameter}"] = "locus_point", values, {"long_name": "a parameter"}
    descriptions = {
        "kind": ("SN, PD, SB, GR", [locus.kind for locus in loci]),
        "label": ("P n p q: periods, impacts left, right", [locus.label for locus in loci]),
        "first_reason": ("why the locus ends at its first point", [locus.reasons[0] for locus in loci]),
        "last_reason": ("why the locus ends at its last point", [locus.reasons[1] for locus in loci]),
    }
    variables |= {
        f"locus_{key}": ("locus", entries, {"long_name": meaning}) for key, (meaning, entries) in descriptions.items()
    }
    return xr.Dataset(variables)


def _codim2_dataset(loci):
    """Return the special points of all loci, ends included."""
    first_rows = np.cumsum([0] + [len(item) for item in loci])
    indexed_points = [(locus_number, item) for locus_number, locus in enumerate(loci) for item in locus.special]
    columns = {
        "kind": ("CP, GPD, DSB, GR, GG, RG, SN, PD, SB, EP", [item.kind for _, item in indexed_points]),
        "locus": ("place of its locus among the loci", [locus_number for locus_number, _ in indexed_points]),
        "point": (
            "its place along locus_point",
            [first_rows[locus_number] + item.place for locus_number, item in indexed_points],
        ),
        "label": ("P n p q: periods, impacts left, right", [item.label for _, item in indexed_points]),
        "itinerary": ("walls hit, a word a period", [" ".join(item.itinerary) for _, item in indexed_points]),
        "residual": ("largest error left in its equations", [item.residual for _, item in indexed_points]),
    }
    return xr.Dataset(
        {
            f"codim2_{key}": ("codim2", np.array(entries), {"long_name": meaning})
            for key, (meaning, entries) in columns.items()
        }
    )


def _margin_dataset(margin):
    """Return the nearest point of each kind, and the change of each free parameter."""
    points, names = margin.points, list(margin.free)
    changes = np.array([[point.change[name] for name in names] for point in points]).reshape(len(points), len(names))
    columns = {
        "kind": ("SN, PD, SB, GR", [point.kind for point in points]),
        "distance": ("from the scene, in units of the free numbers", [point.distance for point in points]),
        "status": ("reached, or behind another", [point.status for point in points]),
        "edge": ("what ends the boundary there, if anything does", [point.edge for point in points]),
        "residual": ("largest number left in its equations", [point.residual for point in points]),
    }
    variables = {
        f"near_{key}": ("near", np.array(entries), {"long_name": meaning})
        for key, (meaning, entries) in columns.items()
    }
    variables["near_change"] = ("near", "free"), changes, {"long_name": "of each free number"}
    variables["free_unit"] = "free", list(margin.free.values()), {"long_name": "one unit of each free number"}
    return xr.Dataset(variables, {"free": names})


def _fit_dataset(fit):
    """Return the fitted parameters, their errors and covariance."""
    names = list(fit.values)
    variables = {
        "fit_value": ("fitted", list(fit.values.values()), {"long_name": "of each fitted number"}),
        "fit_sigma": ("fitted", list(fit.sigma.values()), {"long_name": "its standard error, inf: not in the record"}),
        "fit_covariance": (("fitted", "other"), fit.covariance.values, {"long_name": "of the fitted numbers"}),
        "fit_residual": (
            "heard",
            fit.residuals,
            {"long_name": "measured less fitted, in errors", "units": DIMENSIONLESS},
        ),
    }
    return xr.Dataset(variables, {"fitted": names, "other": names}, {"fit_status": fit.status.name})


def _mirror_indices(motions):
    return [NO_MIRROR if motion.mirror_of is None else motion.mirror_of for motion in motions]

"""Convert the results of a run to one Dataset for a NetCDF file."""

import msgspec
import numpy as np
import xarray as xr

from .. import __version__
from ..branches.branch import neighbour_labels
from ..maps.initial_conditions import initial_box
from ..output.units import ANGLE, DIMENSIONLESS, LENGTH, SPEED

NO_MIRROR = -1  # value of `attractor_mirror` and `orbit_mirror` without a mirror image


def make_results_dataset(results):
    """Return a Dataset with all results of a run, except for those of a [map], which are in its store.

    `results` are `StudyResults`. The attribute ``job`` contains the scene file as TOML.
    """
    datasets = [results.swept] if results.swept is not None else []
    datasets += [_attractor_dataset(results), _start_box_dataset(results)] if results.attractors is not None else []
    datasets += [_orbit_dataset(results.orbits)] if results.orbits else []
    datasets += (
        [_branch_dataset(results.branches), _special_point_dataset(results.branches)] if results.branches else []
    )
    datasets += [_locus_dataset(results.loci), _codim2_dataset(results.loci)] if results.loci else []
    datasets += [_margin_dataset(results.margin)] if results.margin is not None else []
    datasets += [_fit_dataset(results.fit)] if results.fit is not None else []
    merged_dataset = xr.merge(datasets, combine_attrs="drop_conflicts")
    dataset_attrs = {
        "title": "jaxvibro run",
        "source": f"jaxvibro {__version__}",
        "job": msgspec.toml.encode(results.file).decode(),
    }
    return merged_dataset.assign_attrs(dataset_attrs)


def _attractor_dataset(results):
    attractors = results.attractors

    def make_variable(long_name, variable_values, **attrs):
        return "attractor", np.array(variable_values), {"long_name": long_name, **attrs}

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


def _start_box_dataset(results):
    """Return the number of random initial states and their ranges of x and v."""
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
    def make_variable(long_name, variable_values, **attrs):
        return "orbit", np.array(variable_values), {"long_name": long_name, **attrs}

    states, multipliers = [orbit.state for orbit in orbits], np.array([orbit.multipliers for orbit in orbits])
    multiplier_dims_attrs = ("orbit", "multiplier"), {"long_name": "Floquet multipliers, the larger first"}
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
                multiplier_dims_attrs[0],
                multipliers.real,
                {**multiplier_dims_attrs[1], "units": DIMENSIONLESS},
            ),
            "orbit_multiplier_imag": (
                multiplier_dims_attrs[0],
                multipliers.imag,
                {**multiplier_dims_attrs[1], "units": DIMENSIONLESS},
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
    """Return the concatenated points of all branches, with the variables of `Branch.data`."""
    parameter_name, branch_datasets = branches[0].name, [branch.data for branch in branches]

    def concatenate_variable(variable_name):
        old_dims, attrs = branch_datasets[0][variable_name].dims, branch_datasets[0][variable_name].attrs
        branch_arrays = [dataset[variable_name].values for dataset in branch_datasets]
        if len(old_dims) > 1:
            max_columns = max(branch_array.shape[1] for branch_array in branch_arrays)
            padding_value = 0 if branch_arrays[0].dtype.kind == "i" else np.nan
            branch_arrays = [
                np.pad(branch_array, ((0, 0), (0, max_columns - branch_array.shape[1])), constant_values=padding_value)
                for branch_array in branch_arrays
            ]
        new_dims = [dim if dim == "multiplier" else f"branch_{dim}" for dim in old_dims]
        return new_dims, np.concatenate(branch_arrays), attrs

    branch_indices = np.repeat(np.arange(len(branches)), [len(branch) for branch in branches])
    variables = {
        f"branch_{'value' if variable_name == parameter_name else variable_name}": concatenate_variable(variable_name)
        for variable_name in branch_datasets[0]
    }
    variables["branch_value"][2]["parameter"] = parameter_name
    variables["branch_number"] = (
        "branch_point",
        branch_indices,
        {"long_name": "place of the branch among the branches, from 0"},
    )
    for end_index, end_name in enumerate(("first", "last")):
        end_reasons = [branch.reasons[end_index] for branch in branches]
        variables[f"branch_{end_name}_reason"] = (
            "branch",
            end_reasons,
            {"long_name": f"why the branch ends at its {end_name} point"},
        )
    return xr.Dataset(variables)


def _special_point_dataset(branches):
    """Return the special points of all branches, including the end points."""
    first_row_of_branch = np.cumsum([0] + [len(branch_or_point) for branch_or_point in branches])
    indexed_points = [
        (branch_index, branch_or_point)
        for branch_index, branch in enumerate(branches)
        for branch_or_point in branch.special
    ]
    multipliers = np.array([branch_or_point.multipliers for _, branch_or_point in indexed_points])

    def make_variable(long_name, variable_values, **attrs):
        return "special", np.array(variable_values), {"long_name": long_name, **attrs}

    multiplier_dims_attrs = (
        ("special", "multiplier"),
        {"long_name": "Floquet multipliers, the larger first", "units": DIMENSIONLESS},
    )
    return xr.Dataset(
        {
            "special_kind": make_variable(
                "SN, SB, BP, PD, GR, EP", [branch_or_point.kind for _, branch_or_point in indexed_points]
            ),
            "special_value": make_variable(
                "of the parameter", [branch_or_point.value for _, branch_or_point in indexed_points]
            ),
            "special_branch": make_variable(
                "place of its branch among the branches", [branch_index for branch_index, _ in indexed_points]
            ),
            "special_point": make_variable(
                "its place along branch_point",
                [
                    first_row_of_branch[branch_index] + branch_or_point.place
                    for branch_index, branch_or_point in indexed_points
                ],
            ),
            "special_label": make_variable(
                "P n p q: periods, impacts left, right",
                [branch_or_point.label for _, branch_or_point in indexed_points],
            ),
            "special_itinerary": make_variable(
                "walls hit, a word a period",
                [" ".join(branch_or_point.itinerary) for _, branch_or_point in indexed_points],
            ),
            "special_meets": make_variable(
                "orbits that meet there",
                [" ".join(neighbour_labels(branch_or_point)) for _, branch_or_point in indexed_points],
            ),
            "special_multiplier_real": (multiplier_dims_attrs[0], multipliers.real, multiplier_dims_attrs[1]),
            "special_multiplier_imag": (multiplier_dims_attrs[0], multipliers.imag, multiplier_dims_attrs[1]),
            "special_residual": make_variable(
                "largest error left in its equations",
                [branch_or_point.residual for _, branch_or_point in indexed_points],
            ),
        }
    )


def _locus_dataset(loci):
    """Return the concatenated points of all loci."""
    locus_indices = np.repeat(np.arange(len(loci)), [len(locus) for locus in loci])
    variables = {
        "locus_number": ("locus_point", locus_indices, {"long_name": "place of the locus among the loci, from 0"})
    }
    for parameter_name in loci[0].names:
        parameter_values = np.concatenate([locus.data[parameter_name].values for locus in loci])
        variables[f"locus_{parameter_name}"] = "locus_point", parameter_values, {"long_name": "a parameter"}
    locus_columns = {
        "kind": ("SN, PD, SB, GR", [locus.kind for locus in loci]),
        "label": ("P n p q: periods, impacts left, right", [locus.label for locus in loci]),
        "first_reason": ("why the locus ends at its first point", [locus.reasons[0] for locus in loci]),
        "last_reason": ("why the locus ends at its last point", [locus.reasons[1] for locus in loci]),
    }
    variables |= {
        f"locus_{column_name}": ("locus", column_values, {"long_name": long_name})
        for column_name, (long_name, column_values) in locus_columns.items()
    }
    return xr.Dataset(variables)


def _codim2_dataset(loci):
    """Return the special points of all loci, including the end points."""
    first_row_of_locus = np.cumsum([0] + [len(locus_or_point) for locus_or_point in loci])
    indexed_points = [
        (locus_index, locus_or_point) for locus_index, locus in enumerate(loci) for locus_or_point in locus.special
    ]
    columns = {
        "kind": (
            "CP, GPD, DSB, GR, GG, RG, SN, PD, SB, EP",
            [locus_or_point.kind for _, locus_or_point in indexed_points],
        ),
        "locus": ("place of its locus among the loci", [locus_index for locus_index, _ in indexed_points]),
        "point": (
            "its place along locus_point",
            [first_row_of_locus[locus_index] + locus_or_point.place for locus_index, locus_or_point in indexed_points],
        ),
        "label": (
            "P n p q: periods, impacts left, right",
            [locus_or_point.label for _, locus_or_point in indexed_points],
        ),
        "itinerary": (
            "walls hit, a word a period",
            [" ".join(locus_or_point.itinerary) for _, locus_or_point in indexed_points],
        ),
        "residual": (
            "largest error left in its equations",
            [locus_or_point.residual for _, locus_or_point in indexed_points],
        ),
    }
    return xr.Dataset(
        {
            f"codim2_{column_name}": ("codim2", np.array(column_values), {"long_name": long_name})
            for column_name, (long_name, column_values) in columns.items()
        }
    )


def _margin_dataset(margin):
    """Return the nearest bifurcation of each kind and the changes of the free parameters that lead to it."""
    near_points, free_names = margin.points, list(margin.free)
    parameter_changes = np.array(
        [[near_point.change[free_name] for free_name in free_names] for near_point in near_points]
    ).reshape(len(near_points), len(free_names))
    columns = {
        "kind": ("SN, PD, SB, GR", [near_point.kind for near_point in near_points]),
        "distance": (
            "from the scene, in units of the free numbers",
            [near_point.distance for near_point in near_points],
        ),
        "status": ("reached, or behind another", [near_point.status for near_point in near_points]),
        "edge": ("what ends the boundary there, if anything does", [near_point.edge for near_point in near_points]),
        "residual": ("largest number left in its equations", [near_point.residual for near_point in near_points]),
    }
    variables = {
        f"near_{column_name}": ("near", np.array(column_values), {"long_name": long_name})
        for column_name, (long_name, column_values) in columns.items()
    }
    variables["near_change"] = ("near", "free"), parameter_changes, {"long_name": "of each free number"}
    variables["free_unit"] = "free", list(margin.free.values()), {"long_name": "one unit of each free number"}
    return xr.Dataset(variables, {"free": free_names})


def _fit_dataset(fit):
    """Return the fitted parameters, their standard errors and covariance, and the residuals."""
    parameter_names = list(fit.values)
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
    return xr.Dataset(variables, {"fitted": parameter_names, "other": parameter_names}, {"fit_status": fit.status.name})


def _mirror_indices(motions):
    return [NO_MIRROR if motion.mirror_of is None else motion.mirror_of for motion in motions]

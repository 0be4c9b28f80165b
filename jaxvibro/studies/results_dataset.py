"""Convert the results of a run to one Dataset for a NetCDF file."""

import msgspec
import numpy as np
import xarray as xr

from .. import __version__
from ..branches.branch import neighbour_labels
from ..maps.initial_conditions import initial_box
from ..output.units import ANGLE, DIMENSIONLESS, LENGTH, SPEED

NO_MIRROR = -1  # value of `attractor_mirror` and `orbit_mirror` without a mirror image
MIRROR_MEANING = f"place of its mirror image, {NO_MIRROR}: none"
LABEL_MEANING = "P n p q: periods, impacts left, right"
MULTIPLIER_MEANING = "Floquet multipliers, the larger first"
ITINERARY_MEANING = "walls hit, a word a period"
RESIDUAL_MEANING = "largest error left in its equations"


def make_results_dataset(results):
    """Return a Dataset with all results of a run, except for those of a [map], which are in its store.

    `results` are `StudyResults`. The attribute ``job`` contains the scene file as TOML.
    """
    datasets = [results.swept] if results.swept is not None else []
    for field_name, make_datasets in _DATASETS_BY_FIELD.items():
        if getattr(results, field_name):
            datasets += [make_dataset(results) for make_dataset in make_datasets]
    merged_dataset = xr.merge(datasets, combine_attrs="drop_conflicts")
    dataset_attrs = {
        "title": "jaxvibro run",
        "source": f"jaxvibro {__version__}",
        "job": msgspec.toml.encode(results.file).decode(),
    }
    return merged_dataset.assign_attrs(dataset_attrs)


def _columns(dimension, columns):
    """Return the variables of columns {name: (long name, values) or (long name, values, unit)} along a dimension.

    The names of the variables begin with the name of the dimension. Values with two dimensions are multipliers.
    """
    variables = {}
    for column_name, (long_name, values, *unit) in columns.items():
        attrs = {"long_name": long_name, "units": unit[0]} if unit else {"long_name": long_name}
        dims = (dimension, "multiplier")[: np.ndim(values)]
        variables[f"{dimension}_{column_name}"] = dims, np.array(values), attrs
    return variables


def _attractor_dataset(results):
    attractors = results.attractors
    share_bounds = np.array([attractor.share_bounds for attractor in attractors])
    columns = {
        "label": (LABEL_MEANING, [attractor.label for attractor in attractors]),
        "share": ("share of the starts", [attractor.share for attractor in attractors]),
        "share_low": ("lowest share that the starts speak for, at 95 %", share_bounds[:, 0], DIMENSIONLESS),
        "share_high": ("highest share that the starts speak for, at 95 %", share_bounds[:, 1], DIMENSIONLESS),
        "periods": ("least number of drive periods, 0: none", [attractor.periods for attractor in attractors]),
        "x": ("position of a state on it, at phase 0", [attractor.state.x for attractor in attractors], LENGTH),
        "v": ("velocity of that state", [attractor.state.v for attractor in attractors], SPEED),
        "contact": ("contact of that state", [attractor.state.contact for attractor in attractors]),
        "rests": ("1: the mass rests on a wall", [int(attractor.rests) for attractor in attractors], DIMENSIONLESS),
        "exponent": ("largest Lyapunov exponent per period", [attractor.exponent for attractor in attractors]),
        "mirror": (MIRROR_MEANING, _mirror_indices(attractors)),
    }
    return xr.Dataset(_columns("attractor", columns))


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


def _orbit_dataset(results):
    orbits = results.orbits
    columns = {
        "label": (LABEL_MEANING, [orbit.label for orbit in orbits]),
        "periods": ("least number of drive periods", [orbit.periods for orbit in orbits], DIMENSIONLESS),
        "itinerary": (ITINERARY_MEANING, [" ".join(orbit.itinerary) for orbit in orbits]),
        "x": ("position of a state on it", [orbit.state.x for orbit in orbits], LENGTH),
        "v": ("velocity of that state", [orbit.state.v for orbit in orbits], SPEED),
        "phase": ("phase of the drive of that state", [orbit.state.phase for orbit in orbits], ANGLE),
        "contact": ("contact of that state", [orbit.state.contact for orbit in orbits]),
        "stable": ("1: both multipliers are smaller than 1", [int(orbit.stable) for orbit in orbits]),
        "rests": ("1: the mass rests on a wall", [int(orbit.rests) for orbit in orbits], DIMENSIONLESS),
        "multiplier_real": (MULTIPLIER_MEANING, [orbit.multipliers.real for orbit in orbits], DIMENSIONLESS),
        "multiplier_imag": (MULTIPLIER_MEANING, [orbit.multipliers.imag for orbit in orbits], DIMENSIONLESS),
        "least_speed": ("least speed of its impacts", [orbit.least_speed for orbit in orbits], SPEED),
        "least_clearance": (
            "least distance to a wall at a turning point towards it",
            [orbit.least_clearance for orbit in orbits],
            LENGTH,
        ),
        "residual": (RESIDUAL_MEANING, [orbit.residual for orbit in orbits]),
        "mirror": (MIRROR_MEANING, _mirror_indices(orbits)),
    }
    return xr.Dataset(_columns("orbit", columns))


def _branch_dataset(results):
    """Return the concatenated points of all branches, with the variables of `Branch.data`."""
    branches = results.branches
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


def _indexed_special_points(curves):
    """Return [(index of the curve, row of the point among the rows of all curves, point)] of branches or loci."""
    first_rows = np.cumsum([0] + [len(curve) for curve in curves])
    return [
        (curve_index, first_rows[curve_index] + special_point.place, special_point)
        for curve_index, curve in enumerate(curves)
        for special_point in curve.special
    ]


def _special_point_dataset(results):
    """Return the special points of all branches, including the end points."""
    branch_indices, rows, points = zip(*_indexed_special_points(results.branches), strict=True)
    columns = {
        "kind": ("SN, SB, BP, PD, GR, EP", [point.kind for point in points]),
        "value": ("of the parameter", [point.value for point in points]),
        "branch": ("place of its branch among the branches", branch_indices),
        "point": ("its place along branch_point", rows),
        "label": (LABEL_MEANING, [point.label for point in points]),
        "itinerary": (ITINERARY_MEANING, [" ".join(point.itinerary) for point in points]),
        "meets": ("orbits that meet there", [" ".join(neighbour_labels(point)) for point in points]),
        "multiplier_real": (MULTIPLIER_MEANING, [point.multipliers.real for point in points], DIMENSIONLESS),
        "multiplier_imag": (MULTIPLIER_MEANING, [point.multipliers.imag for point in points], DIMENSIONLESS),
        "residual": (RESIDUAL_MEANING, [point.residual for point in points]),
    }
    return xr.Dataset(_columns("special", columns))


def _locus_dataset(results):
    """Return the concatenated points of all loci."""
    loci = results.loci
    locus_indices = np.repeat(np.arange(len(loci)), [len(locus) for locus in loci])
    variables = {
        "locus_number": ("locus_point", locus_indices, {"long_name": "place of the locus among the loci, from 0"})
    }
    for parameter_name in loci[0].names:
        parameter_values = np.concatenate([locus.data[parameter_name].values for locus in loci])
        variables[f"locus_{parameter_name}"] = "locus_point", parameter_values, {"long_name": "a parameter"}
    columns = {
        "kind": ("SN, PD, SB, GR", [locus.kind for locus in loci]),
        "label": (LABEL_MEANING, [locus.label for locus in loci]),
        "first_reason": ("why the locus ends at its first point", [locus.reasons[0] for locus in loci]),
        "last_reason": ("why the locus ends at its last point", [locus.reasons[1] for locus in loci]),
    }
    return xr.Dataset(variables | _columns("locus", columns))


def _codim2_dataset(results):
    """Return the special points of all loci, including the end points."""
    locus_indices, rows, points = zip(*_indexed_special_points(results.loci), strict=True)
    columns = {
        "kind": ("CP, GPD, DSB, GR, GG, RG, SN, PD, SB, EP", [point.kind for point in points]),
        "locus": ("place of its locus among the loci", locus_indices),
        "point": ("its place along locus_point", rows),
        "label": (LABEL_MEANING, [point.label for point in points]),
        "itinerary": (ITINERARY_MEANING, [" ".join(point.itinerary) for point in points]),
        "residual": (RESIDUAL_MEANING, [point.residual for point in points]),
    }
    return xr.Dataset(_columns("codim2", columns))


def _margin_dataset(results):
    """Return the nearest bifurcation of each kind and the changes of the free parameters that lead to it."""
    near_points, free_units = results.margin.points, results.margin.free
    parameter_changes = np.array(
        [[near_point.change[free_name] for free_name in free_units] for near_point in near_points]
    ).reshape(len(near_points), len(free_units))
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
    variables = _columns("near", columns)
    variables["near_change"] = ("near", "free"), parameter_changes, {"long_name": "of each free number"}
    variables |= _columns("free", {"unit": ("one unit of each free number", list(free_units.values()))})
    return xr.Dataset(variables, {"free": list(free_units)})


def _fit_dataset(results):
    """Return the fitted parameters, their standard errors and covariance, and the residuals."""
    fit = results.fit
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


# Functions that return the Datasets of each field of `StudyResults`, unless the field is None or empty.
_DATASETS_BY_FIELD = {
    "attractors": (_attractor_dataset, _start_box_dataset),
    "orbits": (_orbit_dataset,),
    "branches": (_branch_dataset, _special_point_dataset),
    "loci": (_locus_dataset, _codim2_dataset),
    "margin": (_margin_dataset,),
    "fit": (_fit_dataset,),
}

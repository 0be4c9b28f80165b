"""Convert the results of a run to CSV tables, in the scene's units or in physical units."""

import numpy as np
import pandas as pd

from ..branches.diagram import branches_dataframe
from ..maps.wall_loads import LOAD_COLUMNS, wall_loads
from ..output.dataframes import make_dataframe
from ..output.units import LENGTH, SPEED, unit_of


def requested_table_names(scene_file):
    """Return the names of the CSV tables for the analyses of a `SceneFile`."""
    return [name for name, (table_name, _, _) in _CSV_TABLES.items() if getattr(scene_file, table_name) is not None]


def csv_table(table_name, results, units):
    """Return the bytes of a CSV table of the results, one row per point; None if there are no points.

    If no attractor was found, the table of attractors has a header only.

    `table_name` is one of the `requested_table_names`. Raises ArgumentError if physical units are requested for a scene
    without scales.
    """
    _, field_name, make_dataframe_of_results = _CSV_TABLES[table_name]
    field_value = getattr(results, field_name)
    if field_value is None or (len(field_value) == 0 and table_name != "attractors"):
        return None
    return make_dataframe_of_results(results, units).to_csv(index=False, lineterminator="\n").encode()


def _sweep_dataframe(results, units):
    parameter_name, sweep_data = results.file.sweep.parameter, results.swept
    x, v, status = (sweep_data[variable_name].values for variable_name in ("x", "v", "status"))
    n_steps, n_legs, n_periods = x.shape
    leg_names = np.broadcast_to(sweep_data["leg"].values[None, :, None], x.shape)
    parameter_values = np.broadcast_to(sweep_data[parameter_name].values.reshape(n_steps, -1, 1), x.shape)
    columns = {
        "leg": ("", leg_names.ravel()),
        parameter_name: (unit_of(parameter_name), parameter_values.ravel()),
        "period": ("", np.tile(np.arange(n_periods), n_steps * n_legs)),
        "x": (LENGTH, x.ravel()),
        "v": (SPEED, v.ravel()),
        "status": ("", np.repeat(status.ravel(), n_periods)),
    }
    wall_load_data = wall_loads(results.scene, sweep_data)
    for side in wall_load_data["wall"].values:
        for load_name in LOAD_COLUMNS:
            load_data = wall_load_data[load_name].sel(wall=side)
            columns[f"{side} {load_name}"] = (load_data.attrs["units"], load_data.values.ravel())
    return make_dataframe(results.scene, columns, units)


def _attractor_dataframe(results, units):
    attractors = results.attractors
    columns = {
        "label": ("", [attractor.label for attractor in attractors]),
        "kind": ("", [attractor.kind for attractor in attractors]),
        "share": ("1", np.array([attractor.share for attractor in attractors])),
        "share_low": ("1", np.array([attractor.share_bounds[0] for attractor in attractors])),
        "share_high": ("1", np.array([attractor.share_bounds[1] for attractor in attractors])),
        "periods": ("", [attractor.periods for attractor in attractors]),
        "x": (LENGTH, np.array([attractor.state.x for attractor in attractors], float)),
        "v": (SPEED, np.array([attractor.state.v for attractor in attractors], float)),
        "exponent": ("1", np.array([attractor.exponent for attractor in attractors], float)),
    }
    return make_dataframe(results.scene, columns, units)


def _branches_dataframe(results, units):
    return branches_dataframe(results.branches, units)


def _loci_dataframe(results, units):
    locus_frames = [locus.to_frame(units) for locus in results.loci]
    for locus_number, (locus_frame, locus) in enumerate(zip(locus_frames, results.loci, strict=True), 1):
        locus_frame.insert(0, "locus", locus_number)
        locus_frame.insert(1, "of", locus.kind)
    return pd.concat(locus_frames, ignore_index=True)


# {name of the CSV table: (table of the scene file, field of `StudyResults`, function of results and units)}.
_CSV_TABLES = {
    "sweep": ("sweep", "swept", _sweep_dataframe),
    "attractors": ("attractors", "attractors", _attractor_dataframe),
    "branches": ("branch_table", "branches", _branches_dataframe),
    "loci": ("locus", "loci", _loci_dataframe),
}

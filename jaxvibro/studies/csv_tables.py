"""Convert the results of a run to CSV tables, in the scene's units or in physical ones."""

import numpy as np
import pandas as pd

from ..branches.diagram import branches_dataframe
from ..maps.wall_loads import LOAD_COLUMNS, wall_loads
from ..output.dataframes import make_dataframe
from ..output.units import LENGTH, SPEED, unit_of


def requested_tables(file):
    """Return the names of the tables that a `SceneFile` requests."""
    tables = {"sweep": file.sweep, "attractors": file.attractors, "branches": file.branch_table, "loci": file.locus}
    return [name for name, table in tables.items() if table is not None]


def csv_tables(results, units):
    """Return {name: CSV bytes} of the sweep, attractors, branches and loci in the results, one row per point.

    Raises ArgumentError for units that the scene does not have.
    """
    tables = {}
    if results.file.sweep is not None:
        tables["sweep"] = _sweep_table(results, units)
    if results.attractors is not None:
        tables["attractors"] = _attractor_table(results, units)
    if results.branches:
        tables["branches"] = branches_dataframe(results.branches, units)
    if results.loci:
        tables["loci"] = _locus_table(results.loci, units)
    return {name: table.to_csv(index=False, lineterminator="\n").encode() for name, table in tables.items()}


def _sweep_table(results, units):
    parameter, sweep_data = results.file.sweep.parameter, results.swept
    x, v, status = (sweep_data[key].values for key in ("x", "v", "status"))
    n_steps, n_legs, n_periods = x.shape
    leg_names = np.broadcast_to(sweep_data["leg"].values[None, :, None], x.shape)
    values = np.broadcast_to(sweep_data[parameter].values.reshape(n_steps, -1, 1), x.shape)
    columns = {
        "leg": ("", leg_names.ravel()),
        parameter: (unit_of(parameter), values.ravel()),
        "period": ("", np.tile(np.arange(n_periods), n_steps * n_legs)),
        "x": (LENGTH, x.ravel()),
        "v": (SPEED, v.ravel()),
        "status": ("", np.repeat(status.ravel(), n_periods)),
    }
    loads = wall_loads(results.scene, sweep_data)
    for side in loads["wall"].values:
        for load_name in LOAD_COLUMNS:
            load = loads[load_name].sel(wall=side)
            columns[f"{side} {load_name}"] = (load.attrs["units"], load.values.ravel())
    return make_dataframe(results.scene, columns, units)


def _attractor_table(results, units):
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


def _locus_table(loci, units):
    frames = [locus.to_frame(units) for locus in loci]
    for number, (locus_frame, locus) in enumerate(zip(frames, loci, strict=True), 1):
        locus_frame.insert(0, "locus", number)
        locus_frame.insert(1, "of", locus.kind)
    return pd.concat(frames, ignore_index=True)

"""What a run found as tables for spreadsheets: {what: a CSV file's bytes}, in the scene's units or in physical ones."""

import numpy as np
import pandas as pd

from ..branches.diagram import frame_of
from ..maps.wall_loads import COLUMNS, wall_loads
from ..output.frames import frame
from ..output.units import LENGTH, SPEED, unit_of


def asked_for(file):
    """Of what a `SceneFile` asks for tables."""
    asked = {"sweep": file.sweep, "attractors": file.attractors, "branches": file.followed, "loci": file.locus}
    return [what for what, table in asked.items() if table is not None]


def csv_tables(found, units):
    """A table each of the sweep, the attractors, the branches and the loci that were `Found`, a row a point.

    Raises ArgumentError for units that the scene cannot be told in.
    """
    tables = {}
    if found.file.sweep is not None:
        tables["sweep"] = _sweep(found, units)
    if found.attractors is not None:
        tables["attractors"] = _attractors(found, units)
    if found.branches:
        tables["branches"] = frame_of(found.branches, units)
    if found.loci:
        tables["loci"] = _loci(found.loci, units)
    return {name: each.to_csv(index=False, lineterminator="\n").encode() for name, each in tables.items()}


def _sweep(found, units):
    name, swept = found.file.sweep.parameter, found.swept
    x, v, status = (swept[key].values for key in ("x", "v", "status"))
    steps, legs, periods = x.shape
    places = np.broadcast_to(swept["leg"].values[None, :, None], x.shape)
    values = np.broadcast_to(swept[name].values.reshape(steps, -1, 1), x.shape)
    columns = {
        "leg": ("", places.ravel()),
        name: (unit_of(name), values.ravel()),
        "period": ("", np.tile(np.arange(periods), steps * legs)),
        "x": (LENGTH, x.ravel()),
        "v": (SPEED, v.ravel()),
        "status": ("", np.repeat(status.ravel(), periods)),
    }
    borne = wall_loads(found.scene, swept)
    for side in borne["wall"].values:
        for what in COLUMNS:
            one = borne[what].sel(wall=side)
            columns[f"{side} {what}"] = (one.attrs["units"], one.values.ravel())
    return frame(found.scene, columns, units)


def _attractors(found, units):
    attractors = found.attractors
    columns = {
        "label": ("", [one.label for one in attractors]),
        "kind": ("", [one.kind for one in attractors]),
        "share": ("1", np.array([one.share for one in attractors])),
        "share_low": ("1", np.array([one.share_bounds[0] for one in attractors])),
        "share_high": ("1", np.array([one.share_bounds[1] for one in attractors])),
        "periods": ("", [one.periods for one in attractors]),
        "x": (LENGTH, np.array([one.state.x for one in attractors], float)),
        "v": (SPEED, np.array([one.state.v for one in attractors], float)),
        "exponent": ("1", np.array([one.exponent for one in attractors], float)),
    }
    return frame(found.scene, columns, units)


def _loci(loci, units):
    frames = [one.to_frame(units) for one in loci]
    for place, (each, one) in enumerate(zip(frames, loci, strict=True), 1):
        each.insert(0, "locus", place)
        each.insert(1, "of", one.kind)
    return pd.concat(frames, ignore_index=True)

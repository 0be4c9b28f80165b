"""Explore the periodic orbits for each value of a second parameter, as a `Study`.

Run diagrams at many values of a second parameter as a `Study`. Each value is one chunk of the study. The diagram of a
value is stored as the bytes of a ZIP archive.
"""

import io
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.branch_segment import EXPIRED_REASON, UNLIMITED, Results, make_limits, partial_result_reason

from ..scene import check
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.scene_parameters import check_parameter_values
from ..scene.scene_table import scene_toml
from ..stores.study import Column, Grid, Store, complete_study, fingerprint_array
from .diagram import Diagram, load_diagram
from .explore import ExplorationRequest, make_exploration_request, run_exploration, seed_orbits_of_requests

MAX_BYTES = 1 << 23  # largest size of a diagram's packed files
ARCHIVE_TIME = (1980, 1, 1, 0, 0, 0)  # constant time stamp, so that equal diagrams give equal bytes


@dataclass(frozen=True)
class DiagramStudy:
    """Study of `explore` at each value of a second parameter.

    Attributes
    ----------
    third : str
        Second parameter.
    values : ndarray
        Values of the second parameter, array of shape (values,).
    requests : tuple of ExplorationRequest
        Request for the exploration at each value.
    """

    third: str
    values: Float[np.ndarray, " values"]
    requests: tuple[ExplorationRequest, ...]

    @cached_property
    def grid(self) -> Grid:
        return Grid({self.third: len(self.values)}, (1,))

    @property
    def columns(self) -> dict[str, Column]:
        size_column = Column(np.dtype(np.int64), -1, {"long_name": "bytes of the diagram's files, packed; -1 not done"})
        return {"size": size_column, "content": Column(np.dtype(np.uint8), 0, {}, {"byte": MAX_BYTES})}

    @cached_property
    def identity(self) -> dict[str, str]:
        first_request = self.requests[0]
        request_fields = {
            "parameter": first_request.name,
            "bounds": repr(first_request.bounds),
            "settings": repr(first_request.settings),
        }
        scene = scene_toml(first_request.scene.replace(**{self.third: float(self.values[0])}))
        max_points = first_request.step_settings["limits"].points
        request_fields |= {} if max_points is None else {"max_points": repr(max_points)}
        return {
            "scene": scene,
            self.third: fingerprint_array(self.values),
            **request_fields,
            "budget": repr(first_request.max_branches),
        }

    @cached_property
    def frame(self) -> xr.Dataset:
        return xr.Dataset(coords={self.third: self.values})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        request = self.requests[number]
        content = pack_diagram(run_exploration(request, seed_orbits_of_requests([request])[0]))
        if len(content) > MAX_BYTES:
            raise ArgumentError(
                "store", f"must be used for diagrams of at most {MAX_BYTES >> 20} MiB each", len(content)
            )
        padded_bytes = np.zeros((1, MAX_BYTES), np.uint8)
        padded_bytes[0, : len(content)] = np.frombuffer(content, np.uint8)
        return {"size": np.array([len(content)]), "content": padded_bytes}, 0


def pack_diagram(diagram: Diagram) -> bytes:
    """Pack the files of a diagram in the bytes of a ZIP archive."""
    buffer = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        diagram.save(folder)
        for file in sorted(Path(folder).iterdir()):
            archive.writestr(zipfile.ZipInfo(file.name, ARCHIVE_TIME), file.read_bytes(), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def unpack_diagram(content: bytes) -> Diagram:
    """Read a diagram from the bytes of a ZIP archive."""
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(folder)
        return load_diagram(folder)


@check.host_only("use strobe or monodromy")
def diagrams(
    scene: Scene,
    name: str,
    bounds: tuple[float, float],
    third: str,
    values: Real[ArrayLike, " values"] | Sequence[float],
    max_period: int = 8,
    seed: int = 0,
    budget: int | None = None,
    largest_step: float = 0.1,
    progress: Callable[[int], object] | None = None,
    store: Store | None = None,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
) -> Results[Diagram]:
    """Explore the periodic orbits for each value of a second parameter.

    Parameters
    ----------
    scene : Scene
        A single scene.
    name : str
        Continuation parameter.
    bounds : tuple of float
        Lower and upper bound of the continuation parameter.
    third : str
        Another parameter of the scene. Its value in the scene is ignored.
    values : array_like
        Values of `third`, at least one, in any order.
    max_period : int, optional
        Largest number of drive periods, as in `explore`.
    seed : int, optional
        Seed of the random starts.
    budget : int, optional
        Number of branches at which the exploration of each diagram stops, as in `explore`.
    largest_step : float, optional
        Largest continuation step.
    progress : callable, optional
        Called with the number of branches of the current diagram, or with the number of completed values if `store` is
        given.
    store : Store, optional
        Store that keeps the diagram of each completed value, so that a later call resumes. Results with and without a
        store are equal up to rounding.
    max_points : int, optional
        Largest number of points of each branch. None is no limit.
    max_seconds : float, optional
        Largest wall-clock time in s for all diagrams. At this time the current diagram ends as in `explore`; with a
        store it is completed. The diagrams of further values have no branches. A later call with the same store
        resumes. None is no limit.

    Returns
    -------
    tuple of Diagram
        One diagram for each value. The attribute ``stopped`` of the tuple is empty, or states that the time limit was
        reached. The ``reason`` of each diagram that this limit ended states the same.

    Raises
    ------
    ArgumentError
        If an argument is invalid. Errors of the store are passed on.

    See Also
    --------
    explore : Explore the periodic orbits of a scene along a parameter.

    Notes
    -----
    The random starts of all values are simulated together, or one value at a time if `store` is given. The values are
    explored one after the other.

    Examples
    --------
    >>> family = jv.diagrams(scene, "amplitude", (1.8, 2.2), "restitution", [0.6, 0.7], max_period=1, budget=1)
    >>> [len(diagram) for diagram in family]
    [1, 1]
    """
    limits = make_limits(max_points, max_seconds, None, check.ArgumentError)
    check.require_single_scene(scene)
    check.require_parameter(name, scene.names, name)
    third_values = check_parameter_values(scene, third, values)
    if third == name:
        raise check.ArgumentError("third", "must differ from name", third)
    scenes = [scene.replace(**{third: value}) for value in third_values]
    requests = [
        make_exploration_request(entry, name, bounds, max_period, seed, budget, largest_step) for entry in scenes
    ]
    request_limits = (
        limits if store is None else replace(UNLIMITED, points=limits.points)
    )  # the bits of a stored diagram do not depend on timing
    requests = [entry._replace(step_settings=entry.step_settings | {"limits": request_limits}) for entry in requests]
    if store is None:
        results = [
            run_exploration(*entry, progress) for entry in zip(requests, seed_orbits_of_requests(requests), strict=True)
        ]
    else:
        study = DiagramStudy(third, third_values, tuple(requests))
        stored_data = complete_study(
            study, store, progress and (lambda store_progress: progress(store_progress.done)), limits
        )
        rows = zip(requests, stored_data["content"].values, stored_data["size"].values, strict=True)
        results = [
            _empty_diagram(request) if n_bytes < 0 else unpack_diagram(row[:n_bytes].tobytes())
            for request, row, n_bytes in rows
        ]
    n_complete = sum(diagram.reason != EXPIRED_REASON for diagram in results)
    return Results(
        results, "" if n_complete == len(results) else partial_result_reason(n_complete, len(results), "values")
    )


def _empty_diagram(request):
    """Make the `Diagram` of a request whose exploration has not started."""
    return Diagram(request.name, request.bounds, request.scene, (), (), False, EXPIRED_REASON, request.settings)

"""Run diagrams at many values of a second parameter as a `Study`.

Each value is a chunk; its diagram is stored as a packed folder.
"""

import io
import tempfile
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Float

from ..scene.check import ArgumentError
from ..scene.scene_table import scene_toml
from ..stores.study import Column, Grid, fingerprint_axis
from .diagram import Diagram, load_diagram
from .explore import ExplorationTask, run_exploration, seed_orbits_of_tasks

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
        Its values, array of shape (values,).
    tasks : tuple of ExplorationTask
        Task of each value.
    """

    third: str
    values: Float[np.ndarray, " values"]
    tasks: tuple[ExplorationTask, ...]

    @cached_property
    def grid(self) -> Grid:
        return Grid({self.third: len(self.values)}, (1,))

    @property
    def columns(self) -> dict[str, Column]:
        size_column = Column(np.dtype(np.int64), -1, {"long_name": "bytes of the diagram's files, packed; -1 not done"})
        return {"size": size_column, "content": Column(np.dtype(np.uint8), 0, {}, {"byte": MAX_BYTES})}

    @cached_property
    def identity(self) -> dict[str, str]:
        first_task = self.tasks[0]
        request_fields = {
            "parameter": first_task.name,
            "bounds": repr(first_task.bounds),
            "settings": repr(first_task.settings),
        }
        scene = scene_toml(first_task.scene.replace(**{self.third: float(self.values[0])}))
        max_points = first_task.step_settings["limits"].points
        request_fields |= {} if max_points is None else {"max_points": repr(max_points)}
        return {
            "scene": scene,
            self.third: fingerprint_axis(self.values),
            **request_fields,
            "budget": repr(first_task.max_branches),
        }

    @cached_property
    def frame(self) -> xr.Dataset:
        return xr.Dataset(coords={self.third: self.values})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        task = self.tasks[number]
        content = pack_diagram(run_exploration(task, seed_orbits_of_tasks([task])[0]))
        if len(content) > MAX_BYTES:
            raise ArgumentError(
                "store", f"must be used for diagrams of at most {MAX_BYTES >> 20} MiB each", len(content)
            )
        padded_bytes = np.zeros((1, MAX_BYTES), np.uint8)
        padded_bytes[0, : len(content)] = np.frombuffer(content, np.uint8)
        return {"size": np.array([len(content)]), "content": padded_bytes}, 0


def pack_diagram(diagram: Diagram) -> bytes:
    """Pack the files of a diagram's folder."""
    buffer = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        diagram.save(folder)
        for file in sorted(Path(folder).iterdir()):
            archive.writestr(zipfile.ZipInfo(file.name, ARCHIVE_TIME), file.read_bytes(), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def unpack_diagram(content: bytes) -> Diagram:
    """Read a diagram from its packed files."""
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(folder)
        return load_diagram(folder)

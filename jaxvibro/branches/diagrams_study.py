"""Run diagrams at many values of a second parameter as a `Study`.

Each value is one chunk of the study. The diagram of a value is stored as the bytes of a ZIP archive.
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
from ..stores.study_protocol import Column, Grid, fingerprint_array
from .diagram import Diagram, load_diagram
from .explore import ExplorationRequest, run_exploration, seed_orbits_of_requests

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

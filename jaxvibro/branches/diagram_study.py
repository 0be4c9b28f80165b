"""Diagrams at many values of another parameter as a `Study`: a value is a chunk, its diagram a packed folder."""

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
from ..scene.scene_table import scene_text
from ..stores.study import Column, Grid, axis_text
from .diagram import Diagram, load_diagram
from .explore import Search, explore_on, settled_on

MOST = 1 << 23  # bytes of a diagram's files, packed
EPOCH = (1980, 1, 1, 0, 0, 0)  # of all files in an archive, whose bytes then do not tell when it was made


@dataclass(frozen=True)
class DiagramStudy:
    """What `explore` gives at each value of another parameter as a `Study`. tasks: of each value."""

    third: str
    values: Float[np.ndarray, " values"]
    tasks: tuple[Search, ...]

    @cached_property
    def grid(self) -> Grid:
        return Grid({self.third: len(self.values)}, (1,))

    @property
    def columns(self) -> dict[str, Column]:
        size = Column(np.dtype(np.int64), -1, {"long_name": "bytes of the diagram's files, packed; -1 not done"})
        return {"size": size, "content": Column(np.dtype(np.uint8), 0, {}, {"byte": MOST})}

    @cached_property
    def identity(self) -> dict[str, str]:
        first = self.tasks[0]
        asked = {"parameter": first.name, "bounds": repr(first.bounds), "settings": repr(first.settings)}
        scene = scene_text(first.scene.replace(**{self.third: float(self.values[0])}))
        points = first.steps["limits"].points
        asked |= {} if points is None else {"max_points": repr(points)}
        return {"scene": scene, self.third: axis_text(self.values), **asked, "budget": repr(first.most)}

    @cached_property
    def frame(self) -> xr.Dataset:
        return xr.Dataset(coords={self.third: self.values})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        task = self.tasks[number]
        content = packed(explore_on(task, settled_on([task])[0]))
        if len(content) > MOST:
            raise ArgumentError("store", f"must be given for diagrams of at most {MOST >> 20} MiB each", len(content))
        whole = np.zeros((1, MOST), np.uint8)
        whole[0, : len(content)] = np.frombuffer(content, np.uint8)
        return {"size": np.array([len(content)]), "content": whole}, 0


def packed(diagram: Diagram) -> bytes:
    """The files of a diagram's folder, packed."""
    held = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        diagram.save(folder)
        for file in sorted(Path(folder).iterdir()):
            archive.writestr(zipfile.ZipInfo(file.name, EPOCH), file.read_bytes(), zipfile.ZIP_DEFLATED)
    return held.getvalue()


def unpacked(content: bytes) -> Diagram:
    """The diagram whose folder's files were packed."""
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(folder)
        return load_diagram(folder)

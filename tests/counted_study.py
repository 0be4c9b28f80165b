"""A study whose chunks cost nothing, or a nap, and leave a line in a file each time that one is computed."""

import os
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
import xarray as xr

from jaxvibro.stores.study_protocol import Column, Grid


@dataclass(frozen=True)
class Counted:
    """rows: chunks, of four cells; nap: seconds a chunk takes; log: a file for their numbers; fails: a chunk that does
    not work; offset: of the numbers."""

    rows: int
    nap: float = 0.0
    log: str = ""
    fails: int = -1
    offset: float = 0.5

    @property
    def grid(self):
        return Grid({"row": self.rows, "column": 4}, (1, 4))

    @property
    def columns(self):
        return {
            "label": Column(np.dtype(np.int32), -1, {"long_name": "row"}),
            "number": Column(np.dtype(np.float64), np.nan, {"units": "1"}, {"pair": 2}),
        }

    @property
    def identity(self):
        return {"scene": f"offset = {self.offset}\nrest = 0", "rows": str(self.rows)}

    @property
    def frame(self):
        return xr.Dataset(
            {"known": ("place", np.arange(3.0))},
            {"row": self.offset + np.arange(self.rows), "column": np.arange(4.0)},
            {"told": "something", "scales": [1.0, 2.0]},
        )

    def compute(self, number, frame):
        assert frame["known"].values[2] == 2.0
        if number == self.fails:
            raise ArithmeticError(f"chunk {number}")
        time.sleep(self.nap)
        if self.log:
            handle = os.open(self.log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
            os.write(handle, f"{number}\n".encode())
            os.close(handle)
        label = np.full((1, 4), number, np.int32)
        return {"label": label, "number": np.stack([self.offset + label, -1.0 * label], -1)}, number % 2


def counts(log):
    """How often each chunk was computed: {number: times}."""
    with open(log) as file:
        return Counter(int(line) for line in file)

"""Properties of the files of results, for every kind of saved record: what is read is what was written, or refused."""

import io
import os
import warnings
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import jax
import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro.loci.locus import DIMENSIONS, build_codim2
from jaxvibro.output.checksums import netcdf_bytes
from tests.kinds import KINDS
from tests.scene_files import refusal
from tests.tiers import generator, of_numbers

SCENE = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
PLANE = {"frequency": (0.1, 9.0), "amplitude": (-9.0, 9.0)}
DAMAGES = 20  # of each sort, of a draw


@dataclass(frozen=True)
class RecordKind:
    """A kind of saved record: from a branch to the record, and what reads it from the path that it was saved to."""

    name: str
    make: Callable
    load: Callable


@cache
def branch_of(number):
    """Return a branch: of the symmetric scene for number 0, with a grazing and a fold, else of a random scene."""
    if number == 0:
        return jv.follow(jv.find_orbit(SCENE, jv.State(0.9, -1.1)), "amplitude", (1.5, 4.0))
    names = list(KINDS)
    for attempt in range(8):
        scene, state = KINDS[names[number % len(names)]].draw_single(8 * number + attempt)
        amplitude = float(scene.amplitude)
        try:
            return jv.follow(jv.find_orbit(scene, state, 1), "amplitude", (0.8 * amplitude, 1.2 * amplitude + 0.1))
        except jv.OrbitError:
            continue
    return branch_of(0)


def make_held(branch):
    """Return the rows of a branch as those of a curve in two parameters along which a number is constant."""
    data = branch.data.assign(frequency=("point", np.linspace(2.0, 2.2, len(branch))))
    data.attrs = {}
    return jv.HeldBranch(tuple(PLANE), "least_speed", 1.25, PLANE, branch.scene, data, branch.reasons)


def make_locus(branch):
    """Return the rows of a branch as those of a locus with a cusp in the middle."""
    held = make_held(branch)
    data = held.data[["frequency", "amplitude", *DIMENSIONS]].assign_attrs(periods=branch.data.sizes["period"])
    rows = (0, "EP"), (len(held) // 2, "CP"), (len(held) - 1, "EP")
    special = tuple(build_codim2(held.scene, "SN", PLANE, data, row, kind, 1e-16) for row, kind in rows)
    return jv.Locus("SN", tuple(PLANE), PLANE, held.scene, data, special, held.reasons)


def make_diagram(branch):
    """Return a diagram of a branch and of a part of it."""
    settings = {"max_period": 1, "seed": 0, "largest_step": 0.1}
    second = replace(branch, reasons=("one", "two"))
    return jv.Diagram(branch.name, branch.bounds, branch.scene, (branch, second), ((0, 1),), True, "done", settings)


@dataclass
class DataFile:
    """The data of a run, which `run` writes among others."""

    data: xr.Dataset

    def save(self, path):
        """Write the file."""
        words = ["a", "bb"] * self.data.sizes["point"]
        path.write_bytes(netcdf_bytes(self.data.assign(word=("point", words[: self.data.sizes["point"]]))))


OWN_KINDS = {
    kind.name: kind
    for kind in (
        RecordKind("branch", lambda branch: branch, jv.load_branch),
        RecordKind("held_branch", make_held, jv.load_held_branch),
        RecordKind("locus", make_locus, jv.load_locus),
        RecordKind("diagram", make_diagram, jv.load_diagram),
        RecordKind("data", lambda branch: DataFile(branch.data), jv.load_data),
    )
}


def files_of(path):
    """Return the files of a saved record, but for parts of files that a stopped process left."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return [file for file in files if not file.name.startswith(".")]


def contents(record):
    """Return all that a record holds, in a form that == compares bit for bit."""
    parts = record.branches if isinstance(record, jv.Diagram) else (record,)
    columns = [
        {name: (column.dims, column.values.astype(float).tobytes()) for name, column in part.data.items()}
        for part in parts
    ]
    leaves, structure = jax.tree.flatten([part.scene for part in (*parts, record)])
    fields = ("name", "names", "bounds", "segments", "reasons", "ends", "kind", "held", "value", "left", "settings")
    values = [{key: str(getattr(part, key)) for key in fields if hasattr(part, key)} for part in (*parts, record)]
    points = [
        (point.kind, str(getattr(point, "value", None)), point.label, str(point.multipliers))
        for part in parts
        for point in getattr(part, "special", ())
    ]
    return columns, structure, [np.float64(leaf).tobytes() for leaf in leaves], values, points, record.table()


@of_numbers
def test_loading(kind, number):
    """The loaded record is the saved one, bit for bit, and so is it saved once more; nothing is overwritten."""
    record = kind.make(branch_of(number))
    with TemporaryDirectory() as folder:
        path, again = Path(folder) / "record", Path(folder) / "again"
        record.save(path)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            loaded = kind.load(path)
        assert contents(loaded) == contents(record) and repr(loaded) == repr(record)
        assert loaded.to_frame().equals(record.to_frame())
        loaded.save(again)
        assert contents(kind.load(again)) == contents(record)
        with pytest.raises(FileExistsError):
            record.save(path)


def check_refusal(load, path, file, content):
    """Check that the record is refused in one line if a file of it has this content."""
    file.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "must be" in refusal(load, path)


@of_numbers
def test_damage(kind, number):
    """A file with a flipped bit, or cut off anywhere, is refused in one line."""
    record, draw = kind.make(branch_of(0)), generator(kind, number)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "record"
        record.save(path)
        for file in files_of(path):
            whole = file.read_bytes()
            checksum = whole.index(b"checksum") + draw.integers(0, 80, DAMAGES)
            for place in [*checksum, *draw.integers(0, len(whole), DAMAGES)]:
                content = bytearray(whole)
                content[place] ^= 1 << draw.integers(8)
                check_refusal(kind.load, path, file, bytes(content))
            for size in [0, 1, 4, 60, len(whole) - 1, *draw.integers(0, len(whole), DAMAGES)]:
                check_refusal(kind.load, path, file, whole[:size])
            file.write_bytes(whole)


class Stopped(BaseException):
    """The process ends here."""


class StopAt:
    """Stop the process, or raise another error, at one of its calls of the system, and at all calls after it."""

    def __init__(self, calls, error=Stopped):
        self.calls, self.error = calls, error

    def count(self):
        """Count a call, and stop if it was the last one."""
        self.calls -= 1
        if self.calls < 0:
            raise self.error

    def wrap(self, function):
        """Return a function that the process may not reach."""

        def wrapped(*arguments, **settings):
            self.count()
            return function(*arguments, **settings)

        return wrapped

    def open(self, path, mode):
        """Open a file of which the last write writes a half."""
        process = self

        class File(io.FileIO):
            def write(self, content):
                super().write(content[: len(content) // 2])
                process.count()
                return super().write(content[len(content) // 2 :])

        return File(path, mode)

    @contextmanager
    def patch(self):
        """Let files be written and renamed by this process."""
        with (
            mock.patch("jaxvibro.output.atomic_files.open", self.open, create=True),
            mock.patch("os.replace", self.wrap(os.replace)),
        ):
            yield


@of_numbers
def test_stopping(kind, number):
    """Wherever the process is stopped while it saves a record over another, one of the two is there, whole."""
    records = [kind.make(part) for part in (branch_of(0), replace(branch_of(0), reasons=("other", "end")))]
    expected, saved = [contents(record) for record in records], set()
    assert expected[0] != expected[1]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "record"
        for calls in range(100):
            records[0].save(path, force=True)
            process = StopAt(calls)
            unlink = mock.patch("pathlib.Path.unlink", process.wrap(Path.unlink))
            with process.patch(), unlink, suppress(Stopped):
                records[1].save(path, force=True)
            saved.add(expected.index(contents(kind.load(path))))
            if process.calls >= 0:
                break
    assert saved == {0, 1} and process.calls >= 0

"""Store studies in Zarr stores (format 3), from which a later run resumes and which xarray can open.

A run may be killed at any moment. A single worker writes each chunk. The files of the chunk are written under temporary
names and then renamed. Finally the worker writes the entry of the chunk in the array `done`, a digest of these files.
The entry shows that the chunk is complete and unchanged. Files alone would not show this, because a chunk of blank
values has no files. The store itself is created under a temporary name and then renamed. A checksum covers its
constant files.

Several processes may share a store. If they create the store at the same time, the store of the first process to finish
remains. The other processes use this store after checking that it belongs to their study. A process that writes a chunk
holds a shared lock on the metadata file of the store. Unfinished files are therefore removed only while no chunk is
being written.
"""

import errno
import hashlib
import json
import os
import shutil
import warnings
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from importlib.metadata import version
from itertools import zip_longest
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr

from .. import __version__
from ..output.atomic_files import create_folder_atomically, lock_file, remove_abandoned_folders
from ..output.checksums import BLANK_CHECKSUM, fill_in_checksum, has_valid_checksum
from ..scene import check
from .engines import Engine, LocalEngine
from .study import Grid, Study, study_size_bytes

FORMAT_NUMBER = 1
DONE_ARRAY, UNDECIDED_ARRAY = "done", "undecided"  # arrays beside the columns, one entry per chunk
NOT_DONE = 0
CHUNK_DIMENSION = "chunk"  # dimension of these arrays
STORE_ATTRIBUTE = "jaxvibro_store"  # attribute that identifies such a store
CHECKSUM_ATTRIBUTE, DIGEST_ATTRIBUTE = (
    "checksum",
    "base",
)  # attributes: checksum of the file that holds them, digest of all other constant files
METADATA_FILE, CHUNK_FOLDER = "zarr.json", "c"  # Zarr's names of an array's description and of the folder of its chunks
PARTIAL_SUFFIX = ".partial"  # suffix of Zarr's unfinished files
VERSIONED_PACKAGES = ("jax", "numpy", "scipy")  # results may differ by rounding between versions


@dataclass(frozen=True)
class Store:
    """Folder that stores the results of a study chunk by chunk, with the engine that computes the chunks.

    Parameters
    ----------
    path : path_like
        Folder of a Zarr store (format 3). The folder is created if it does not exist. If it exists, it must be a store
        of the same study, and the missing chunks are added.
    engine : LocalEngine or DaskEngine, optional
        Execution engine.

    See Also
    --------
    load_store : Load the results of a store.

    Notes
    -----
    The content of a complete store is the same, bit by bit, for every engine and number of workers, with and without
    interruptions. A damaged chunk is reported and recomputed. A partial store can be loaded with `load_store` or opened
    with ``xarray.open_zarr(path, consolidated=False)``.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = jv.Store(f"{folder}/map.zarr")
    ...     data = jv.map_parameters(scene, {"amplitude": [1.5, 2.0]}, quantities="label", store=store)
    >>> data["label"].values.tolist()
    [1000000, 1001001]
    """

    path: str | PathLike[str]
    engine: Engine = field(default_factory=LocalEngine)

    def open(self, study: Study) -> "OpenStore":
        """Open the store for a study, or create the store if it does not exist.

        Damaged chunks are reported by a warning and marked as not computed.

        Parameters
        ----------
        study : Study
            Study to store.

        Returns
        -------
        OpenStore
            Store that is open for the study.

        Raises
        ------
        ArgumentError
            If the folder is not a store of this study, is damaged, or was created with other versions of the packages.
        OSError
            If the folder cannot be created or read.
        """
        store_path = Path(self.path)
        remove_abandoned_folders(store_path)
        if not os.path.lexists(store_path):
            _create_store(store_path, study)
        open_store = OpenStore(str(store_path))
        open_store.require_study(study)
        open_store.remove_unfinished()
        for chunk_number in open_store.damaged_chunks():
            warnings.warn(f"{store_path}: chunk {chunk_number} is damaged and is recomputed", stacklevel=2)
            open_store.mark_not_done(chunk_number)
        return open_store


@dataclass(frozen=True)
class OpenStore:
    """Existing store, opened in any process.

    Parameters
    ----------
    path : str
        Folder of the store.
    """

    path: str

    def __reduce__(self):
        return OpenStore, (self.path,)

    @cached_property
    def group(self) -> zarr.Group:
        """Zarr group of the store, opened for reading and writing.

        Raises ArgumentError if the folder is not a store of jaxvibro or is damaged, and OSError if the folder cannot be
        read.
        """
        store_folder = Path(self.path)
        if not store_folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), self.path)
        os.listdir(store_folder)
        try:
            zarr_group = zarr.open_group(self.path, mode="r+", zarr_format=3)
            description = json.loads(str(zarr_group.attrs[STORE_ATTRIBUTE]))
            format_number, stored_digest = description["format"], zarr_group.attrs[DIGEST_ATTRIBUTE]
        except Exception as error:  # Zarr raises many kinds of error
            raise _store_error(f"must be a store of jaxvibro ({type(error).__name__})", store_folder) from None
        if format_number != FORMAT_NUMBER:
            raise _store_error(f"must be of format {FORMAT_NUMBER}", f"format {format_number} in {store_folder}")
        if not has_valid_checksum(
            (store_folder / METADATA_FILE).read_bytes(), store_folder
        ) or stored_digest != _constant_files_digest(store_folder, description["columns"]):
            raise _store_error("must be unchanged since it was written; its checksum does not match", store_folder)
        return zarr_group

    @cached_property
    def arrays(self) -> dict[str, zarr.Array]:
        """Zarr arrays that the computation fills, by name: the columns, `done` and `undecided`."""
        return {
            array_name: array
            for array_name, array in self.group.arrays()
            if array_name in (*self.description["columns"], DONE_ARRAY, UNDECIDED_ARRAY)
        }

    @cached_property
    def description(self) -> dict[str, Any]:
        """Description of the study in the store: format, identity, versions, columns, sizes, chunk, coords."""
        return json.loads(str(self.group.attrs[STORE_ATTRIBUTE]))

    @cached_property
    def frame(self) -> xr.Dataset:
        """Frame of the study, as it was stored when the store was created."""
        dataset = self._open_dataset().drop_vars([*self.description["columns"], DONE_ARRAY, UNDECIDED_ARRAY]).load()
        dataset.attrs = {
            attribute_name: attribute_value
            for attribute_name, attribute_value in dataset.attrs.items()
            if attribute_name not in (STORE_ATTRIBUTE, CHECKSUM_ATTRIBUTE, DIGEST_ATTRIBUTE)
        }
        return dataset

    def _open_dataset(self):
        return xr.open_zarr(self.path, consolidated=False, chunks=None, decode_cf=False).set_coords(
            self.description["coords"]
        )

    def require_study(self, study: Study) -> None:
        """Raise ArgumentError if the store belongs to another study or to other versions of the packages."""
        stored_description, study_description = self.description, _describe_store(study)
        for field_name, study_value in study_description["identity"].items():
            stored_value = stored_description["identity"].get(field_name)
            if stored_value != study_value:
                raise _store_error(
                    f"must hold this study: {field_name} differs", _first_difference_text(stored_value, study_value)
                )
        for field_name in ("identity", "columns", "sizes", "chunk"):
            if stored_description[field_name] != study_description[field_name]:
                raise _store_error(f"must hold this study: {field_name} differs", stored_description[field_name])
        self._require_versions()

    def _require_versions(self):
        """Raise ArgumentError if the store was created with other versions of the packages."""
        stored_versions = self.description["versions"]
        for package_name, current_version in _current_versions().items():
            if stored_versions.get(package_name) != current_version:
                rule = "must be resumed with the versions that began it, since results differ by rounding"
                raise _store_error(rule, f"{package_name} {stored_versions.get(package_name)}, now {current_version}")

    def remove_unfinished(self) -> None:
        """Remove the unfinished files of killed processes, unless another process is writing a chunk."""
        with lock_file(Path(self.path, METADATA_FILE), shared=False) as has_lock:
            for partial_file in Path(self.path).rglob(f"*{PARTIAL_SUFFIX}") if has_lock else ():
                partial_file.unlink(missing_ok=True)

    def undecided_counts(self) -> dict[int, int]:
        """Return {chunk number: number of undecided cells} for the completed chunks."""
        done_chunk_numbers, undecided_by_chunk = (
            np.flatnonzero(self._read_entries(DONE_ARRAY) != NOT_DONE),
            self._read_entries(UNDECIDED_ARRAY),
        )
        return {chunk_number: int(undecided_by_chunk[chunk_number]) for chunk_number in done_chunk_numbers.tolist()}

    def _read_entries(self, array_name):
        """Return the entries of all chunks in the array `done` or `undecided`; 0 for missing or unreadable entries."""
        array, chunk_folder = self.arrays[array_name], Path(self.path, array_name, CHUNK_FOLDER)
        chunk_entries = np.full(array.shape, NOT_DONE, array.dtype)
        stored_numbers = (
            [int(file_name) for file_name in os.listdir(chunk_folder) if file_name.isdecimal()]
            if chunk_folder.is_dir()
            else []
        )
        valid_numbers = sorted(chunk_number for chunk_number in stored_numbers if chunk_number < len(chunk_entries))
        try:
            chunk_entries[valid_numbers] = array.get_orthogonal_selection(valid_numbers) if valid_numbers else []
        except Exception:  # a damaged file; Zarr's codecs raise many kinds of error
            chunk_entries[valid_numbers] = [
                self._read_entry(array_name, chunk_number) for chunk_number in valid_numbers
            ]
        return chunk_entries

    def _read_entry(self, array_name, chunk_number):
        """Return the entry of a chunk in the array `done` or `undecided`; 0 if it is missing or unreadable."""
        try:
            return np.asarray(self.arrays[array_name][chunk_number : chunk_number + 1])[0]
        except Exception:  # as above
            return NOT_DONE

    def undecided_count(self, chunk_number: int) -> int | None:
        """Return the number of undecided cells of a completed chunk; None for other chunks."""
        return (
            int(self._read_entry(UNDECIDED_ARRAY, chunk_number))
            if self._read_entry(DONE_ARRAY, chunk_number) != NOT_DONE
            else None
        )

    def put(self, chunk_number: int, chunk_columns: dict[str, np.ndarray], n_undecided: int) -> None:
        """Store a chunk and write its entry in `done` last.

        Raises ArgumentError if this process uses other versions of the packages than the store.
        """
        self._require_versions()
        chunk_slices = self.grid.chunk_slices(chunk_number)
        with lock_file(Path(self.path, METADATA_FILE), shared=True):
            for column_name in self.description["columns"]:
                self.arrays[column_name][chunk_slices] = chunk_columns[column_name]
            self.arrays[UNDECIDED_ARRAY][chunk_number : chunk_number + 1] = n_undecided
            self.arrays[DONE_ARRAY][chunk_number : chunk_number + 1] = self._chunk_digest(chunk_number)

    def mark_not_done(self, chunk_number: int) -> None:
        """Mark a chunk as not computed."""
        with lock_file(Path(self.path, METADATA_FILE), shared=True):
            self.arrays[DONE_ARRAY][chunk_number : chunk_number + 1] = NOT_DONE

    @cached_property
    def grid(self) -> Grid:
        """Grid of the cells."""
        return Grid(self.description["sizes"], tuple(self.description["chunk"]))

    def damaged_chunks(self) -> list[int]:
        """Return the numbers of the chunks whose files have changed since they were marked as done."""
        stored_digests = self._read_entries(DONE_ARRAY)
        return [
            chunk_number
            for chunk_number in np.flatnonzero(stored_digests).tolist()
            if self._chunk_digest(chunk_number) != stored_digests[chunk_number]
        ]

    def _chunk_digest(self, chunk_number):
        """Return the digest of the files of a chunk and of its number of undecided cells."""
        chunk_indices, sha256 = np.unravel_index(chunk_number, self.grid.chunk_counts), hashlib.sha256()
        for column_name, n_extra_axes in self.description["columns"].items():
            chunk_path = Path(self.path, column_name, CHUNK_FOLDER, *map(str, chunk_indices), *["0"] * n_extra_axes)
            file_content = chunk_path.read_bytes() if chunk_path.exists() else b""
            sha256.update(f"{column_name} {chunk_number} {len(file_content)} ".encode() + file_content)
        sha256.update(f"{self._read_entry(UNDECIDED_ARRAY, chunk_number)}".encode())
        return np.frombuffer(sha256.digest()[:8], "<u8")[0] | np.uint64(1)

    def data(self) -> xr.Dataset:
        """Return the frame with the columns of all cells; cells that are not computed are blank.

        Raises ArgumentError if a chunk is damaged.
        """
        damaged_numbers = self.damaged_chunks()
        if damaged_numbers:
            further_count_text = f" and {len(damaged_numbers) - 1} more" if len(damaged_numbers) > 1 else ""
            rule = "must be undamaged; run the study again to recompute damaged chunks"
            raise _store_error(rule, f"chunk {damaged_numbers[0]}{further_count_text} of {self.path}")
        dataset = self._open_dataset()[list(self.description["columns"])].load()
        return self.frame.assign(
            {column_name: dataset[column_name].variable for column_name in self.description["columns"]}
        )


@check.host_only("use data that were loaded before")
def load_store(path: str | PathLike[str]) -> xr.Dataset:
    """Load the results of a store, complete or partial, after checking its checksums.

    Parameters
    ----------
    path : path_like
        Folder of the store.

    Returns
    -------
    xarray.Dataset
        Results of the study. Cells that are not computed are blank: -1 or 0 for integers, depending on the variable,
        and nan for other numbers. The attributes are those of the study, and the numbers of chunks ``chunks`` and
        ``chunks_done``.

    Raises
    ------
    ArgumentError
        If the folder is not a store of jaxvibro, or is damaged.
    OSError
        If the folder cannot be read.

    See Also
    --------
    Store : Folder that keeps a study.

    Notes
    -----
    Use ``xarray.open_zarr(path, consolidated=False)`` to open a store that is larger than memory or is being filled.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = jv.Store(f"{folder}/map.zarr")
    ...     data = jv.map_parameters(scene, {"amplitude": [1.5, 2.0]}, quantities="label", store=store)
    ...     loaded = jv.load_store(store.path)
    >>> loaded["label"].values.tolist(), loaded.attrs["chunks_done"] == loaded.attrs["chunks"]
    ([1000000, 1001001], True)
    """
    open_store = OpenStore(str(path))
    return open_store.data().assign_attrs(
        chunks=open_store.grid.n_chunks, chunks_done=len(open_store.undecided_counts())
    )


def _describe_store(study):
    """Return the description that identifies a study in its store."""
    n_extra_dims_by_column = {column_name: len(column.more) for column_name, column in study.columns.items()}
    description = {"format": FORMAT_NUMBER, "identity": dict(study.identity), "columns": n_extra_dims_by_column}
    description |= {
        "versions": _current_versions(),
        "sizes": dict(study.grid.sizes),
        "chunk": list(study.grid.chunk_shape),
    }
    return description | {"coords": [str(column_name) for column_name in study.frame.coords]}


@lru_cache
def _current_versions():
    """Return the versions of jaxvibro and of the packages on which the results depend bit by bit."""
    return {"jaxvibro": __version__} | {package_name: version(package_name) for package_name in VERSIONED_PACKAGES}


def _create_store(store_path, study):
    """Create a store without computed chunks under a temporary name, then rename it."""
    if not store_path.parent.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(store_path.parent))
    n_bytes, n_free_bytes = study_size_bytes(study), shutil.disk_usage(store_path.parent).free
    if n_bytes > n_free_bytes:
        description = f"not enough space for up to {n_bytes / 2**30:.3g} GiB; {n_free_bytes / 2**30:.3g} GiB are free"
        raise OSError(errno.ENOSPC, description, str(store_path))
    with create_folder_atomically(store_path) as temporary_folder:
        variable_encodings = {name: {"_FillValue": None} for name in study.frame.variables}
        study.frame.to_zarr(temporary_folder, mode="w-", consolidated=False, zarr_format=3, encoding=variable_encodings)
        zarr_group, grid = zarr.open_group(str(temporary_folder), mode="r+", zarr_format=3), study.grid
        for name, column in study.columns.items():
            zarr_group.create_array(
                name,
                shape=(*grid.shape, *column.more.values()),
                chunks=(*grid.chunk_shape, *column.more.values()),
                dtype=column.dtype,
                fill_value=column.blank,
                dimension_names=(*grid.sizes, *column.more),
                attributes=dict(column.attrs),
            )
        for name, dtype in ((DONE_ARRAY, np.uint64), (UNDECIDED_ARRAY, np.int32)):
            array_options = {"shape": (grid.n_chunks,), "chunks": (1,), "dimension_names": (CHUNK_DIMENSION,)}
            zarr_group.create_array(name, dtype=dtype, fill_value=NOT_DONE, compressors=None, **array_options)
        description = _describe_store(study)
        zarr_group.attrs.update(
            {
                STORE_ATTRIBUTE: json.dumps(description),
                DIGEST_ATTRIBUTE: _constant_files_digest(temporary_folder, description["columns"]),
                CHECKSUM_ATTRIBUTE: BLANK_CHECKSUM,
            }
        )
        (temporary_folder / METADATA_FILE).write_bytes(
            fill_in_checksum((temporary_folder / METADATA_FILE).read_bytes())
        )


def _constant_files_digest(store_folder, column_names):
    """Return a digest of the files of a store that do not change during the computation."""
    sha256, mutable_array_names = hashlib.sha256(), {*column_names, DONE_ARRAY, UNDECIDED_ARRAY}
    for array_folder in sorted(folder_entry for folder_entry in store_folder.iterdir() if folder_entry.is_dir()):
        all_array_files = sorted(folder_entry for folder_entry in array_folder.rglob("*") if folder_entry.is_file())
        for file_path in (
            [array_folder / METADATA_FILE] if array_folder.name in mutable_array_names else all_array_files
        ):
            sha256.update(
                f"{file_path.relative_to(store_folder)} {file_path.stat().st_size} ".encode() + file_path.read_bytes()
            )
    return sha256.hexdigest()


def _first_difference_text(stored_text, study_text):
    """Describe the first line in which two texts differ, for an error message."""
    line_pairs = zip_longest(str(stored_text).splitlines(), str(study_text).splitlines())
    stored_line, study_line = next(
        (line_pair for line_pair in line_pairs if line_pair[0] != line_pair[1]), (stored_text, study_text)
    )
    return f"{check.shorten_text(stored_line)} stored, {check.shorten_text(study_line)} requested"


def _store_error(rule, value):
    """Return the ArgumentError for an invalid store."""
    return check.ArgumentError("store", rule, check.shorten_text(value))

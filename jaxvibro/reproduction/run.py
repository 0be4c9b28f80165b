"""Recompute the paper: each figure from its scene file, and the report of all results."""

import hashlib
import json
import multiprocessing
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path

import jax

from .. import __version__
from ..output.atomic_write import atomic_file, require_writable_folder
from ..output.checksums import HEADER_ATTRIBUTES, has_valid_checksum, netcdf_bytes, seal, sha256_hex
from ..scene import check
from ..studies import scene_file
from .claim import Claim
from .figures import JOBS
from .panels import FigureResult
from .report import html_page, markdown_text, verdict_counts

ROOT = Path(__file__).parents[1]
REPORT_NAME = "report"


@dataclass(frozen=True)
class Report:
    """Report that `paper` wrote.

    Attributes
    ----------
    page : Path
        Path of the report as HTML.
    text : Path
        Path of the report as Markdown.
    claims : tuple of Claim
        Claims in the report.
    told : str
        Number of claims with each verdict, in a sentence.
    """

    page: Path
    text: Path
    claims: tuple[Claim, ...]
    told: str


@check.check_types
def paper(
    names: str | Sequence[str] = (),
    out: str | PathLike[str] = "out/paper",
    scenes: str | PathLike[str] | None = None,
    force: bool = False,
    progress: bool = False,
    workers: int = 1,
) -> Report:
    """Recompute figures and claims of Cheng and Xu (2007) and write them into a folder.

    The folder receives ``NAME.png``, ``NAME.json`` with the claims and the data as NetCDF for each figure, and
    ``report.html`` and ``report.md`` for all figures in the folder. A figure that was computed with the same scene
    files and the same program is kept, so that an interrupted run resumes.

    Parameters
    ----------
    names : str or sequence of str, optional
        Figures, for example ``"fig4"``. All figures by default.
    out : str or path-like, optional
        Folder of the results, created if necessary.
    scenes : str or path-like, optional
        Folder of the scene files. None takes those of the package.
    force : bool, optional
        Recompute figures that exist already.
    progress : bool, optional
        Show progress bars on stderr; with several workers, one line per figure.
    workers : int, optional
        Number of figures that are computed at the same time, each in its own process if there are several. A script
        that uses more than one must be importable, as for `multiprocessing`.

    Returns
    -------
    Report
        Paths of the report, and its claims.

    Raises
    ------
    ArgumentError
        If a name is unknown, `workers` is not a whole number from 1 on, or a scene file is invalid.
    OSError
        If a file cannot be read or written.

    See Also
    --------
    run : Run the analyses in a scene file.

    References
    ----------
    Cheng and Xu, Mechanics Based Design of Structures and Machines 35 (2007) 179-203.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     report = jv.paper(["fig9"], out=folder)
    >>> report.page.name
    'report.html'
    """
    workers = check.whole_number("workers", workers, 1)
    out, folder = Path(out), _default_folder() if scenes is None else Path(scenes)
    names = check.name_tuple("names", names) or tuple(JOBS)
    for name in names:
        if name not in JOBS:
            raise check.ArgumentError("figure", f"must be one of those known{check.describe_choices(name, JOBS)}", name)
    for name in names:
        _read_files(folder, name)
    keys = {name: _content_key(folder, JOBS[name].files) for name in JOBS if _files_exist(folder, JOBS[name].files)}
    require_writable_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    due_names = [name for name in names if force or _load_result(out, name, keys[name]) is None]
    tasks = [(name, folder, out, keys[name], progress and workers == 1) for name in due_names]
    for position, (name, seconds) in enumerate(_run_tasks(tasks, workers), 1):
        if progress:
            print(f"{name}: {seconds:.1f} s ({position} of {len(due_names)})", file=sys.stderr, flush=True)
    return _write_report(out, keys)


def _read_files(folder, name):
    return [scene_file.read(folder / f"{file_name}.toml") for file_name in JOBS[name].files]


def _run_tasks(tasks, workers):
    """Yield the result of `_compute_figure` for each task, in this process or in order of completion from several."""
    if workers == 1 or len(tasks) < 2:
        yield from (_compute_figure(*task) for task in tasks)
        return
    context = multiprocessing.get_context("spawn")  # threads of jax do not survive a fork
    with ProcessPoolExecutor(workers, context, _set_precision, (jax.config.jax_enable_x64,)) as pool:
        futures = [pool.submit(_compute_figure, *task) for task in tasks]
        try:
            yield from (future.result() for future in as_completed(futures))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _set_precision(double_precision):
    """Set the precision of a new process to that of this one."""
    jax.config.update("jax_enable_x64", double_precision)


def _compute_figure(name, folder, out, key, progress):
    """Compute a figure, write its files, and return (its name, the time in s)."""
    start_time = time.perf_counter()
    if progress:
        print(name, file=sys.stderr, flush=True)
    _save_result(out, name, key, JOBS[name].reproduce(*_read_files(folder, name), progress=progress))
    return name, time.perf_counter() - start_time


def _default_folder():
    """Return the folder of the scene files: inside an installed package, or beside the package in a checkout."""
    package_folder = ROOT / "scenes"
    return package_folder if package_folder.is_dir() else ROOT.parent / "scenes"


def _files_exist(folder, names):
    return all((folder / f"{name}.toml").is_file() for name in names)


def _content_key(folder, names):
    """Return a hash of the scene files and the program, which identifies a computation."""
    sha256 = hashlib.sha256(__version__.encode())
    sources = [source for package in (ROOT, ROOT.parent / "continuation") for source in sorted(package.rglob("*.py"))]
    for path in [*(folder / f"{name}.toml" for name in names), *sources]:
        sha256.update(path.read_bytes())
    return sha256.hexdigest()


def _save_result(out, name, key, result):
    """Write the files of a figure, the claims last, with the SHA-256 of the others, as a mark of completion."""
    files = {f"{name}{suffix}.nc": netcdf_bytes(data) for suffix, data in result.data.items()}
    if result.picture is not None:
        files[f"{name}.png"] = result.picture
    claims = [asdict(claim) | {"verdict": claim.verdict} for claim in result.claims]
    digests = {file_name: sha256_hex(content) for file_name, content in files.items()}
    record = HEADER_ATTRIBUTES | {"key": key, "caption": result.caption, "files": digests, "claims": claims}
    files[f"{name}.json"] = seal(json.dumps(record, indent=1).encode())
    for file_name, content in files.items():
        with atomic_file(out / file_name, overwrite=True) as file:
            file.write(content)


def _load_result(out, name, key):
    """Return the `FigureResult` of an earlier run with this key, without its data; None if missing or damaged."""
    try:
        content = (out / f"{name}.json").read_bytes()
        record = json.loads(content) if has_valid_checksum(content, name) else {"key": None}
        if record["key"] != key:
            return None
        files = {file_name: (out / file_name).read_bytes() for file_name in record["files"]}
        if any(
            sha256_hex(files[file_name]) != expected_digest for file_name, expected_digest in record["files"].items()
        ):
            return None
        claims = [
            Claim(**{key: value for key, value in claim.items() if key != "verdict"}) for claim in record["claims"]
        ]
        return FigureResult(files.get(f"{name}.png"), record["caption"], tuple(claims))
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _write_report(out, keys):
    """Write the report of all results in the folder and return the `Report`."""
    results = {name: _load_result(out, name, key) for name, key in keys.items()}
    entries = [(name, result) for name, result in results.items() if result is not None]
    titled_results = [(JOBS[name].title, result) for name, result in entries]
    named_results = [(JOBS[name].title, f"{name}.png" if result.picture else None, result) for name, result in entries]
    for suffix, content in ((".html", html_page(titled_results)), (".md", markdown_text(named_results))):
        with atomic_file(out / f"{REPORT_NAME}{suffix}", overwrite=True) as file:
            file.write(content.encode())
    claims = [claim for _, result in entries for claim in result.claims]
    return Report(out / f"{REPORT_NAME}.html", out / f"{REPORT_NAME}.md", tuple(claims), verdict_counts(claims))

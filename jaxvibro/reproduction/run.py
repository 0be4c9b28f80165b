"""Recomputes the paper: each figure from its scene file, and the report of all that is there."""

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
    """What `paper` wrote. page, text: the paths of the report; claims: all that are in it; told: a sentence on them."""

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
    """Recomputes figures and claims of the paper and writes them into a folder: a `Report`.

    names: of `figures.JOBS`, all where none is given. out: the folder, made where it is missing; it holds NAME.png and
    NAME.json (the claims) of each, its data as NetCDF, and report.html and report.md of all that is there. scenes: the
    folder of the scene files, by default those that come with the package. What is there already, of the same scene
    files and program, is kept unless force is given: so an interrupted run goes on where it stopped. progress: show
    bars on stderr, with several workers lines alone. workers: so many figures at once, each in a process of its own
    where it is more than one; a script that asks for them has to be one that may be imported (`multiprocessing`).

    Raises ArgumentError for a name that is none, workers that are no whole number from 1 on and scene files that break
    a rule, OSError where a file cannot be read or written.
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
    """What `_compute_figure` gives of each task, in this process or, as they are done, in some of their own."""
    if workers == 1 or len(tasks) < 2:
        yield from (_compute_figure(*task) for task in tasks)
        return
    context = multiprocessing.get_context("spawn")  # jax's threads do not live through a fork
    with ProcessPoolExecutor(workers, context, _set_precision, (jax.config.jax_enable_x64,)) as pool:
        futures = [pool.submit(_compute_figure, *task) for task in tasks]
        try:
            yield from (future.result() for future in as_completed(futures))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _set_precision(double_precision):
    """A new process computes in the precision of this one."""
    jax.config.update("jax_enable_x64", double_precision)


def _compute_figure(name, folder, out, key, progress):
    """(the name of a figure, how long it took), its files written."""
    start_time = time.perf_counter()
    if progress:
        print(name, file=sys.stderr, flush=True)
    _save_result(out, name, key, JOBS[name].reproduce(*_read_files(folder, name), progress=progress))
    return name, time.perf_counter() - start_time


def _default_folder():
    """The folder of the scene files: in the package where it was installed, beside it in a checkout."""
    package_folder = ROOT / "scenes"
    return package_folder if package_folder.is_dir() else ROOT.parent / "scenes"


def _files_exist(folder, names):
    return all((folder / f"{name}.toml").is_file() for name in names)


def _content_key(folder, names):
    """What tells one computation from another: the scene files' and the program's text."""
    sha256 = hashlib.sha256(__version__.encode())
    sources = [source for package in (ROOT, ROOT.parent / "continuation") for source in sorted(package.rglob("*.py"))]
    for path in [*(folder / f"{name}.toml" for name in names), *sources]:
        sha256.update(path.read_bytes())
    return sha256.hexdigest()


def _save_result(out, name, key, result):
    """Writes what was computed, its claims last: they tell that all is there, by the SHA-256 of each other file."""
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
    """The `FigureResult` of an earlier run with the same key, without its data; None where there is none, or a file is
    not as it was written."""
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
    """Writes the report of all that is there: the `Report`."""
    results = {name: _load_result(out, name, key) for name, key in keys.items()}
    entries = [(name, result) for name, result in results.items() if result is not None]
    titled_results = [(JOBS[name].title, result) for name, result in entries]
    named_results = [(JOBS[name].title, f"{name}.png" if result.picture else None, result) for name, result in entries]
    for suffix, content in ((".html", html_page(titled_results)), (".md", markdown_text(named_results))):
        with atomic_file(out / f"{REPORT_NAME}{suffix}", overwrite=True) as file:
            file.write(content.encode())
    claims = [claim for _, result in entries for claim in result.claims]
    return Report(out / f"{REPORT_NAME}.html", out / f"{REPORT_NAME}.md", tuple(claims), verdict_counts(claims))

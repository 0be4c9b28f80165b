"""Recompute the paper: compute each figure from its scene files and write the report of all results."""

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
from ..output.atomic_files import atomic_file, require_writable_folder
from ..output.checksums import HEADER_ATTRIBUTES, fill_in_checksum, has_valid_checksum, netcdf_bytes, sha256_hex
from ..scene import check
from ..studies import scene_file
from .claim import Claim, report_html, report_markdown, verdict_counts_text
from .figure_jobs import JOBS
from .figure_panels import FigureResult, figure_style

ROOT = Path(__file__).parents[1]
REPORT_NAME = "report"


@dataclass(frozen=True)
class Report:
    """Report written by `paper`.

    Attributes
    ----------
    page : Path
        Path of the report as HTML.
    text : Path
        Path of the report as Markdown.
    claims : tuple of Claim
        Claims in the report.
    told : str
        Number of claims with each verdict, as text.
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

    For each figure the folder receives ``NAME.png``, the claims in ``NAME.json`` and, for some figures, the data as
    NetCDF. ``report.html`` and ``report.md`` describe all up-to-date figures in the folder. A figure is not recomputed
    if its files are intact and its scene files and the program have not changed. An interrupted run therefore resumes.

    Parameters
    ----------
    names : str or sequence of str, optional
        Names of figures, for example ``"fig4"``, or ``"walls"`` or ``"formulas"``. All of these by default.
    out : str or path-like, optional
        Folder of the results, created if necessary.
    scenes : str or path-like, optional
        Folder of the scene files. None uses those of the package.
    force : bool, optional
        Recompute figures that exist already.
    progress : bool, optional
        Show progress bars on stderr; with several workers, one line per figure.
    workers : int, optional
        Number of figures that are computed at the same time. Several figures are computed in separate processes. A
        script that uses several workers must be importable, as for `multiprocessing`.

    Returns
    -------
    Report
        Paths of the report, and its claims.

    Raises
    ------
    ArgumentError
        If a name is unknown, `workers` is not a positive integer, or a scene file is invalid.
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
    workers = check.check_whole_number("workers", workers, 1)
    out, scenes_folder = Path(out), _default_scenes_folder() if scenes is None else Path(scenes)
    names = check.make_name_tuple("names", names) or tuple(JOBS)
    for figure_name in names:
        if figure_name not in JOBS:
            raise check.ArgumentError(
                "figure", f"must be one of those known{check.describe_choices(figure_name, JOBS)}", figure_name
            )
    for figure_name in names:
        _read_scene_files(scenes_folder, figure_name)
    content_keys = {
        figure_name: _content_key(scenes_folder, job.files)
        for figure_name, job in JOBS.items()
        if all((scenes_folder / f"{file_name}.toml").is_file() for file_name in job.files)
    }
    require_writable_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    names_to_compute = [
        figure_name
        for figure_name in names
        if force or _load_result(out, figure_name, content_keys[figure_name]) is None
    ]
    figure_tasks = [
        (figure_name, scenes_folder, out, content_keys[figure_name], progress and workers == 1)
        for figure_name in names_to_compute
    ]
    for position, (figure_name, elapsed_seconds) in enumerate(_run_tasks(figure_tasks, workers), 1):
        if progress:
            print(
                f"{figure_name}: {elapsed_seconds:.1f} s ({position} of {len(names_to_compute)})",
                file=sys.stderr,
                flush=True,
            )
    return _write_report(out, content_keys)


def _read_scene_files(scenes_folder, figure_name):
    return [scene_file.read_scene_file(scenes_folder / f"{file_name}.toml") for file_name in JOBS[figure_name].files]


def _run_tasks(figure_tasks, n_workers):
    """Yield the result of `_compute_figure` for each task, in order of completion.

    With one worker or one task, the tasks run in this process, otherwise in several processes.
    """
    if n_workers == 1 or len(figure_tasks) < 2:
        yield from (_compute_figure(*figure_task) for figure_task in figure_tasks)
        return
    process_context = multiprocessing.get_context("spawn")  # threads of jax do not survive a fork
    with ProcessPoolExecutor(
        n_workers, process_context, _set_jax_precision, (jax.config.jax_enable_x64,)
    ) as process_pool:
        futures = [process_pool.submit(_compute_figure, *figure_task) for figure_task in figure_tasks]
        try:
            yield from (future.result() for future in as_completed(futures))
        except BaseException:
            process_pool.shutdown(wait=False, cancel_futures=True)
            raise


def _set_jax_precision(use_x64):
    """Set the floating-point precision of JAX in a worker process."""
    jax.config.update("jax_enable_x64", use_x64)


def _compute_figure(figure_name, scenes_folder, output_folder, key, show_progress):
    """Compute a figure and write its files; return (name, computation time in s)."""
    start_time = time.perf_counter()
    if show_progress:
        print(figure_name, file=sys.stderr, flush=True)
    scene_files = _read_scene_files(scenes_folder, figure_name)
    with figure_style():
        figure_result = JOBS[figure_name].reproduce(*scene_files, show_progress=show_progress)
    _save_result(output_folder, figure_name, key, figure_result)
    return figure_name, time.perf_counter() - start_time


def _default_scenes_folder():
    """Return the folder of the scene files, inside an installed package or beside the package in a checkout."""
    packaged_scenes_folder = ROOT / "scenes"
    return packaged_scenes_folder if packaged_scenes_folder.is_dir() else ROOT.parent / "scenes"


def _content_key(scenes_folder, file_names):
    """Return a hash of the scene files and of the program, which identifies the result of a figure."""
    content_hash = hashlib.sha256(__version__.encode())
    source_files = [
        source_file
        for package_folder in (ROOT, ROOT.parent / "continuation")
        for source_file in sorted(package_folder.rglob("*.py"))
    ]
    for file_path in [*(scenes_folder / f"{file_name}.toml" for file_name in file_names), *source_files]:
        content_hash.update(file_path.read_bytes())
    return content_hash.hexdigest()


def _save_result(output_folder, figure_name, key, figure_result):
    """Write the files of a figure.

    The file of the claims is written last and marks the figure as complete. It contains the SHA-256 digests of the
    other files.
    """
    content_by_file = {
        f"{figure_name}{file_suffix}.nc": netcdf_bytes(dataset) for file_suffix, dataset in figure_result.data.items()
    }
    if figure_result.picture is not None:
        content_by_file[f"{figure_name}.png"] = figure_result.picture
    claims = [asdict(claim) | {"verdict": claim.verdict} for claim in figure_result.claims]
    file_digests = {file_name: sha256_hex(file_content) for file_name, file_content in content_by_file.items()}
    figure_record = HEADER_ATTRIBUTES | {
        "key": key,
        "caption": figure_result.caption,
        "files": file_digests,
        "claims": claims,
    }
    content_by_file[f"{figure_name}.json"] = fill_in_checksum(json.dumps(figure_record, indent=1).encode())
    for file_name, file_content in content_by_file.items():
        with atomic_file(output_folder / file_name, overwrite=True) as output_file:
            output_file.write(file_content)


def _load_result(output_folder, figure_name, key):
    """Load the `FigureResult` of an earlier run with a key, without its data; None if it is missing or damaged."""
    try:
        record_content = (output_folder / f"{figure_name}.json").read_bytes()
        figure_record = json.loads(record_content) if has_valid_checksum(record_content, figure_name) else {"key": None}
        if figure_record["key"] != key:
            return None
        content_by_file = {file_name: (output_folder / file_name).read_bytes() for file_name in figure_record["files"]}
        if any(
            sha256_hex(content_by_file[file_name]) != stored_digest
            for file_name, stored_digest in figure_record["files"].items()
        ):
            return None
        claims = [
            Claim(**{key: value for key, value in claim.items() if key != "verdict"})
            for claim in figure_record["claims"]
        ]
        return FigureResult(content_by_file.get(f"{figure_name}.png"), figure_record["caption"], tuple(claims))
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _write_report(output_folder, content_keys):
    """Write the report of all valid results in the folder and return the `Report`."""
    result_by_name = {
        figure_name: _load_result(output_folder, figure_name, key) for figure_name, key in content_keys.items()
    }
    figure_results = [
        (figure_name, figure_result)
        for figure_name, figure_result in result_by_name.items()
        if figure_result is not None
    ]
    titled_results = [(JOBS[figure_name].title, figure_result) for figure_name, figure_result in figure_results]
    markdown_entries = [
        (JOBS[figure_name].title, f"{figure_name}.png" if figure_result.picture else None, figure_result)
        for figure_name, figure_result in figure_results
    ]
    for file_suffix, file_content in (
        (".html", report_html(titled_results)),
        (".md", report_markdown(markdown_entries)),
    ):
        with atomic_file(output_folder / f"{REPORT_NAME}{file_suffix}", overwrite=True) as output_file:
            output_file.write(file_content.encode())
    claims = [claim for _, figure_result in figure_results for claim in figure_result.claims]
    return Report(
        output_folder / f"{REPORT_NAME}.html",
        output_folder / f"{REPORT_NAME}.md",
        tuple(claims),
        verdict_counts_text(claims),
    )

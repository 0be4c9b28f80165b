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
from ..output.atomic_write import refuse_folder, whole
from ..output.checksums import MARKS, digest, is_sealed, netcdf, sealed
from ..scene import check
from ..studies import scene_file
from .claim import Claim
from .figures import JOBS
from .panels import Drawn
from .report import counts, page, text

ROOT = Path(__file__).parents[1]
REPORT = "report"


@dataclass(frozen=True)
class Report:
    """What `paper` wrote. page, text: the paths of the report; claims: all that are in it; told: a sentence on them."""

    page: Path
    text: Path
    claims: tuple[Claim, ...]
    told: str


@check.typed
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
    workers = check.whole("workers", workers, 1)
    out, folder = Path(out), _scenes() if scenes is None else Path(scenes)
    names = check.sequence("names", names) or tuple(JOBS)
    for name in names:
        if name not in JOBS:
            raise check.ArgumentError("figure", f"must be one of those known{check.among(name, JOBS)}", name)
    for name in names:
        _files(folder, name)
    keys = {name: _key(folder, JOBS[name].files) for name in JOBS if _exist(folder, JOBS[name].files)}
    refuse_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    due = [name for name in names if force or _kept(out, name, keys[name]) is None]
    tasks = [(name, folder, out, keys[name], progress and workers == 1) for name in due]
    for place, (name, seconds) in enumerate(_each(tasks, workers), 1):
        if progress:
            print(f"{name}: {seconds:.1f} s ({place} of {len(due)})", file=sys.stderr, flush=True)
    return _report(out, keys)


def _files(folder, name):
    return [scene_file.read(folder / f"{one}.toml") for one in JOBS[name].files]


def _each(tasks, workers):
    """What `_computed` gives of each task, in this process or, as they are done, in some of their own."""
    if workers == 1 or len(tasks) < 2:
        yield from (_computed(*task) for task in tasks)
        return
    fresh = multiprocessing.get_context("spawn")  # jax's threads do not live through a fork
    with ProcessPoolExecutor(workers, fresh, _prepare, (jax.config.jax_enable_x64,)) as pool:
        running = [pool.submit(_computed, *task) for task in tasks]
        try:
            yield from (one.result() for one in as_completed(running))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _prepare(double):
    """A new process computes in the precision of this one."""
    jax.config.update("jax_enable_x64", double)


def _computed(name, folder, out, key, progress):
    """(the name of a figure, how long it took), its files written."""
    began = time.perf_counter()
    if progress:
        print(name, file=sys.stderr, flush=True)
    _keep(out, name, key, JOBS[name].drawn(*_files(folder, name), progress=progress))
    return name, time.perf_counter() - began


def _scenes():
    """The folder of the scene files: in the package where it was installed, beside it in a checkout."""
    inside = ROOT / "scenes"
    return inside if inside.is_dir() else ROOT.parent / "scenes"


def _exist(folder, names):
    return all((folder / f"{name}.toml").is_file() for name in names)


def _key(folder, names):
    """What tells one computation from another: the scene files' and the program's text."""
    whole = hashlib.sha256(__version__.encode())
    sources = [one for package in (ROOT, ROOT.parent / "continuation") for one in sorted(package.rglob("*.py"))]
    for path in [*(folder / f"{name}.toml" for name in names), *sources]:
        whole.update(path.read_bytes())
    return whole.hexdigest()


def _keep(out, name, key, drawn):
    """Writes what was computed, its claims last: they tell that all is there, by the SHA-256 of each other file."""
    files = {f"{name}{ending}.nc": netcdf(data) for ending, data in drawn.data.items()}
    if drawn.picture is not None:
        files[f"{name}.png"] = drawn.picture
    claims = [asdict(one) | {"verdict": one.verdict} for one in drawn.claims]
    digests = {each: digest(content) for each, content in files.items()}
    told = MARKS | {"key": key, "caption": drawn.caption, "files": digests, "claims": claims}
    files[f"{name}.json"] = sealed(json.dumps(told, indent=1).encode())
    for each, content in files.items():
        with whole(out / each, force=True) as file:
            file.write(content)


def _kept(out, name, key):
    """The `Drawn` of an earlier run with the same key, without its data; None where there is none, or a file is not as
    it was written."""
    try:
        content = (out / f"{name}.json").read_bytes()
        told = json.loads(content) if is_sealed(content, name) else {"key": None}
        if told["key"] != key:
            return None
        files = {each: (out / each).read_bytes() for each in told["files"]}
        if any(digest(files[each]) != written for each, written in told["files"].items()):
            return None
        claims = [Claim(**{key: value for key, value in one.items() if key != "verdict"}) for one in told["claims"]]
        return Drawn(files.get(f"{name}.png"), told["caption"], tuple(claims))
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _report(out, keys):
    """Writes the report of all that is there: the `Report`."""
    kept = {name: _kept(out, name, key) for name, key in keys.items()}
    parts = [(name, one) for name, one in kept.items() if one is not None]
    titled = [(JOBS[name].title, one) for name, one in parts]
    named = [(JOBS[name].title, f"{name}.png" if one.picture else None, one) for name, one in parts]
    for ending, content in ((".html", page(titled)), (".md", text(named))):
        with whole(out / f"{REPORT}{ending}", force=True) as file:
            file.write(content.encode())
    claims = [claim for _, one in parts for claim in one.claims]
    return Report(out / f"{REPORT}.html", out / f"{REPORT}.md", tuple(claims), counts(claims))

"""Damaged cache files: `python -m tests.cache_proof [COUNT]`.

In a cache that a run has filled, COUNT bits are flipped, one at a time, in modules and programs; each damaged file is
read as a run reads it. Then whole runs with caches that are damaged, foreign, read-only, of another version or without
room, whose answer is compared with that of a run without a cache. As a last line what JAX's own check finds of as many
flipped bits in its own files, which this package neither reads nor can guard.
"""

import ctypes
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

from continuation import trusted_cache_file

from .flipped_bits import flipped

ROOT = Path(__file__).parents[1]
NOBODY = 65534
ANSWER = """
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
import jaxvibro as jv
scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
state, _ = jv.strobe(scene, jv.State(0.9, -1.1))
branch = jv.follow(jv.find_orbit(scene, state), "amplitude", (0.0, 6.0))
print(branch.points("SN")[0].value.hex(), np.asarray(branch.multipliers).tobytes().hex())
"""


def answer(cache=None, **more):
    """(answer, warnings) of a run in a process of its own."""
    given = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    if cache is not None:
        given |= {"JAX_COMPILATION_CACHE_DIR": str(cache), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    done = subprocess.run([sys.executable, "-c", ANSWER], cwd=ROOT, env=given, capture_output=True, text=True, **more)
    return done.stdout or f"ended with {done.returncode}: {done.stderr[-300:]}", done.stderr


def ours(cache):
    """Modules and programs."""
    return sorted(one for one in cache.glob("modules/*/*") if one.is_file())


def flip_each(cache, count, rng):
    """How many of so many damaged files were read."""
    files, read = ours(cache), 0
    for number in range(count):
        path = files[number % len(files)]
        whole = path.read_bytes()
        path.write_bytes(flipped(whole, rng.randrange(8 * len(whole))))
        read += trusted_cache_file.read(path) is not None
        path.write_bytes(whole)
    assert all(trusted_cache_file.read(path) is not None for path in files)
    kinds = [sum(one.suffix == kind for one in files) for kind in ("", ".code")]
    print(f"{count} bits flipped in {kinds[0]} modules and {kinds[1]} programs: {read} damaged files read", flush=True)


def damage_all(cache, rng):
    """Flip a bit in each of our files."""
    for path in ours(cache):
        whole = path.read_bytes()
        path.write_bytes(flipped(whole, rng.randrange(8 * len(whole))))


def swap(cache, rng):
    """Each file gets the content of the next one of its kind."""
    for kind in ("", ".code"):
        files = [one for one in ours(cache) if one.suffix == kind]
        contents = [one.read_bytes() for one in files]
        for path, content in zip(files, contents[1:] + contents[:1], strict=True):
            path.write_bytes(content)


def other_version(cache, rng):
    """Files that are right in the folder of another version lie in that of this one."""
    (folder,) = (cache / "modules").iterdir()
    other = folder.with_name("0" * 32)
    other.mkdir(mode=0o700)
    for path in ours(cache):
        trusted_cache_file.write(other / path.name, trusted_cache_file.read(path))
        shutil.copyfile(other / path.name, path)


def foreign(cache, rng):
    """Of another user."""
    for path in [*ours(cache), cache, cache / "modules", *(cache / "modules").iterdir()]:
        os.chown(path, NOBODY, NOBODY)


def open_to_all(cache, rng):
    cache.chmod(0o777)


def nothing(cache, rng):
    """As it is."""


def read_only(cache, rng):
    """What is missing cannot be written: half of the files are."""
    for path in ours(cache)[::2]:
        path.unlink()
    for path in (cache, *cache.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)


def obeys_modes():
    """A process of root's that may not do what the modes of files forbid."""
    for capability in (1, 2, 3):  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH, CAP_FOWNER
        ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP


def small_files():
    """A process that may write files of a kilobyte, as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))


def runs(cache, rng):
    true, _ = answer()
    print(f"without a cache: {true.split()[0]}")
    cases = [("undamaged", nothing, {}), ("a flipped bit in each file", damage_all, {}), ("swapped files", swap, {})]
    cases += [("files of another version", other_version, {}), ("a folder for everyone", open_to_all, {})]
    cases += [("full disk, empty cache", lambda cache, rng: shutil.rmtree(cache), {"preexec_fn": small_files})]
    cases += [("full disk, damaged files", damage_all, {"preexec_fn": small_files})]
    cases += [("read-only folder", read_only, {"preexec_fn": obeys_modes})]
    if os.geteuid() == 0:
        cases += [("another user's folder", foreign, {})]
    for name, change, more in cases:
        with tempfile.TemporaryDirectory() as where:
            copy = Path(where) / "cache"
            shutil.copytree(cache, copy)
            change(copy, rng)
            found, told = answer(copy, **more)
            warned = "; one warning" * (told.count("neither kept in this cache folder") == 1)
            print(f"{name}: {'the same answer' if found == true else f'OTHER: {found[:300]}'}{warned}", flush=True)


def flip_jax(cache, count, rng):
    """How many damaged files of JAX's own its decompression refuses."""
    files, refused = sorted(cache.glob("*-cache")), 0
    for number in range(count):
        whole = files[number % len(files)].read_bytes()
        try:
            zlib.decompress(flipped(whole, rng.randrange(8 * len(whole))))
        except zlib.error:
            refused += 1
    print(f"{count} bits flipped in {len(files)} files of JAX's own: {refused} refused by zlib's checksum")


if __name__ == "__main__":
    how_many, generator = int((sys.argv[1:] or ["1000"])[0]), random.Random(58)
    with tempfile.TemporaryDirectory() as place:
        filled = Path(place) / "cache"
        filled.mkdir(mode=0o700)
        answer(filled)
        flip_each(filled, how_many, generator)
        flip_jax(filled, how_many, generator)
        runs(filled, generator)

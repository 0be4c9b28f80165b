"""What damaged files, hostile texts and kills come to: `python -m tests.files_proof WHICH [TIMES] [SEED]`.

flips, cuts: so many damages, shared out among every kind of saved file, are all refused with one line, or made anew.
mutations: so many scene files and changes as by --set, hostile and random; each is read or refused with one line,
within 2 s of processor time; one of two hundred goes through the command itself.
killed: `run`, `paper` and `explore` that is resumed, killed at so many random moments each (explore: half as often);
what is there is whole, and what the last, undisturbed run leaves has the same numbers as one that was never disturbed.
writing: killed so often while it does nothing but save one of two diagrams over the other; one of them is there, whole.
"""

import json
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

import jax
import numpy as np
import xarray as xr

import jaxvibro as jv
from jaxvibro.reproduction import run as paper
from jaxvibro.scene.check import MAX_MESSAGE_LENGTH
from jaxvibro.studies import scene_file
from tests.mutations import CHANGES, mutated
from tests.paper_proof import stopped

ROOT = Path(__file__).parents[1]
SLOWEST = 2.0  # seconds
RUN = """
[scene]
amplitude = 4.65
frequency = 2.1
damping = 0.05
restitution = 0.7
left = {position = -1.0}
right = {position = 1.0}
[sweep]
parameter = "amplitude"
count = 4001
settle = 400
keep = 100
legs = [{name = "up", from = 0.0, to = 7.0, start = {x = 0.0, v = 0.0}}]
[attractors]
starts = 200
"""
EXPLORE = """
import sys, jax
from pathlib import Path
jax.config.update("jax_enable_x64", True)
import jaxvibro as jv
scene, place, budget = jv.make_scene(4.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), Path(sys.argv[1]), 0
while True:
    known = jv.load_diagram(place) if (place / "diagram.json").exists() else None
    if known is not None and known.complete:
        break
    budget = 1 if known is None else len(known) + 1
    jv.explore(scene, "amplitude", (2.0, 6.0), 2, 0, budget, known).save(place, force=True)
"""

SAVE = """
import os, signal, sys, threading, jax
from dataclasses import replace
jax.config.update("jax_enable_x64", True)
import jaxvibro as jv
place, one = sys.argv[1], jv.load_diagram(sys.argv[1])
two = replace(one, reason="the other", branches=one.branches[::-1] if len(one) > 1 else one.branches * 2, left=())
threading.Timer(float(sys.argv[2]), os.kill, (os.getpid(), signal.SIGKILL)).start()
while True:
    two.save(place, force=True)
    one.save(place, force=True)
"""


def made(folder):
    """{kind: (file, what reads it)} of every kind of saved file; a reader gives whether what it read is as written."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (1.5, 4.0))
    branch.save(folder / "branch.nc")
    settings = {"max_period": 1, "seed": 0, "largest_step": 0.1}
    jv.Diagram("amplitude", (1.5, 4.0), scene, (branch,) * 2, ((0, 1),), True, "done", settings).save(folder / "d")
    (folder / "rest.toml").write_text(RUN.split("[sweep]")[0])
    jv.run(folder / "rest.toml", folder)
    jv.paper(["formulas"], folder / "paper")
    drawn = paper.FigureResult(b"picture", "", (), {"": branch.data})
    paper._save_result(folder / "paper", "fig8", "key", drawn)
    kept = lambda name, key: lambda path: paper._load_result(folder / "paper", name, key)  # noqa: E731
    return {
        "branch": (folder / "branch.nc", jv.load_branch),
        "diagram's index": (folder / "d" / "diagram.json", lambda path: jv.load_diagram(path.parent)),
        "diagram's branch": (min((folder / "d").glob("*.nc")), lambda path: jv.load_diagram(path.parent)),
        "data of a run": (folder / "rest.nc", jv.load_data),
        "claims": (folder / "paper" / "fig8.json", kept("fig8", "key")),
        "picture": (folder / "paper" / "fig8.png", kept("fig8", "key")),
        "data of a figure": (folder / "paper" / "fig8.nc", kept("fig8", "key")),
    }


def damaged(times, seed, damage):
    """Prints how many damages of each kind of file were refused with one line, made anew, or anything else."""
    draw, told = np.random.default_rng(seed), Counter()
    with tempfile.TemporaryDirectory() as folder:
        kinds = list(made(Path(folder)).items())
        for count in range(times):
            kind, (path, read) = kinds[count % len(kinds)]
            whole = path.read_bytes()
            path.write_bytes(damage(whole, draw))
            told[kind, _outcome(read, path)] += 1
            path.write_bytes(whole)
        assert all(_outcome(read, path) == "read" for _, (path, read) in kinds)
    for (kind, what), count in sorted(told.items()):
        print(f"{kind:18}{what:12}{count}")
    good = sum(count for (_, what), count in told.items() if what in ("refused", "made anew"))
    print(f"{good} of {times} refused with one line, or made anew where it is kept work")


def _outcome(read, path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return "made anew" if read(path) is None else "read"
        except jv.ArgumentError as error:
            return "refused" if _is_one_line(str(error)) else "a long line"
        except Exception as error:
            return type(error).__name__


def _is_one_line(line):
    return 0 < len(line) <= MAX_MESSAGE_LENGTH and "\n" not in line


def flipped(whole, draw):
    content = bytearray(whole)
    content[draw.integers(len(content))] ^= 1 << draw.integers(8)
    return bytes(content)


def cut(whole, draw):
    return whole[: draw.integers(len(whole))]


def mutations(times, seed):
    """Prints what became of so many mutated scene files and changes, and the longest time that one took."""
    draw, told, slow, wrong = np.random.default_rng(seed), Counter(), (0.0, ""), []
    files = [path.read_bytes() for path in sorted((ROOT / "scenes").glob("*.toml"))]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mutated.toml"
        for count in range(times):
            content, changes, kind = mutated(files, draw, CHANGES)
            path.write_bytes(content)
            began = time.process_time()
            try:
                scene_file.read_scene_file(path, changes)
                what = "read"
            except jv.ArgumentError as error:
                what = "refused" if _is_one_line(str(error)) else "a long line"
            except Exception as error:
                what = type(error).__name__
            spent = time.process_time() - began
            slow = max(slow, (spent, kind))
            told[what] += 1
            if what not in ("read", "refused") or spent > SLOWEST:
                wrong.append((kind, what, round(spent, 2), content[:80], [one[:80] for one in changes]))
            if count % 200 == 199 and what == "refused":
                told[_through_the_command(path, changes)] += 1
    print(", ".join(f"{what}: {count}" for what, count in sorted(told.items())))
    print(f"slowest: {slow[0]:.2f} s ({slow[1]}); neither read nor refused, or above {SLOWEST:g} s: {len(wrong)}")
    print(*wrong[:20], sep="\n")


def _through_the_command(path, changes):
    words = [word.replace("\0", "") for change in changes for word in ("--set", change[:60_000])]
    done = subprocess.run([sys.executable, "-m", "jaxvibro", "run", str(path), *words], capture_output=True, cwd=ROOT)
    lines = done.stderr.decode(errors="replace").splitlines()
    good = done.returncode == 2 and len(lines) == 1 and len(lines[0]) <= MAX_MESSAGE_LENGTH + len("jaxvibro: ")
    return "one line of the command" if good else f"the command ended with {done.returncode}, {len(lines)} lines"


def killed(times, seed):
    """Kills each of the three so often, then lets it end, and compares with one that was left alone."""
    draw = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "long.toml").write_text(RUN)
        python = [sys.executable, "-m", "jaxvibro"]
        run = [*python, "run", str(folder / "long.toml"), "--force", "--out"]
        figures = [*python, "paper", "fig2", "fig12", "--out"]
        grown = [sys.executable, "-c", EXPLORE]
        for name, command, often, shares, whole, same in (
            ("run", run, times, (0.2, 1.05), _run_is_whole, _data),
            ("paper", figures, times, (0.02, 0.6), _paper_is_whole, _claims),  # goes on, so it is to be killed early
            ("explore", grown, times // 2, (0.1, 0.5), _diagram_is_whole, _diagram),
        ):
            places = [folder / f"{name} {how}" for how in ("alone", "disturbed")]
            places[0].mkdir()
            places[1].mkdir()
            spent = _done(command, places[0])
            for count in range(often):
                how = draw.choice([signal.SIGINT, signal.SIGKILL, signal.SIGTERM])
                stopped([*command, str(places[1])], draw.uniform(*shares) * spent, how)
                print(f"{name} {count + 1}: {whole(places[1])}", flush=True)
            again = _done(command, places[1])
            alike = same(places[0]) == same(places[1])
            print(f"{name}: {spent:.0f} s alone, {again:.0f} s to the end; same numbers: {alike}", flush=True)


def writing(times, seed):
    """Prints what is there after each of so many kills in the middle of writing."""
    draw, told, parts = np.random.default_rng(seed), Counter(), 0
    with tempfile.TemporaryDirectory() as folder:
        place = made(Path(folder))["diagram's index"][0].parent
        for _ in range(times):
            command = [sys.executable, "-c", SAVE, str(place), str(draw.uniform(0.0, 0.3))]
            ended = subprocess.run(command, cwd=ROOT).returncode
            told[_outcome(_loaded, place / "diagram.json"), signal.Signals(-ended).name] += 1
            parts = sum(path.name.startswith(".") for path in place.iterdir())
    print(f"{dict(told)} of {times}; {parts} parts left over by them all")


def _done(command, place):
    began = time.perf_counter()
    subprocess.run([*command, str(place)], check=True, capture_output=True, cwd=ROOT)
    return time.perf_counter() - began


def _told(place, broken):
    """Whether any file is broken; parts under names of their own may be left over where nothing could clear up."""
    names = [path.name for path in place.iterdir()]
    parts = sum(name.startswith(".") for name in names)
    return f"{len(names) - parts} files, {parts} parts left over, broken: {broken or 'none'}"


def _run_is_whole(place):
    broken = [path.name for path in place.glob("[!.]*.nc") if _outcome(jv.load_data, path) != "read"]
    broken += [path.name for path in place.glob("[!.]*.png") if not path.read_bytes().endswith(b"IEND\xaeB`\x82")]
    return _told(place, broken + [path.name for path in place.glob("[!.]*.txt") if not path.read_text().strip()])


def _paper_is_whole(place):
    broken = []
    for path in place.glob("[!.]*.json"):
        key = json.loads(path.read_bytes())["key"]
        broken += [] if paper._load_result(place, path.stem, key) is not None else [path.name]
    return _told(place, broken)


def _diagram_is_whole(place):
    index = place / "diagram.json"
    return _told(place, [index.name] if index.exists() and _outcome(_loaded, index) != "read" else [])


def _loaded(index):
    return jv.load_diagram(index.parent)


def _data(place):
    data = xr.load_dataset(place / "long.nc")
    columns = {name: each.values for name, each in data.variables.items()}  # texts are objects, whose bytes are places
    return {name: each.tolist() if each.dtype == object else each.tobytes() for name, each in columns.items()}


def _claims(place):
    return {path.name: json.loads(path.read_text())["claims"] for path in place.glob("[!.]*.json")}


def _diagram(place):
    found = jv.load_diagram(place)
    return found.table(), [one.values.tobytes() for one in found.branches]


PROOFS = {
    "flips": (lambda times, seed: damaged(times, seed, flipped), 1000),
    "cuts": (lambda times, seed: damaged(times, seed, cut), 200),
    "mutations": (mutations, 20_000),
    "killed": (killed, 20),
    "writing": (writing, 50),
}

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    which, *rest = sys.argv[1:]
    proof, usual = PROOFS[which]
    given = [int(one) for one in rest]
    proof(*given, *(usual, 1)[len(given) :])

"""The notebooks as pages: text, code, and what a run printed and drew, which `make notebooks` keeps in docs/notebooks.

`python -m docs.site.notebooks notebooks/01_scene_and_map.py ...` runs some and keeps what comes of them. A notebook
whose cells have changed since is shown without its outputs.
"""

import contextlib
import hashlib
import io
import json
import re
import sys
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
from PIL import Image

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "docs" / "notebooks"
COLOURS = 128  # of a kept picture: a quarter of its bytes


def cells(script):
    """The cells of a script in jupytext's percent format: [(whether it is text, its lines)]."""
    found = []
    for part in re.split(r"^# %%", script, flags=re.MULTILINE)[1:]:
        head, _, body = part.partition("\n")
        text = "markdown" in head
        lines = [re.sub(r"^# ?", "", line) for line in body.splitlines()] if text else body.splitlines()
        found.append((text, "\n".join(lines).strip()))
    return [cell for cell in found if cell[1]]


def run(path):
    """Run a notebook and keep what each cell prints and draws."""
    KEPT.mkdir(exist_ok=True)
    matplotlib.use("Agg")
    script, names, outputs = path.read_text(), {"__name__": "__main__"}, []
    for old in KEPT.glob(f"{path.stem}*"):
        old.unlink()
    for place, (text, lines) in enumerate(cells(script)):
        if text:
            continue
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(lines, str(path), "exec"), names)
        pictures = [_keep(number, f"{path.stem}_{place}_{number}.png") for number in plt.get_fignums()]
        plt.close("all")
        if pictures or printed.getvalue():
            outputs.append({"cell": place, "text": printed.getvalue().rstrip(), "pictures": pictures})
    record = {"cells": _digest(script), "outputs": outputs}
    (KEPT / f"{path.stem}.json").write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")


def _keep(number, name):
    """Save a figure as a small picture: its name."""
    whole = io.BytesIO()
    plt.figure(number).savefig(whole, dpi=90)
    image = Image.open(whole).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    image.save(KEPT / name, optimize=True)
    return name


def _digest(script):
    return hashlib.sha256(json.dumps(cells(script)).encode()).hexdigest()


def page(path):
    """A notebook as Markdown, and whether its outputs are there."""
    script, kept = path.read_text(), KEPT / f"{path.stem}.json"
    record = json.loads(kept.read_text()) if kept.exists() else {"cells": None}
    fresh = record["cells"] == _digest(script)
    outputs = {one["cell"]: one for one in record["outputs"]} if fresh else {}
    parts = []
    for place, (text, lines) in enumerate(cells(script)):
        parts.append(lines if text else f"```python\n{lines}\n```")
        if place in outputs:
            printed, pictures = outputs[place]["text"], outputs[place]["pictures"]
            parts += [f"```text\n{printed}\n```"] if printed else []
            parts += [f"![What this cell draws](../docs/notebooks/{name})" for name in pictures]
    title, told = parts[0].partition("\n")[::2]
    note = "" if fresh else " It is shown without what it prints and draws: `make notebooks` keeps that."
    source = f"This is the notebook [`{path.name}`]({path.name}).{note}"
    return "\n\n".join([title, source, told, *parts[1:]]) + "\n", fresh


if __name__ == "__main__":
    for each in sys.argv[1:]:
        run(Path(each).resolve())

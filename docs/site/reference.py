"""The reference: a page for each room of the package, made of the docstrings of all public names.

A public name, method or property without a docstring stops the build, a field that no docstring names does not.
"""

import ast
import enum
import inspect
import re
import textwrap
from importlib import import_module

import continuation
import jaxvibro as jv
from continuation.shooting import periodic_orbits, settled

PAGES = {
    "scene": "Scenes: oscillator, drive, walls, forces",
    "output": "Files",
    "maps": "Maps and trajectories",
    "orbits": "Periodic orbits",
    "attractors": "Attractors, sweeps, exponents, basins, manifolds",
    "surveys": "Maps over parameters, shares, the least shock",
    "stores": "Stores and engines",
    "branches": "Branches and diagrams",
    "loci": "Loci",
    "design": "Design and fits",
    "plot": "Pictures: `jv.plot`",
    "studies": "Scene files and runs",
    "explorer": "The explorer",
    "reproduction": "The paper, recomputed",
    "continuation": "The package `continuation`",
}

# What calls give back and nobody needs to name, by its home.
RECORDS = {
    "scene": ("scene.codes.Status", "scene.codes.Contact"),
    "attractors": ("attractors.find.Attractor",),
    "branches": (
        *("branches.branch.Special", "branches.branch.Segment", "branches.normal_form.NormalForm"),
        *("branches.user_monitors.MonitoredPoint", "problem.end.End"),
        *("branches.curves.Curves", "branches.curves.Piece", "branches.curves.Marks"),
    ),
    "loci": ("loci.locus.Codim2",),
    "studies": ("studies.run.Done", "studies.warm.Warmed"),
    "explorer": ("explorer.view.View",),
    "reproduction": ("reproduction.run.Report", "reproduction.claim.Claim"),
}


class Untold(Exception):
    """A public name has no docstring."""


def members():
    """The public names of each page: {page: [(dotted name, object)]}."""
    found = {page: [] for page in PAGES}
    for name, home in jv._HOMES.items():
        found[home.split(".")[0]].append((f"jaxvibro.{name}", getattr(jv, name)))
    found["plot"] = [(f"jaxvibro.plot.{name}", getattr(jv.plot, name)) for name in jv.plot.__all__]
    found["continuation"] = [(f"continuation.{name}", getattr(continuation, name)) for name in continuation.__all__]
    found["continuation"] += [(f"continuation.shooting.{one.__name__}", one) for one in (periodic_orbits, settled)]
    return found


def records():
    """The records of each page: {page: [(name, where it lives, object)]}."""
    parts = {page: [home.rpartition(".")[::2] for home in homes] for page, homes in RECORDS.items()}
    return {
        page: [(name, home, getattr(import_module(f"jaxvibro.{home}"), name)) for home, name in each]
        for page, each in parts.items()
    }


PUBLIC = {dotted for each in members().values() for dotted, _ in each}
TOLD = PUBLIC | {f"jaxvibro.{name}" for each in records().values() for name, _, _ in each}


def pages():
    """The text of each page of the reference, and of the page that lists them: {file name: Markdown}."""
    more = records()
    made = {f"{page}.md": _page(PAGES[page], each, more.get(page, ())) for page, each in members().items()}
    names = "\n".join(page.removesuffix(".md") for page in made)
    made["index.md"] = (
        "# Reference\n\nEvery public name with its docstring, by the rooms of the package; in one list:\n"
        f"[public names](../docs/api.md).\n\n```{{toctree}}\n:maxdepth: 2\n\n{names}\n```\n"
    )
    return made


def _page(title, each, more):
    module = each[0][0].split(".")[0]
    parts = [f"# {title}\n", f"```{{py:currentmodule}} {module}\n```\n"]
    for dotted, value in each:
        parts += [f"## `{dotted.split('.')[-1]}`\n", _entry(module, dotted.removeprefix(f"{module}."), value)]
    for name, home, value in more:
        told = f"Calls give it back; it is no public name, but lives in `jaxvibro.{home}`.\n"
        parts += [f"## `{name}`\n", told, _entry(module, name, value)]
    return "\n".join(parts)


def _entry(module, name, value):
    """A name within its module as a directive of Sphinx."""
    node = _source(value)
    if isinstance(node, ast.ClassDef):
        kind = "exception" if issubclass(value, Exception) else "class"
        told = prose(_doc(name, value), list(_annotated(value)), module)
        parts = [_fields(value), told, *_methods(module, name, value)]
        return _directive(f"py:{kind}", name, parts, 5)
    arguments = [arg.arg for arg in [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]]
    return _directive("py:function", name + _signature(node), [prose(_doc(name, value), arguments, module)], 4)


def _source(value):
    """The definition as it is written: annotations read better than what they stand for."""
    return ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(value)))).body[0]


def _signature(node, bound=False):
    args = node.args
    if bound:
        args.args = args.args[1:]
    back = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"({ast.unparse(args)}){back}"


def _doc(dotted, value):
    text = inspect.cleandoc(vars(value).get("__doc__") or "") if isinstance(value, type) else inspect.getdoc(value)
    if not text:
        raise Untold(f"{dotted} has no docstring")
    return text


def _family(value):
    """A class and those that it inherits from, of ours alone, the most general first."""
    return [one for one in reversed(value.__mro__) if one.__module__.split(".")[0] in ("jaxvibro", "continuation")]


def _annotated(value):
    """The public fields of a class."""
    names = [name for one in _family(value) for name in inspect.get_annotations(one)]
    return [name for name in names if not name.startswith("_")]


def _fields(value):
    """The fields of a record, as they are written, its own before those that it inherits."""
    if issubclass(value, enum.Enum):
        return ""
    lines = {}
    for one in [one for each in reversed(_family(value)) for one in _source(each).body]:
        if isinstance(one, ast.AnnAssign) and one.target.id[0] != "_":
            lines.setdefault(one.target.id, ast.unparse(one))
    return "```python\n" + "\n".join(lines.values()) + "\n```" if lines else ""


def _methods(module, dotted, value):
    """Public methods and properties of a class, each with its docstring."""
    if issubclass(value, enum.Enum):
        return
    members = {name: each for one in _family(value) for name, each in vars(one).items() if name[0] != "_"}
    for name, each in members.items():
        head, method = f"{dotted}.{name}", getattr(each, "__func__", each)  # a class method's is within
        getter = getattr(method, "fget", getattr(method, "func", None))  # a property's, a cached one's
        if name not in _annotated(value) and getter is not None:
            yield _directive("py:property", head, [prose(_doc(head, getter), [], module)], 4)
        elif name not in _annotated(value) and inspect.isfunction(method):
            node = _source(method)
            names = [arg.arg for arg in [*node.args.args, *node.args.kwonlyargs]]
            text = prose(_doc(head, method), names, module)
            yield _directive("py:method", head + _signature(node, not isinstance(each, staticmethod)), [text], 4)


def _directive(kind, head, parts, ticks):
    fence = "`" * ticks
    body = "\n\n".join(part for part in parts if part)
    return f"{fence}{{{kind}}} {head}\n\n{body}\n{fence}\n"


def prose(text, names, module="jaxvibro"):
    """A docstring as Markdown: names of arguments or fields begin a line of a list, public names lead to theirs."""
    return "\n\n".join(_paragraph(part, names, module) for part in re.split(r"\n\s*\n", text))


def _paragraph(part, names, module):
    if part.startswith("    "):
        return "```text\n" + textwrap.dedent(part) + "\n```"
    text = " ".join(part.split())
    if not names:
        return _marked(text, module)
    one = "|".join(sorted(map(re.escape, names), key=len, reverse=True))
    pieces = re.split(rf"(?:(?<=^)|(?<=[;.] )|(?<=: ))((?:{one})(?:, (?:{one}))*): ", text)
    lines = [_marked(pieces[0], module)] if pieces[0].strip() else []
    for name, told in zip(pieces[1::2], pieces[2::2], strict=True):
        lines.append(f"- **{_marked(name, module)}**: {_marked(told.strip().rstrip(';'), module)}")
    return "\n\n".join(lines[:1]) + "\n" * bool(lines[1:]) + "\n".join(lines[1:])


def _marked(text, module):
    """Text in which nothing but backticks is a mark."""
    parts = re.split(r"(`[^`]+`)", text)
    return "".join(_linked(part, module) if part.startswith("`") else _plain(part) for part in parts)


def _plain(text):
    text = re.sub(r"([\\*_\[\]<>$#|{}~])", r"\\\1", re.sub(r"^([-+])", r"\\\1", text))
    return re.sub(r"docs/(\w+)\.md", r"[](../docs/\1.md)", text)


def _linked(code, module):
    name = code.strip("`").removeprefix("jv.").removeprefix("jaxvibro.")
    found = [f"{home}.{name}" for home in dict.fromkeys((module, "jaxvibro")) if f"{home}.{name}" in TOLD]
    return f"{{py:obj}}`{code.strip('`')} <{found[0]}>`" if found else code

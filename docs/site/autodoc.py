"""Adapt autodoc: signatures as the source writes them, and references from the short names that docstrings use."""

import ast
import inspect
import re
import textwrap

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.util.nodes import find_pending_xref_condition

from . import reference

# An attribute as napoleon writes it: directive, description, type.
TYPED = re.compile(r"(\.\. attribute:: .*\n)((?:\n|   .*\n)*?)   :type: (.*)\n")
NAMED = re.compile(r"(?<=\.\. attribute:: ).*")


def signature(app, what, name, value, options, arguments, returns):
    """Return arguments and result of a call with annotations and defaults as the source writes them.

    Annotations of array shapes are long at run time. A class has a signature if its docstring has a Parameters section:
    users construct it.
    """
    if what in ("class", "exception"):
        return (_constructor(value), "") if _has_section(value, "Parameters") else ("", "")
    if what not in ("function", "method") or arguments is None:
        return None
    return _written(value, bound=what == "method" and not arguments.startswith("(self"))


def _has_section(value, title):
    return re.search(rf"^\s*{title}\n\s*-+$", value.__doc__ or "", re.MULTILINE) is not None


def definition(value):
    """Return the definition of a function or class as a syntax tree."""
    return ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(value)))).body[0]


def _written(value, bound):
    node = definition(value)
    if bound:
        for arguments in (node.args.posonlyargs, node.args.args):
            if arguments:
                del arguments[0]
                break
    return f"({ast.unparse(node.args)})", ast.unparse(node.returns) if node.returns else ""


def _constructor(value):
    """Return the arguments of a class: those of its own constructor, or its fields."""
    if any(isinstance(node, ast.FunctionDef) and node.name == "__init__" for node in definition(value).body):
        return _written(value.__init__, bound=True)[0]
    nodes = [node for base in reference.own_classes(value) for node in definition(base).body]
    annotated = {node.target.id: node for node in nodes if isinstance(node, ast.AnnAssign)}
    written = [annotated[name] for name in reference.fields(value)]
    return f"({', '.join(f'{node.target.id}: {ast.unparse(node.annotation)}{_default(node)}' for node in written)})"


def _default(node):
    """Return the default of a field of a dataclass."""
    if node.value is None:
        return ""
    if not (isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "field"):
        return f" = {ast.unparse(node.value)}"
    given = {word.arg: ast.unparse(word.value) for word in node.value.keywords}
    if "default_factory" in given:
        return f" = {given['default_factory']}()"
    return f" = {given['default']}" if "default" in given else ""


def docstring(app, what, name, value, options, lines):
    """Set the names of a call's own parameters as code, not as references, and add the type of a property."""
    if what == "property":
        returns = definition(getattr(value, "fget", None) or value.func).returns
        lines += ["", f":rtype: {_plain(ast.unparse(returns))}", ""] if returns else []
    elif own := _parameters(value) if what in ("function", "method", "class") else []:
        pattern = re.compile(rf"(?<![`:])`({'|'.join(map(re.escape, own))})`(?!`)")
        lines[:] = [pattern.sub(r"``\1``", line) for line in lines]


def attributes(app, what, name, value, options, lines):
    """Set the type of an attribute beside its name, and several names of one entry on a line each."""
    text = TYPED.sub(r"\1   :type: \3\n\2", "\n".join([*lines, ""]))
    text = NAMED.sub(lambda match: match[0].replace(", ", "\n" + 15 * " "), text)
    lines[:] = text.split("\n")


def _parameters(value):
    if inspect.isclass(value):
        return reference.fields(value)
    return [name for name in inspect.signature(value).parameters if name not in ("self", "cls")]


def _plain(text):
    """Return a text with the marks of reStructuredText escaped."""
    return re.sub(r"([\\*`_|])", r"\\\1", text)


def skip(app, what, name, value, skipped, options):
    """Leave out the descriptors of a named tuple's fields: its docstring documents the fields."""
    return True if type(value).__name__ == "_tuplegetter" else None


def complete(app, doctree):
    """Give references to documented names their full names and set other words of a type as plain text."""
    for node in list(doctree.findall(pending_xref)):
        if node.get("refdomain") != "py":
            continue
        name, module = node["reftarget"], node.get("py:module") or "jaxvibro"
        dotted = reference.target(name, module)
        if node["reftype"] != "class":  # not in a type
            node["reftarget"] = dotted or name
        elif dotted and inspect.isclass(reference.load(dotted)):
            node["reftarget"], node["refspecific"] = dotted, False
        else:
            content = (find_pending_xref_condition(node, "*") or node).children
            node.replace_self(list(_linked(name, module)) if " " in name else content)


def _linked(text, module):
    """Yield the nodes of a type in words, such as "tuple of Orbit", in which classes are references."""
    for part in re.split(r"(\w[\w.]*)", text):
        dotted = reference.target(part, module)
        if dotted and inspect.isclass(reference.load(dotted)):
            yield pending_xref(
                "", nodes.Text(part), refdomain="py", reftype="class", reftarget=dotted, refspecific=False
            )
        elif part:
            yield nodes.Text(part)


def setup(app):
    """Connect the functions of this module to the events of Sphinx."""
    app.connect("autodoc-process-signature", signature)
    app.connect("autodoc-process-docstring", docstring, priority=400)  # before napoleon reads the sections
    app.connect("autodoc-process-docstring", attributes, priority=600)  # after it
    app.connect("autodoc-skip-member", skip)
    app.connect("doctree-read", complete)
    return {"parallel_read_safe": True}

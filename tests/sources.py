"""The source files of both packages and the pages, read once, for the tests that check their form."""

import ast
import re
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("jaxvibro", "continuation")
FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef
DOCUMENTED = ast.Module | ast.ClassDef | FUNCTIONS
PAGES = ["README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def words(text):
    """Return the set of the words of a text."""
    return set(text.split())


def walk(tree, kind):
    """Yield the nodes of a kind."""
    return (node for node in ast.walk(tree) if isinstance(node, kind))


@dataclass
class Source:
    """A source file: its path below the root, and its text."""

    file: str
    text: str

    @cached_property
    def tree(self):
        """Syntax tree."""
        return ast.parse(self.text)

    @property
    def module(self):
        """Dotted name."""
        return self.file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")

    @property
    def folder(self):
        """Folder within jaxvibro, "" for its own files; None for continuation."""
        package, *parts = self.file.split("/")
        return None if package == "continuation" else "/".join(parts[:-1])

    @cached_property
    def docstrings(self):
        """[(node, docstring)] of the module, its classes and its functions."""
        texts = [(node, ast.get_docstring(node)) for node in walk(self.tree, DOCUMENTED)]
        return [(node, text) for node, text in texts if text]

    @cached_property
    def imports(self):
        """[(name in the file, dotted name)] of everything that is imported; a relative name is made absolute."""
        names = [alias for node in walk(self.tree, ast.Import) for alias in node.names]
        rows = [(alias.asname or alias.name, alias.name) for alias in names]
        for node in walk(self.tree, ast.ImportFrom):
            above = self.file.split("/")[: -node.level] if node.level else []
            base = [*above, *([node.module] if node.module else [])]
            rows += [(alias.asname or alias.name, ".".join([*base, alias.name])) for alias in node.names]
        return rows

    @cached_property
    def needed_modules(self):
        """Modules of both packages that the file imports, or from which it imports a name."""
        names = [dotted for _, dotted in self.imports if dotted.split(".")[0] in PACKAGES]
        return {dotted if dotted in MODULES else dotted.rpartition(".")[0] or dotted for dotted in names}


def read_sources():
    """Return {dotted name: Source} of both packages."""
    paths = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    sources = [Source(path.relative_to(ROOT).as_posix(), path.read_text("utf-8")) for path in paths]
    return {source.module: source for source in sources}


MODULES = read_sources()


@cache
def names_of_tests(module):
    """Return the names of the tests of a module below tests/, of its dotted name."""
    path = ROOT.joinpath("tests", *module.split(".")).with_suffix(".py")
    body = ast.parse(path.read_text("utf-8")).body if path.exists() else []
    return [node.name for node in body if isinstance(node, FUNCTIONS) and node.name.startswith("test_")]


def offenders(rule):
    """Return what a rule finds wrong in the packages: [file: problem]; rule: from a Source to problems."""
    return [f"{source.file}: {problem}" for source in MODULES.values() for problem in rule(source)]


def page_blocks(page):
    """Return the blocks of code of a page: [(language, text, the text between it and the block before)]."""
    text, end, blocks = (ROOT / page).read_text("utf-8"), 0, []
    for match in BLOCK.finditer(text):
        blocks.append((*match.groups(), text[end : match.start()]))
        end = match.end()
    return blocks


def table_rows(page, heading):
    """Return the rows of the table below a heading of a page: [cells]."""
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## |\Z)", (ROOT / page).read_text("utf-8"), re.M | re.S)
    lines = re.findall(r"^\| (.+)\|$", section, re.M)
    return [[cell.strip() for cell in line.split("|")] for line in lines[1:]]

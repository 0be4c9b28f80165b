"""Docstrings of public names follow the numpydoc standard, and their examples run."""

import doctest
import enum
import inspect
import re
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpydoc.validate
import pytest

from docs.site import reference

CODES = {
    *(f"GL{number:02}" for number in (2, 3, 5, 6, 7, 8, 9, 10)),
    *(f"SS{number:02}" for number in range(1, 7)),
    *(f"PR{number:02}" for number in range(1, 11)),
    *(f"RT{number:02}" for number in range(1, 6)),
    *("YD01", "EX01"),
}
PUBLIC = [dotted for page in reference.names().values() for dotted in page]
RECORDS = [dotted for page in reference.records().values() for dotted in page]
CLASSES = [dotted for dotted in (*PUBLIC, *RECORDS) if inspect.isclass(reference.load(dotted))]
MEMBERS = [f"{dotted}.{name}" for dotted in CLASSES for name in reference.members(reference.load(dotted))]
NAMES = [*PUBLIC, *RECORDS, *MEMBERS]
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


class Validator(numpydoc.validate.Validator):
    """Validator that takes the fields of a class without a Parameters section from its Attributes section.

    Users do not construct such a class. `test_the_fields_of_classes_are_documented` checks its fields.
    """

    def __init__(self, obj_name):
        super().__init__(numpydoc.validate.get_doc_object(reference.load(obj_name)))

    @property
    def signature_parameters(self):
        if inspect.isclass(self.obj) and not self.doc_all_parameters:
            return ()
        return super().signature_parameters


def violations(dotted):
    """Return the violations of the standard in the docstring of a name."""
    errors = numpydoc.validate.validate(dotted, Validator)["errors"]
    return [f"{code} {text}" for code, text in errors if code in CODES and (code != "EX01" or dotted in PUBLIC)]


def undocumented_fields(value):
    """Return the fields of a class that its docstring does not describe."""
    if issubclass(value, enum.Enum):
        return [name for name in value.__members__ if not re.search(rf"\b{name}\b", value.__doc__)]
    sections = numpydoc.validate.get_doc_object(value)
    entries = [entry for part in ("Parameters", "Attributes") for entry in sections[part]]
    documented = {name for entry in entries for name in entry.name.split(", ")}
    return [name for name in reference.fields(value) if name not in documented]


def test_docstrings_follow_the_numpydoc_standard():
    assert {dotted: found for dotted in NAMES if (found := violations(dotted))} == {}


def test_the_fields_of_classes_are_documented():
    values = {dotted: reference.load(dotted) for dotted in CLASSES}
    assert {dotted: found for dotted, value in values.items() if (found := undocumented_fields(value))} == {}


class Point(NamedTuple):
    """Point.

    Attributes
    ----------
    x : float
        Position.
    """

    x: float
    y: float


class Code(enum.Enum):
    """Code: OK."""

    OK, CAP = 0, 1


def test_violations_are_noticed(monkeypatch):
    def documented(x):
        """What x is"""
        return x

    monkeypatch.setattr(reference, "load", lambda dotted: documented)
    assert {"SS03", "PR01", "RT01", "EX01"} <= {line[:4] for line in violations("jaxvibro.follow")}
    documented.__doc__ = None
    assert [line[:4] for line in violations("jaxvibro.follow")] == ["GL08"]
    assert undocumented_fields(Point) == ["y"] and undocumented_fields(Code) == ["CAP"]


@pytest.fixture(scope="module")
def predefined():
    """Names that examples use without defining them."""
    names = {}
    exec(reference.EXAMPLES, names)
    return names


def examples(dotted):
    """Return the examples of a docstring as a doctest, or None."""
    value = reference.load(dotted)
    text = inspect.getdoc(value) or ""
    parsed = doctest.DocTestParser().get_doctest(text, {}, dotted, None, 0)
    return parsed if parsed.examples else None


@pytest.mark.parametrize("dotted", [name for name in NAMES if examples(name)])
def test_the_examples_of_a_docstring_run(dotted, predefined, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    test, report = examples(dotted), []
    test.globs = dict(predefined)
    failures = doctest.DocTestRunner(optionflags=FLAGS).run(test, out=report.append).failed
    plt.close("all")
    assert failures == 0, "".join(report)

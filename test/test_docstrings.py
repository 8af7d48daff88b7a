"""Docstrings of the public API: there, of what the signature says, and with what is raised.

Public is what has no leading underscore. Exported is what a package gives in its ``__all__``: there every parameter is named, in a section
``Parameters`` or in the sentence. A section, wherever there is one, holds exactly the parameters of the signature.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1] / "gyro_calib"
PACKAGES = sorted(path.parent.name for path in ROOT.glob("*/__init__.py"))
#: the words of a command are its --help, which other tests read
_TOLD_BY_ARGUMENTS = {"add_arguments", "run"}

Definition = ast.FunctionDef | ast.ClassDef


@dataclass(frozen=True)
class Entry:
    """A public definition: where it is, what it is, whether a package exports it."""

    where: str
    node: Definition
    exported: bool

    @property
    def text(self) -> str:
        return ast.get_docstring(self.node) or ""

    @property
    def sections(self) -> dict[str, list[str]]:
        """Lines of each section by its title."""
        found: dict[str, list[str]] = {}
        lines, title = self.text.splitlines(), ""
        for line, below in zip(lines, [*lines[1:], ""], strict=True):
            if re.fullmatch(r"-{3,}", below.strip()) and line.strip():
                title = line.strip()
                found[title] = []
            elif title:
                found[title].append(line)
        return found

    @property
    def parameters(self) -> list[str] | None:
        """Names in the signature, of a dataclass those of its fields; None for a class that is not made by calling it."""
        if isinstance(self.node, ast.FunctionDef):
            return _arguments(self.node)
        for child in self.node.body:
            if isinstance(child, ast.FunctionDef) and child.name == "__init__":
                return _arguments(child)
        if any("dataclass" in ast.unparse(decorator) for decorator in self.node.decorator_list):
            return [
                child.target.id
                for child in self.node.body
                if isinstance(child, ast.AnnAssign) and isinstance(child.target, ast.Name) and not child.target.id.startswith("_")
            ]
        return None

    @property
    def documented(self) -> list[str]:
        """Names in the section ``Parameters``."""
        heads = [line for line in self.sections.get("Parameters", ()) if re.match(r"[\w*]", line)]
        return [name.strip().lstrip("*") for head in heads for name in head.split(" : ")[0].split(",")]

    @property
    def raised(self) -> set[str]:
        """What the body of a function itself raises."""
        found: set[str] = set()
        for child in _own_nodes(self.node) if isinstance(self.node, ast.FunctionDef) else ():
            if isinstance(child, ast.Raise) and child.exc is not None:
                error = child.exc.func if isinstance(child.exc, ast.Call) else child.exc
                if isinstance(error, ast.Name) and error.id[0].isupper():
                    found.add(error.id)
        return found


def _arguments(node: ast.FunctionDef) -> list[str]:
    a = node.args
    named = [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs) if x.arg not in ("self", "cls")]
    return named + [x.arg for x in (a.vararg, a.kwarg) if x is not None]


def _own_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Without those of functions inside."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.ClassDef | ast.Lambda):
            yield child
            yield from _own_nodes(child)


def _exported(package: Path) -> set[str]:
    for node in ast.parse((package / "__init__.py").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def _entries(path: Path) -> Iterator[Entry]:
    exported = _exported(path.parent)
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name.startswith("_"):
            continue
        where = f"{path.relative_to(ROOT.parent)}:{node.lineno} {node.name}"
        yield Entry(where, node, node.name in exported)
        for child in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(child, ast.FunctionDef) and not child.name.startswith("_"):
                yield Entry(f"{path.relative_to(ROOT.parent)}:{child.lineno} {node.name}.{child.name}", child, node.name in exported)


def problems(entry: Entry) -> Iterator[str]:
    """What is wrong with one docstring."""
    if not entry.text:
        yield "no docstring"
        return
    parameters = entry.parameters
    if parameters is not None and "Parameters" in entry.sections and entry.documented != parameters:
        absent, strange = [n for n in parameters if n not in entry.documented], [n for n in entry.documented if n not in parameters]
        if absent or strange:
            yield f"section Parameters must be of the signature, but lacks {absent} and has {strange}"
    if parameters and entry.exported and "Parameters" not in entry.sections and entry.node.name not in _TOLD_BY_ARGUMENTS:
        unsaid = [name for name in parameters if not re.search(rf"\b{name}\b", entry.text)]
        if unsaid and len(parameters) > 1:
            yield f"exported, but says nothing of {unsaid}"
    unsaid = sorted(name for name in entry.raised if name not in entry.text)
    if unsaid and entry.node.name not in _TOLD_BY_ARGUMENTS:
        yield f"raises {unsaid}, but does not say so"


@pytest.mark.parametrize("package", ["", *PACKAGES])
def test_docstrings_tell_what_the_code_does(package: str) -> None:
    folder = ROOT / package
    paths = sorted(folder.rglob("*.py") if package else folder.glob("*.py"))
    assert paths
    silent = [path for path in paths if not ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))]
    wrong = [f"{path.relative_to(ROOT.parent)}: no docstring" for path in silent]
    wrong += [f"{entry.where}: {problem}" for path in paths for entry in _entries(path) for problem in problems(entry)]
    assert not wrong, "\n".join(["", *wrong])


def test_the_test_sees_what_is_wrong() -> None:
    source = '''
def f(a, b):
    """Does.

    Parameters
    ----------
    a : int
        One.
    c : int
        Gone.
    """
    raise ValueError(a)

def g(a, b): pass

def h(first, second):
    """Takes the first."""
'''
    f, g, h = (Entry(n.name, n, True) for n in ast.parse(source).body if isinstance(n, ast.FunctionDef))
    assert [p.partition(",")[0] for p in problems(f)] == ["section Parameters must be of the signature", "raises ['ValueError']"]
    assert list(problems(g)) == ["no docstring"]
    assert list(problems(h)) == ["exported, but says nothing of ['second']"]

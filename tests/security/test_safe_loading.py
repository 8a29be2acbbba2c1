"""Nothing in the packages runs what it reads: no pickle, no eval, no shell, no loader that makes objects of input."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(
    path
    for folder in ("magcal_service", "sim_sensor", "deploy")
    for path in (ROOT / folder).rglob("*.py")
    if "__pycache__" not in path.parts
)
MODULES = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "jsonpickle", "imp"}
CALLS = {"eval", "exec", "compile", "__import__", "execfile", "input"}
METHODS = {
    ("yaml", "load"), ("yaml", "unsafe_load"), ("yaml", "full_load"), ("os", "system"), ("os", "popen"),
    ("subprocess", "getoutput"), ("subprocess", "getstatusoutput"), ("tempfile", "mktemp"),
    ("runpy", "run_path"), ("code", "interact"), ("np", "fromregex"), ("numpy", "fromregex"),
}  # fmt: skip


def dangers(source: str) -> Iterator[str]:
    """What in a source could run its input, by line."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=names):
                found = [name.name for name in names if name.name.split(".")[0] in MODULES]
            case ast.ImportFrom(module=str(module)):
                found = [module] if module.split(".")[0] in MODULES else []
            case ast.Call(func=ast.Name(id=name)):
                found = [name] if name in CALLS else []
            case ast.Call(func=ast.Attribute(value=ast.Name(id=owner), attr=name)):
                found = [f"{owner}.{name}"] if (owner, name) in METHODS else []
            case _:
                continue
        if isinstance(node, ast.Call):
            found += [f"{word.arg}=True" for word in node.keywords if _dangerous(word)]
        yield from (f"line {node.lineno}: {name}" for name in found)


def _dangerous(word: ast.keyword) -> bool:
    is_true = not (isinstance(word.value, ast.Constant) and word.value.value is False)
    return word.arg in ("shell", "allow_pickle") and is_true


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_source_runs_nothing_that_it_reads(path: Path) -> None:
    """No source of the packages has a construct that executes data."""
    assert list(dangers(path.read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "import joblib.numpy_pickle",
        "eval('1')",
        "exec(text)",
        "yaml.load(file)",
        "subprocess.run(text, shell=True)",
        "subprocess.run(text, shell=maybe)",
        "np.load(path, allow_pickle=True)",
        "os.system(text)",
    ],
)
def test_each_construct_is_found(source: str) -> None:
    """The search itself finds what it is for."""
    assert len(list(dangers(source))) == 1


def test_what_is_harmless_is_not_found() -> None:
    """Named methods of other things, and what is switched off, are left alone."""
    source = "subprocess.run(x, shell=False)\nre.compile(x)\nmodel.eval()\nnp.load(p, allow_pickle=False)\njson.load(f)"
    assert list(dangers(source)) == []

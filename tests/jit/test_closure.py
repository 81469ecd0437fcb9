"""The key of compiled code: it changes with what the code does, and with nothing else."""

import importlib
import sys

import pytest

from gateway_fdi.jit.closure import Closure

USER = """\
from helper import LIMIT, below
from gateway_fdi.jit import kernel, record, f8
import helper

STATE = record(x=f8)

@kernel
def step(s, x):
    "A docstring."
    # a comment
    s.x = x if below(x) else LIMIT
"""
HELPER = """\
from gateway_fdi.jit import kernel
LIMIT = 3.0
UNUSED = 1

@kernel
def below(x):
    return x < LIMIT

@kernel
def other(x):
    return x
"""


@pytest.fixture
def digest(tmp_path, monkeypatch):
    """Return the digest of step's closure for the texts of two modules outside the package."""
    monkeypatch.syspath_prepend(tmp_path)
    count = 0

    def make(user=USER, helper=HELPER):
        nonlocal count
        count += 1
        folder = tmp_path / str(count)
        folder.mkdir()
        monkeypatch.syspath_prepend(folder)
        (folder / "user.py").write_text(user)
        (folder / "helper.py").write_text(helper)
        for name in ("user", "helper"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        step = importlib.import_module("user").step
        return Closure(getattr(step, "py_func", step)).digest

    yield make
    for name in ("user", "helper"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("# a comment", "# another"),
        ('"A docstring."', '"Another."'),
        ("def step(s, x):", "def step(s: object, x: float) -> None:"),
        ("STATE = record(x=f8)", "STATE = record(y=f8)\n\n\n"),
    ],
)
def test_what_changes_nothing_compiles_nothing(digest, old, new):
    assert old in USER
    assert digest(user=USER.replace(old, new)) == digest()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("UNUSED = 1", "UNUSED = 2"),
        ("def other(x):\n    return x", "def other(x):\n    return x + 1"),
    ],
)
def test_what_a_kernel_does_not_use_does_not_matter(digest, old, new):
    assert old in HELPER
    assert digest(helper=HELPER.replace(old, new)) == digest()


@pytest.mark.parametrize(
    ("old", "new"),
    [("LIMIT = 3.0", "LIMIT = 4.0"), ("return x < LIMIT", "return x <= LIMIT")],
)
def test_a_function_or_a_constant_in_another_file_changes_the_key(digest, old, new):
    assert old in HELPER
    assert digest(helper=HELPER.replace(old, new)) != digest()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("x if below(x) else LIMIT", "LIMIT if below(x) else x"),
        ("s.x = x", "s.x = -x"),
        ("below(x) else", "helper.other(x) else"),
    ],
)
def test_a_changed_kernel_changes_the_key(digest, old, new):
    assert old in USER
    assert digest(user=USER.replace(old, new)) != digest()


def test_a_kernel_that_is_called_instead_of_copied_is_other_code(digest):
    called = HELPER.replace("@kernel\ndef below", "@kernel(inlined=False)\ndef below")
    assert called != HELPER
    assert digest(helper=called) != digest()
    assert digest(helper=HELPER.replace("@kernel\ndef below", "@kernel(inlined=True)\ndef below")) == digest()


def test_a_function_that_is_read_of_a_module_counts(digest):
    user = USER.replace("below(x) else", "helper.other(x) else")
    helper = HELPER.replace("def other(x):\n    return x", "def other(x):\n    return x + 1")
    assert digest(user=user) != digest(user=user, helper=helper)

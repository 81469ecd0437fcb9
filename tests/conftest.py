"""Settings for all tests."""

import gc
import os
import sys

import pytest
from amount import FULL, SMALL, examples
from outcomes import Outcomes, note_ids
from uses import missing

from gateway.common.fence import Fence
from gateway_fdi.common import log
from gateway_fdi.jit import BOUNDSCHECK, COMPILED

os.environ["GATEWAY_TRUST"] = "all"  # tests write code and run it; tests/common/test_trust.py takes this away


def pytest_configure(config):
    """Say how many examples hypothesis tries; where its plugin is not loaded (a test kernel), it is not imported."""
    outcomes = os.environ.pop("GATEWAY_OUTCOMES", None)  # not for the processes that tests start
    if outcomes is not None:
        config.pluginmanager.register(Outcomes(outcomes))
    if not config.pluginmanager.hasplugin("hypothesispytest"):
        return
    from hypothesis import settings

    # Machines are slow and shared: no test fails for being slow. In CI the same examples come every time.
    for name, repeated in (("local", False), ("ci", True)):
        settings.register_profile(name, deadline=None, print_blob=True, derandomize=repeated)
        settings.register_profile(
            f"{name}-small",
            settings.get_profile(name),
            max_examples=examples(100),
            stateful_step_count=20,
        )
    settings.load_profile(("ci" if os.environ.get("CI") else "local") + ("-small" if SMALL else ""))


def pytest_ignore_collect(collection_path):
    """A file that uses a package or a plant that is not in this checkout is left out (scripts/without)."""
    return True if missing(collection_path) else None


def pytest_collection_modifyitems(config, items):
    """Leave out what only the full size has, with GATEWAY_TESTS=small what is long and what needs several processes.

    Of these, one chain of each is run. What runs other tests again comes first: at the end it would keep one processor
    busy alone.
    """
    note_ids(items)
    items.sort(key=lambda item: "test_kernels_again" not in item.nodeid)
    chain, left_out, seen = [], [], set()
    for item in items:
        if item.get_closest_marker("full") and not FULL:
            left_out.append(item)
            continue
        if not SMALL:
            continue
        name = (item.path, getattr(item, "originalname", item.name))
        if (BOUNDSCHECK or not COMPILED) and name in seen:  # one case of each test is run again
            left_out.append(item)
            continue
        seen.add(name)
        if not COMPILED and item.get_closest_marker("costly"):
            left_out.append(item)
        elif item.get_closest_marker("chain"):
            chain.append(item)
        elif item.get_closest_marker("long") or item.get_closest_marker("system"):
            left_out.append(item)
    if not left_out:
        return
    config.hook.pytest_deselected(items=left_out)
    gone = {id(item) for item in (*chain, *left_out)}
    items[:] = chain + [item for item in items if id(item) not in gone]


def pytest_collectstart():
    """What is loaded stays: the garbage collector would look through it again and again, for a fifth of the time."""
    gc.disable()


def pytest_collection_finish():
    """What is loaded by now is no garbage later either."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)  # as in the command line
    gc.enable()


@pytest.fixture(autouse=True)
def _plain_logging():
    """Log lines go to this test's standard error, whatever a test of the command line has set up."""
    log.reset()


@pytest.fixture(autouse=True)
def _walls(request, monkeypatch):
    """An exception that a wall catches fails the test, unless it plants some and looks at what was ``caught``."""
    found, note = [], Fence.note

    def noted(self, door, error, peer="", *, second=False):
        found.append((door, error, str(peer), second))
        note(self, door, error, peer, second=second)

    monkeypatch.setattr(Fence, "note", noted)
    yield found
    if "caught" not in request.fixturenames and found:
        raise AssertionError(f"walls have caught: {found}") from found[0][1]


@pytest.fixture
def caught(_walls):
    """What walls have caught: door, exception, name of the peer, whether it was the second wall."""
    return _walls


@pytest.fixture(autouse=True)
def _contract(monkeypatch):
    """Each event that a gateway in this process tells is one of the contract, and of its JSON Schema."""
    places = {"gateway.runtime.outbox": ("Outbox", "_hand"), "gateway.live.daemon": ("Daemon", "_report")}
    places = {name: place for name, place in places.items() if name in sys.modules}  # not imported for tests without
    wrong = {}
    if places:
        import contracted

    def checking(tell):
        def told(self, event):
            if reason := contracted.why_not(event):
                wrong.setdefault(event["event"], reason)
            tell(self, event)

        return told

    for name, (of, method) in places.items():
        found = getattr(sys.modules[name], of)
        monkeypatch.setattr(found, method, checking(getattr(found, method)))
    yield
    assert not wrong, f"events that are not in gateway/runtime/contract.py: {wrong}"

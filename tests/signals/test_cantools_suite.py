"""Decoding equals cantools on every database of cantools' own test suite.

The databases come with cantools' source distribution, fetched once from the package index.
"""

import math
import random
import subprocess
import sys
import tarfile
from importlib.metadata import version

import numpy as np
import pytest
from cantools.database.errors import DecodeError

from gateway.bus.frames import empty, put
from gateway.signals.database import load_database
from gateway.signals.decode import OK, decode
from gateway.signals.identity import sticks_out
from gateway.signals.tables import SignalRef, compile_plan
from gateway_fdi.errors import InputError

SEED = 20260
PAYLOADS = 40

#: Files that cantools itself refuses (that is what its tests of them are), or without CAN messages. Two that it refuses
#: are read, with a warning: a 29-bit identifier without its flag, texts of a signal that is not there.
REFUSED = {
    "arxml": {
        "system-DAI-3.1.2.arxml": "no messages",
        "system-bad-root-tag-4.2.arxml": "bad on purpose",
        "system-dangling-reference-4.2.arxml": "bad on purpose",
        "system-illegal-namespace-4.2.arxml": "bad on purpose",
        "system-illegal-root-4.2.arxml": "bad on purpose",
        "system-illegal-version-4.2.2.1.0.arxml": "bad on purpose",
        "system-missing-denominator-4.2.arxml": "bad on purpose",
        "system-missing-factor-4.2.arxml": "bad on purpose",
    },
    "dbc": {
        "BU_EV_REL_.dbc": "no messages",
        "bus_comment_bare.dbc": "no messages",
        "bus_comment_bare_out.dbc": "no messages",
        "cp1252.dbc": "no messages",
        "empty_ns.dbc": "no messages",
        "environment_variable_data.dbc": "no messages",
        "environment_variable_multiple_access_nodes.dbc": "no messages",
        "incorrect-sig_valtype.dbc": "bad on purpose",
        "issue_62.dbc": "no messages",
    },
    "kcd": {"empty.kcd": "no messages"},
    "sym": {
        "empty-6.0.sym": "no messages",
        "issue_138.sym": "bad on purpose",
    },
}

#: Messages that only one side can decode.
ONE_SIDED = {
    ("system-4.2.arxml", "OneToContainThemAll"): "a container of other messages",
    ("issue_63.dbc", "AFT1PSI2"): "overlapping signals, which cantools cannot unpack",
    ("message_layout.kcd", "Message5"): "overlapping signals, which cantools cannot unpack",
}


@pytest.fixture(scope="session")
def suite(tmp_path_factory, request):
    """The folder tests/files of cantools' source distribution."""
    root = request.config.cache.mkdir(f"cantools-{version('cantools')}")
    done = root / "files"
    if not done.exists():
        scratch = tmp_path_factory.mktemp("cantools")
        subprocess.run(
            [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:",
             "--dest", str(scratch), f"cantools=={version('cantools')}"],
            check=True,
            timeout=1000,
        )  # fmt: skip
        with tarfile.open(next(scratch.glob("cantools-*.tar.gz"))) as archive:
            archive.extractall(scratch, filter="data")
        found = next(scratch.glob("cantools-*/tests/files"))
        try:
            found.rename(done)
        except OSError:  # another worker was faster, or another file system
            if not done.exists():
                import shutil

                shutil.copytree(found, done, dirs_exist_ok=True)
    return done


@pytest.mark.long
@pytest.mark.parametrize("kind", ["dbc", "kcd", "sym", "arxml"])
def test_every_database_of_the_suite(suite, kind):
    print(f"seed {SEED}")
    rng = random.Random(SEED)
    refused, files, messages, payloads = set(), 0, 0, 0
    for path in sorted((suite / kind).glob(f"*.{kind}")):
        try:
            database = load_database([path])
        except InputError as error:
            assert str(path) in str(error)
            refused.add(path.name)
            continue
        files += 1
        for message in database:
            if (path.name, message.name) in ONE_SIDED:
                continue
            messages += 1
            payloads += compare(database, message, rng)
    assert refused == set(REFUSED[kind])
    print(f"{kind}: {files} files, {messages} messages, {payloads} payloads compared")
    assert payloads > 100


def compare(database, message, rng):
    long = {s.name for s in message.signals if s.length > 64}
    wanted = {SignalRef(0, message.name, s.name) for s in message.signals if s.name not in long}
    plan = compile_plan([(0, database)], wanted, messages=[(0, message.name)])
    values = np.zeros(plan.max_signals + 1)
    present = np.zeros(plan.max_signals + 1, np.uint8)
    frames = empty(1)
    for _ in range(PAYLOADS):
        size = rng.choice([message.length] * 5 + [rng.randrange(65), message.length + 1])
        body = rng.randbytes(min(size, 64))
        put(frames, 0, 0, message.frame_id, body)
        status = decode(
            frames["data"].view("<u8")[0],
            len(body),
            0,
            plan.messages,
            plan.signals,
            plan.mux_ids,
            values,
            present,
        )
        try:
            expected = message.decode(body, decode_choices=False)
        except DecodeError:
            # Where a signal cannot be decoded the others are.
            alone = long or any(sticks_out(message, signal) for signal in message.signals)
            assert status != OK or alone, (message.name, body.hex())
            continue
        assert status == OK, (message.name, body.hex())
        ours = {ref.signal: values[plan.position(*ref)] for ref in wanted if present[plan.position(*ref)]}
        assert set(ours) == set(expected) - long, (message.name, body.hex())
        for name, value in ours.items():
            exact = float(expected[name])
            assert (
                value == exact
                or (math.isnan(value) and math.isnan(exact))
                or (abs(exact) > 2**53 and math.isclose(value, exact, rel_tol=4e-16))
            ), (message.name, name, body.hex(), value, exact)
    return PAYLOADS

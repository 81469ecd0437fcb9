"""Every parser of bytes from outside, for scripts/fuzz: samples, and what takes them.

A parser may refuse with an error of ours (GatewayError), or with an answer; anything else that it raises is a bug. What
has a state is asked at the end whether it still serves.
"""

import json
import lzma
import random
import tempfile
import zlib
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

from gateway_fdi.errors import GatewayError

ROOT = Path(__file__).resolve().parents[2]
#: Frames of an OBD, UDS and J1939 tester, for the identifiers that servers listen to.
ADDRESSES = (0x7E0, 0x7DF, 0x7E8, 0x18EAFFF9, 0x18ECFFF9, 0x18EBFFF9, 0x18EEFFF9, 0x100)
REQUESTS = tuple(
    bytes.fromhex(text)
    for text in (
        "1003", "1101", "14ffffff", "1902ff", "190410001101", "1906100011ff", "22f1900123", "2701", "2702aabbccdd",
        "280101", "2e01240a0b", "31010202", "3e00", "8502", "8601000119", "290100000a30080c0612345678900000", "0100",
        "020200", "03", "06a0", "0902", "04",
    )
)  # fmt: skip


@dataclass(frozen=True)
class Target:
    """A parser.

    Attributes:
        samples: what it takes well.
        feed: gives it bytes.
        alive: asks it afterwards; raises if it does not serve any more.
    """

    samples: tuple[bytes, ...]
    feed: object
    alive: object = lambda: None


def _of_file(suffix, samples, read):
    """A parser of files: it gets each input in a file of this suffix."""

    def opened(folder, _stack):
        file = folder / f"given{suffix}"

        def feed(data):
            file.write_bytes(data)
            read(file)

        return Target(tuple(samples()), feed)

    return opened


def _database(kind):
    def samples():
        if kind == "arxml":
            from arxml import arxml

            yield arxml([(0x100, "Wheel", 8, 16, "PROFILE_01", [0x10], False)]).encode()
            return
        import cantools

        path = ROOT / "dbc" / "gateway.dbc"
        found = cantools.database.load_file(path)
        yield {"dbc": path.read_text, "kcd": found.as_kcd_string, "sym": found.as_sym_string}[kind]().encode()

    def read(file):
        from gateway.signals.database import load_database

        load_database([file])

    return _of_file(f".{kind}", samples, read)


def _log(suffix):
    def samples():
        from gateway.bus.frames import empty, put
        from gateway.bus.logs import open_writer

        frames = empty(40)
        for k in range(40):
            put(frames, k, k * 1_000_000, 0x100 + k, bytes([k] * (k % 9)))
        with tempfile.TemporaryDirectory() as name:
            path = Path(name) / f"sample{suffix.removesuffix('.xz')}"
            writer = open_writer(path)
            writer.write(frames)
            writer.close()
            yield lzma.compress(path.read_bytes()) if suffix.endswith(".xz") else path.read_bytes()

    def read(file):
        from gateway.bus.logs import LogReader

        for _ in LogReader(file):
            pass

    return _of_file(suffix, samples, read)


def _layouts(suffix):
    def samples():
        import answer_files

        if suffix == ".pdx":
            made = BytesIO()
            with ZipFile(made, "w") as archive:
                archive.writestr("car.odx-d", answer_files.odx())
            yield made.getvalue()
        else:
            texts = {".odx-d": answer_files.odx, ".json": answer_files.signal_set, ".cdd": lambda: answer_files.CDD}
            yield texts[suffix]().encode()

    def read(file):
        from gateway_ask.answers.layout import read_file

        read_file(file)

    return _of_file(suffix, samples, read)


def _config():
    def samples():
        yield (ROOT / "gateway.toml").read_bytes()
        yield from (path.read_bytes() for path in sorted((ROOT / "scenarios").glob("*.toml"))[:2])

    def read(file):
        from gateway.config.load import load_config

        load_config(file)

    return _of_file(".toml", samples, read)


def _journal(folder, _stack):
    from gateway.faults.journal_file import LENGTH, records

    sample = random.Random(1).randbytes(512)
    return Target((sample, bytes(LENGTH)[:4096]), records)


def _memory(folder, _stack):
    from stored_memories import fill

    from gateway.faults import service

    fill(folder / "sample.sqlite", 5)
    path = folder / "given.sqlite"

    def feed(data):
        for other in folder.glob("given.sqlite*"):
            other.unlink()
        path.write_bytes(data)
        service.list_entries(path)
        service.verify(path)

    return Target(((folder / "sample.sqlite").read_bytes(),), feed)


def _reports(folder, stack):
    from reporting import write_config

    from gateway.config.load import load_config
    from gateway.runtime.app import Gateway

    gateway = stack.enter_context(_closing(Gateway(load_config(write_config(folder)), None)))
    gateway.start(0)
    gateway.advance(1_000_000_000)
    now = [1.0]
    number = gateway.reports.enter(0, (), 42)

    def feed(data):
        now[0] += 0.01
        answer = gateway.reports.take(number, data, now[0])
        json.dumps(answer)
        gateway.advance(gateway.engine.now_ns + 10_000_000)

    def alive():
        now[0] += 100
        assert gateway.reports.take(number, report("hot"), now[0]) is not None

    def report(fault):
        return json.dumps({"fault": f"battery.{fault}", "result": "failed", "data": {"cell": 3}}).encode()

    return Target((report("hot"), report("slow"), b'{"alive": true}', b'{"bye": true}'), feed, alive)


@contextmanager
def _closing(gateway):
    try:
        yield gateway
    finally:
        gateway.close()


def _rig(folder, stack):
    """All servers and doors of one gateway, without a socket but the status socket's."""
    from doors import Doors

    made = stack.enter_context(Doors(folder))
    made.drive(0.0)
    return made


def _answers(doors):
    def asked():
        doors.rig.wait(10_000, step=50)  # what was begun is over: sessions, segments that are waited for
        assert doors.tester("3e00") == "7e00", "the gateway answers no tester"

    return asked


def _requests(folder, stack):
    doors = _rig(folder, stack)
    server = doors.gateway.servers.all[0]

    def feed(data):
        if data:
            doors.rig.now += 1_000_000
            for answer in server._answer(data[:4095], bool(data[0] & 1), doors.rig.now):
                assert 1 <= len(answer) <= 4095
            doors.rig.wait(1, step=1)

    return Target(REQUESTS, feed, _answers(doors))


def _frames(folder, stack):
    """Bytes as frames: an address of the list, a length, a payload; and so on."""
    doors = _rig(folder, stack)

    def feed(data):
        extended = 0x80000000
        while len(data) > 2:
            can_id, size = ADDRESSES[data[0] % len(ADDRESSES)], data[1] % 9
            doors.rig.feed((can_id | (extended if can_id > 0x7FF else 0), data[2 : 2 + size]))
            data = data[2 + size :]
        doors.rig.wait(5, step=5)

    singles = [bytes([0, 8, len(request)]) + request.ljust(7, b"\x55") for request in REQUESTS if len(request) < 8]
    several = bytes.fromhex("0008100a1902ffffffff") + bytes.fromhex("000821ffffffffffffff")
    wanted = bytes.fromhex("0303caff00") + bytes.fromhex("04081011000300cafe00") + bytes.fromhex("06080000000000000080")
    return Target((b"".join(singles), several, wanted), feed, _answers(doors))


def _long(_folder, _stack):
    """Bytes as frames of messages of several frames: an identifier of the list, a length, a payload; and so on."""
    from long_messages import batch, fast, long_message, signal, transported

    from gateway.signals.containers import Container, unpack
    from gateway.signals.database import Database
    from gateway.signals.reassembly import woven_of
    from gateway.signals.tables import compile_plan

    ids = (0x18ECFF21, 0x1CEBFF21, 0x18EC2101, 0x1CEB2101, 0x1CEC0121, 0x19F80535, 0x18FEE321)
    messages = [long_message("A", 0xFEE3, 100, [signal("S", 0, 8)]), long_message("F", 0x1F805, 43, [])]
    woven = woven_of(compile_plan([(0, Database([(message, None) for message in messages]))]))
    well = transported(0xFEE3, 0x21, 0xFF, bytes(100)), fast(0x1F805, 0x35, 0xFF, bytes(43), 1)

    def feed(data):
        for kind in ((3, 1, True), (4, 4, False)):
            unpack(data, Container(*kind, frozenset()))
        rows, t_s = [], woven.woven + 1.0
        while len(data) > 2:
            t_s += data[1] / 256
            rows.append((t_s, ids[data[0] % len(ids)], data[2 : 2 + data[1] % 9]))
            data = data[2 + data[1] % 9 :]
        woven.hear(batch(rows))

    def alive():
        before = woven.woven
        woven.hear(batch(*([(t_s + 1e6, *rest) for t_s, *rest in frames] for frames in well)))
        assert woven.woven == before + 2

    samples = (b"".join(bytes([ids.index(can_id), 8]) + data for _, can_id, data in frames) for frames in well)
    return Target(tuple(samples), feed, alive)


def _doip(folder, stack):
    from doip_rig import GATEWAY, TESTER, Peer, message

    doors = _rig(folder, stack)
    begin = message(5, TESTER.to_bytes(2, "big") + bytes(5))
    address = TESTER.to_bytes(2, "big") + GATEWAY.to_bytes(2, "big")
    talks = tuple(begin + message(0x8001, address + request) for request in REQUESTS)

    def feed(data):
        one = Peer(doors)
        one.send(data)
        one.take()
        one.close()
        doors.server.identity.answer(data, 0)

    return Target((*talks, message(1), message(0x4001), message(0x4003)), feed, _answers(doors))


def _status(folder, stack):
    doors = _rig(folder, stack)
    reader = [doors.reader()]
    lines = (
        {"id": 1, "do": "clear", "dtc": "P1000-11"},
        {"id": 2, "do": "settings", "dtc_setting": False},
        {"id": 3, "do": "present"},
        {"id": 4, "do": "request", "tester": "t", "ecu": "self", "uds": "1902ff"},
        {"id": 5, "do": "values", "signals": ["b.M0.Value"]},
        {"id": 6, "do": "cycle", "force": True, "why": "x"},
    )

    def feed(data):
        reader[0].socket.send(data.replace(b"\n", b" ")[:60_000] + b"\n")
        for _ in range(2):
            doors.turn()
        try:
            reader[0].read()
        except AssertionError:  # sent away: a line that is too long
            reader[0] = doors.reader()

    return Target(tuple(json.dumps(line).encode() for line in lines), feed, _answers(doors))


def _sovd(folder, stack):
    """Method, path and body of a request, a line each."""
    doors = _rig(folder, stack)
    own = "/sovd/v1/components/gateway"
    asked = (
        ("GET", f"{own}/faults?status%5Bkey%5D=confirmed", None), ("POST", f"{own}/locks", {"lock_expiration": 30}),
        ("PUT", f"{own}/data/setting", {"data": "0102"}),
        ("POST", f"{own}/operations/x/executions", {"parameters": {}}),
        ("PUT", f"{own}/modes/security", {"value": "1", "seed": "00"}), ("DELETE", f"{own}/faults", None),
        ("POST", "/api/clear", {"dtc": "P1000-11"}), ("POST", "/api/settings", {"dtc_setting": False}),
    )  # fmt: skip

    def feed(data):
        method, _, rest = data.partition(b"\n")
        path, _, body = rest.partition(b"\n")
        text = path.decode("latin-1")
        whole = text.startswith(("/sovd/", "/api/")) and text.isprintable() and len(text) < 4000
        if method.isalpha() and whole and "stream" not in text and not text.endswith("events"):  # which never end
            try:
                given = json.loads(body) if body else None
                json.dumps(given).encode()
            except (ValueError, RecursionError):
                return
            status, _ = doors.http(method.decode("latin-1"), text, given)
            assert status < 500 or status in (501, 503, 504), (status, data)

    samples = tuple(f"{m}\n{path}\n{'' if body is None else json.dumps(body)}".encode() for m, path, body in asked)
    return Target(samples, feed, _answers(doors))


def _batch(_folder, _stack):
    from gateway.faults.fleet import FleetParams
    from gateway.faults.outgoing import Outgoing, Tally
    from gateway_fleet.live.batch import packed, unpacked
    from gateway_fleet.live.inbox import Row
    from gateway_fleet.live.tables import event_row, test_rows

    told = {
        "event": "statistics",
        "t_ns": 9,
        "begin_ns": 1,
        "part": 0,
        "condition": "",
        "block_s": 60.0,
        "seconds": 6.0,
    }
    told["tests"] = [{"fault": "f", "sign": 1, "limit": 1.0, "blocks": 1, "failed": 0, "top": [0.5], "digest": []}]
    rows = [Outgoing(1, False, 0, json.dumps(told), "ab-1", 1)]
    sample = packed(FleetParams(name="f", car="c"), rows, Tally(1, 1, 0, 0))[0]

    def feed(data):
        from gateway.runtime.contract import wrong

        for sent in unpacked(data if data[:1] == sample[:1] else zlib.compress(data)).events:
            if not wrong(sent.event):
                row = Row(1, "c", "", "", *sent.id, sent.limits, 1, sent.body)
                event_row(row)
                list(test_rows(row))

    return Target((sample, zlib.decompress(sample)), feed)


def _campaign(_folder, _stack):
    from gateway_fleet.live import signed_documents
    from gateway_fleet.live.campaign import Campaign

    key = signed_documents.Ed25519PrivateKey.from_private_bytes(bytes(32))
    text = 'fleet = "f"\nname = "n"\nserial = 1\nuntil = 2030-01-01T00:00:00Z\n'
    text += 'limit = [{ test = "a.b.high", limit = 1.5 }]\n'
    sample = signed_documents.sign("campaign", text, key)

    def feed(data):
        public = (signed_documents.public_of(key),)
        whole = data if data[:1] == b"#" else signed_documents.sign("campaign", data.decode("utf-8", "replace"), key)
        signed_documents.opened(whole, "campaign", public, Campaign)

    return Target((sample, text.encode()), feed)


def _answers_of_ecus(_folder, _stack):
    """What ECUs say of DTCs, their snapshots, and results of monitors."""
    from gateway_ask.answers.monitor_tests import results
    from gateway_ask.answers.snapshots import snapshots_in_words
    from gateway_ask.clients.dtcs import read_dtcs

    def feed(data):
        snapshots_in_words(data)
        list(results(data))
        if data:
            read_dtcs("ecu", data, data[:5])

    samples = ("0102F40680F405D20201F40C1AF8", "594233FFFF0402013300 2F", "59040133002F0101F405D2", "4302 0133 4035")
    return Target(tuple(map(bytes.fromhex, samples)), feed)


#: Name -> what opens it.
TARGETS = {
    **{kind: _database(kind) for kind in ("dbc", "kcd", "sym", "arxml")},
    **{
        f"log{suffix}": _log(suffix)
        for suffix in (".log", ".asc", ".blf", ".trc", ".csv", ".parquet", ".log.xz", ".mf4")
    },
    **{f"layouts{suffix}": _layouts(suffix) for suffix in (".json", ".odx-d", ".pdx", ".cdd")},
    "config": _config(),
    "journal": _journal,
    "memory": _memory,
    "reports": _reports,
    "requests": _requests,
    "frames": _frames,
    "long": _long,
    "answers": _answers_of_ecus,
    "doip": _doip,
    "status": _status,
    "sovd": _sovd,
    "batch": _batch,
    "campaign": _campaign,
}


@contextmanager
def opened(name, folder):
    """Open a parser; what it keeps goes into a folder.

    Its ``feed`` takes any bytes, and raises only what is a bug.
    """
    with ExitStack() as stack:
        target = TARGETS[name](folder, stack)

        def feed(data):
            try:
                target.feed(data)
            except GatewayError as error:
                assert str(error), "an error that says nothing"
                assert len(str(error)) < 20_000, "an error that nobody can read"

        yield Target(target.samples, feed, target.alive)

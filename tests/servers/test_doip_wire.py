"""DoIP by sockets on 127.0.0.1, and by programs of others: doipclient, udsoncan, gallia, scapy, tshark."""

import datetime as dt
import re
import socket
import ssl
import struct
import subprocess
import sys

import pytest
import test_doip_routes as routes
import udsoncan
from amount import FULL, amount
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from debian import program
from doip_rig import FUNCTIONAL, GATEWAY, TESTER, message
from doip_wire import Sockets, free_port, wired
from doipclient import DoIPClient
from doipclient.connectors import DoIPClientUDSConnector
from scapy.contrib.automotive.doip import DoIP
from scapy.layers.inet import IP, TCP, UDP
from scapy.utils import wrpcap
from test_access import LEVEL, SECRET
from test_authentication import DAY, issue, name
from test_doip import VIN
from udsoncan.client import Client
from udsoncan_settings import PATIENT

from gateway.servers.uds.security import hmac_sha256
from gateway_fdi.errors import InputError
from gateway_testers.doip.codec import Activation, HeaderNack, Kind
from gateway_testers.doip.door import DoipDoor
from gateway_testers.doip.params import DoipParams, TlsParams
from gateway_testers.doip.secure import tls_context

ACTIVATE = message(5, struct.pack(">HBI", TESTER, 0, 0))
PRESENT = message(0x8001, struct.pack(">HH", TESTER, GATEWAY) + b"\x3e\x00")
GALLIA = [sys.executable, "-c", "import sys; from gallia.cli.gallia import main; sys.exit(main())"]


@pytest.fixture
def wire(tmp_path):
    with wired(tmp_path) as made:
        yield made


def kinds(told):
    return [each and each[0] for each in told]


# Sockets


def test_a_refusal_is_read_before_the_connection_ends(wire):
    assert wire.exchange(wire.connect(), message(5, bytes(7)) + bytes(50_000)) == [
        (6, struct.pack(">HHBI", 0, GATEWAY, 0, 0)),
        None,
    ]
    assert wire.exchange(wire.connect(), b"GET / HTTP/1.1\r\n\r\n") == [(0, b"\x00"), None]
    wire.turn(3, ms=600)
    assert wire.door._peers == wire.door._lingering == []


def test_datagrams_are_answered_to_who_asked(wire):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.setblocking(False)
        made.connect(("127.0.0.1", wire.port))
        for data in (b"", b"x", message(0x4002, bytes(3)), message(1), message(0x4001)):
            made.send(data)
        wire.turn()
        assert made.recv(100)[25:27] == struct.pack(">H", GATEWAY)
        assert made.recv(100)[2:4] == b"\x40\x02"
        with pytest.raises(BlockingIOError):
            made.recv(100)


def test_a_tester_that_dies_in_the_middle_leaves_nothing(wire):
    for cut_at in range(0, len(ACTIVATE + PRESENT), 3):
        made = wire.connect()
        made.sendall((ACTIVATE + PRESENT)[:cut_at])
        wire.turn(1)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        made.close()
        wire.turn(2)
    assert wire.door._peers == wire.server.connections == []
    assert kinds(wire.exchange(wire.connect(), ACTIVATE + PRESENT, until=lambda got: len(got) > 40)) == [
        6,
        0x8002,
        0x8001,
    ]


def test_half_open_connections_are_bounded_and_a_tester_is_served_beside_them(wire):
    one = wire.connect()
    assert kinds(wire.exchange(one, ACTIVATE, until=bool)) == [6]
    open_ = [wire.connect() for _ in range(amount(1000, 100))]
    wire.turn(20)
    assert len(wire.door._peers) == 17
    assert kinds(wire.exchange(one, PRESENT, until=lambda got: len(got) > 20)) == [0x8002, 0x8001]
    wire.turn(3, ms=1000)
    wire.turn(2, ms=1000)
    assert len(wire.door._peers) == 1, "none was activated in time"
    assert not wire.door._lingering
    for each in open_:
        each.close()


def test_a_slow_reader_holds_nobody_up_and_gets_all_when_it_reads(tmp_path):
    many = f'[[did]]\nid = 0x2000\nname = "big"\nhex = "{"ab" * 60000}"\n'
    with wired(tmp_path, more=many) as made:
        slow, one = made.connect(), made.connect()
        big = message(0x8001, struct.pack(">HH", TESTER, GATEWAY) + b"\x22\x20\x00")
        made.exchange(slow, ACTIVATE, until=bool)
        made.exchange(one, message(5, struct.pack(">HBI", TESTER + 1, 0, 0)), until=bool)
        slow.setblocking(True)
        slow.sendall(big * 120)  # answers of 7 MB
        slow.setblocking(False)
        made.turn(200)
        (waits,) = [each for each in made.server.connections if each.source == TESTER]
        assert len(waits.out) < 400_000
        asked = message(0x8001, struct.pack(">HH", TESTER + 1, GATEWAY) + b"\x3e\x00")
        assert kinds(made.exchange(one, asked, until=lambda got: len(got) > 20)) == [0x8002, 0x8001]
        whole = 120 * (13 + 12 + 60003)
        told = made.exchange(slow, b"", until=lambda got: len(got) >= whole, turns=5000)
        assert kinds(told) == [0x8002, 0x8001] * 120


@pytest.mark.evidence("ISO 13400-2: IPv6")
def test_ipv6_and_a_machine_without_it(tmp_path, monkeypatch):
    class NoIpv6(socket.socket):
        def __init__(self, family=socket.AF_INET, *more, **options):
            super().__init__(family, *more, **options)

        def bind(self, address):
            if self.family == socket.AF_INET6:
                raise OSError(99, "Cannot assign requested address")
            super().bind(address)

    both = {"bind": ("127.0.0.1", "::1"), "port": free_port()}
    with wired(tmp_path) as made:
        made.door.close()
        made.door = DoipDoor(DoipParams(port=both["port"]), made.rig.gateway, made.door._clock)
        if len(made.door._datagrams) == 2:
            one = socket.create_connection(("::1", both["port"]))
            one.setblocking(False)
            assert kinds(made.exchange(one, ACTIVATE, until=bool)) == [6]
            assert made.server.active[0].name == "doip ::1"
        made.door.close()
        monkeypatch.setattr("gateway_testers.doip.door.socket.socket", NoIpv6)
        made.door = DoipDoor(DoipParams(port=both["port"]), made.rig.gateway, made.door._clock)
        assert len(made.door._datagrams) == 1, "by default without it"
        made.door.close()
        with pytest.raises(InputError, match="::1"):
            DoipDoor(DoipParams(**both), made.rig.gateway, made.door._clock)


def test_a_port_that_is_taken_is_named(tmp_path):
    with wired(tmp_path) as one, pytest.raises(InputError, match="nothing can listen") as raised:
        type(one.door)(one.params, one.rig.gateway, one.door._clock)
    assert raised.value.key == "output.doip.port"


@pytest.mark.evidence("ISO 13400-2: 0004")
def test_the_vehicle_is_announced_three_times_where_asked_for_and_only_there(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heard:
        heard.bind(("127.0.0.2", 0))
        heard.setblocking(False)
        with wired(tmp_path, doip='announce = ["127.0.0.2"]') as made:
            made.door._params = made.params.model_copy(update={"port": heard.getsockname()[1]})
            made.turn(30, ms=100)
            told = [heard.recvfrom(100) for _ in range(3)]
            with pytest.raises(BlockingIOError):
                heard.recv(100)
            assert {(data[2:4], peer) for data, peer in told} == {(b"\0\x04", ("127.0.0.1", made.port))}


# TLS


def pem(key):
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


@pytest.fixture
def tls(tmp_path):
    """A gateway with TLS, its certificates made here, and contexts of testers with and without one."""
    now, root_key = dt.datetime.now(dt.UTC), ec.generate_private_key(ec.SECP256R1())
    times = {"first": now - DAY, "last": now + DAY}
    made = {"ca": (root_key, issue(root_key, name("root"), name("root"), root_key, ca=True, **times))}
    for common in ("gateway", "workshop"):
        key = ec.generate_private_key(ec.SECP256R1())
        made[common] = key, issue(key, name(common), name("root"), root_key, **times)
    for who, (key, certificate) in made.items():
        (tmp_path / f"{who}.pem").write_text(ssl.DER_cert_to_PEM_cert(certificate))
        (tmp_path / f"{who}.key").write_bytes(pem(key))
    port = free_port()
    big = f'[[did]]\nid = 0x2000\nname = "big"\nhex = "{"ab" * 60000}"\n'
    text = (
        big
        + f"""[output.doip.tls]
certificate = "gateway.pem"
key = "gateway.key"
client_ca = "ca.pem"
port = {port}
[[output.doip.tester]]
address = {TESTER}
[[output.doip.tester]]
address = {TESTER + 1}
certificate = "workshop"
"""
    )

    def context(version, own=None):
        made = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        made.check_hostname = False
        made.load_verify_locations(tmp_path / "ca.pem")
        made.minimum_version = made.maximum_version = version
        if own is not None:
            made.load_cert_chain(tmp_path / f"{own}.pem", tmp_path / f"{own}.key")
        return made

    with wired(tmp_path, more=text) as wire:
        yield wire, port, context


def by_tls(port, wire, context, **more):
    return DoIPClient("127.0.0.1", GATEWAY, tcp_port=port, udp_port=wire.port, use_secure=context, **more)


@pytest.mark.evidence("ISO 13400-2: TLS")
@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_tls_with_and_without_a_certificate_of_the_tester(tls, version):
    wire, port, context = tls
    with wire.running():
        with by_tls(port, wire, context(version), client_logical_address=TESTER) as one:
            one.send_diagnostic(b"\x22\xf1\x90")
            assert one.receive_diagnostic(5) == b"\x62\xf1\x90" + VIN
            assert [each.name for each in wire.server.active] == ["doip tls 127.0.0.1"]
        with pytest.raises(ConnectionRefusedError):  # 04: without a certificate
            by_tls(port, wire, context(version), client_logical_address=TESTER + 1)
        with context(version).wrap_socket(socket.create_connection(("127.0.0.1", port))) as slow:
            big = message(0x8001, struct.pack(">HH", TESTER, GATEWAY) + b"\x22\x20\x00")
            slow.sendall(ACTIVATE + big * 40)
            left = 17 + 40 * (13 + 12 + 60003)
            while left:
                left -= len(slow.recv(min(left, 100_000)))
        with by_tls(port, wire, context(version, "workshop"), client_logical_address=TESTER + 1) as one:
            one.send_diagnostic(b"\x3e\x00")
            assert one.receive_diagnostic(5) == b"\x7e\x00"
        with pytest.raises(ConnectionRefusedError):  # 07: not by TLS
            DoIPClient("127.0.0.1", GATEWAY, tcp_port=wire.port, client_logical_address=TESTER)


def test_who_speaks_no_tls_or_never_shakes_hands_is_closed(tls):
    wire, port, _ = tls
    silent, wrong = wire.connect(port), wire.connect(port)
    wrong.sendall(ACTIVATE)
    wire.turn(5)
    assert [each.peer for each in wire.server.connections] == ["127.0.0.1"]
    wire.turn(3, ms=1000)
    assert wire.server.connections == []
    silent.close()
    wrong.close()


def test_certificates_that_are_not_good_are_named(tls, tmp_path):
    good = {"certificate": tmp_path / "gateway.pem", "key": tmp_path / "gateway.key", "client_ca": tmp_path / "ca.pem"}
    (tmp_path / "empty").write_text("")
    for wrong, key in (
        ({"certificate": tmp_path / "none"}, "certificate"), ({"key": tmp_path / "none"}, "key"),
        ({"key": tmp_path / "workshop.key"}, "certificate"), ({"client_ca": tmp_path / "empty"}, "client_ca"),
        ({"client_ca": tmp_path / "none"}, "client_ca"),
    ):  # fmt: skip
        with pytest.raises(InputError) as raised:
            tls_context(TlsParams(**{**good, **wrong}))
        assert raised.value.key == f"output.doip.tls.{key}"


# Programs of others


@pytest.mark.evidence("ISO 13400-2: others")
def test_doipclient_and_udsoncan(tmp_path):
    with wired(tmp_path, uds=LEVEL, messages=60) as made:
        for k in range(60):
            made.rig.fail(k)
        with made.running():
            one = DoIPClient(
                "127.0.0.1", GATEWAY, tcp_port=made.port, udp_port=made.port, client_logical_address=TESTER,
                protocol_version=3,
            )  # fmt: skip
            told = one.request_vehicle_identification(vin=VIN.decode())
            assert (told.vin, told.logical_address) == (VIN.decode(), GATEWAY)
            assert one.request_entity_status().currently_open_sockets == 1
            assert one.request_diagnostic_power_mode().diagnostic_power_mode == 2
            assert one.request_alive_check().source_address == GATEWAY
            config = dict(PATIENT)
            config["data_identifiers"] = {"default": udsoncan.AsciiCodec(4)}
            config["security_algo"] = lambda level, seed, params: hmac_sha256(seed, bytes.fromhex(SECRET), 1)
            with Client(DoIPClientUDSConnector(one), config=config) as client:
                assert len(client.get_dtc_by_status_mask(0xFF).service_data.dtcs) == 60
                client.change_session(3)
                client.unlock_security_access(1)
                client.clear_dtc()
                assert client.get_dtc_by_status_mask(0x01).service_data.dtcs == []
                done = client.routine_control(0x0202, 1)
                assert done.service_data.routine_status_record == b"\x00", "through 0x78"
                with pytest.raises(udsoncan.exceptions.NegativeResponseException) as refused:
                    client.read_data_by_identifier([0xBEEF])
                assert refused.value.response.code == 0x31
        last = made.rig.gateway.memory.interventions()[-1]
        assert (last.bus, last.address, last.security) == ("doip 127.0.0.1", TESTER, 1)


class Routed(Sockets, routes.Net):
    """Three ECUs behind the gateway: another gateway, and two that answer anything."""

    def __init__(self, folder):
        self.port = free_port()
        text = f'[output.doip]\nbind = ["127.0.0.1"]\nport = {self.port}\n'
        super().__init__(folder, read=routes.READ, text=routes.ROUTES.replace("[output.doip]\n", text))
        self.ecus[0] = routes.Can(folder / "ecu")
        self.open()

    def pass_time(self, ms):
        self.run(ms)


def test_doipclient_and_udsoncan_reach_three_ecus_behind_the_gateway(tmp_path):
    made = Routed(tmp_path)
    with made.running():
        for k, address in enumerate((GATEWAY, routes.BRAKES, routes.BODY, routes.DOORS)):
            one = DoIPClient(
                "127.0.0.1", address, tcp_port=made.port, client_logical_address=TESTER + k, protocol_version=2
            )
            with Client(DoIPClientUDSConnector(one), config=PATIENT) as client:
                client.tester_present()
                if address == routes.BRAKES:
                    assert len(client.get_dtc_by_status_mask(0xFF).service_data.dtcs) == 60
                if address != GATEWAY:
                    with pytest.raises(udsoncan.exceptions.NegativeResponseException) as refused:
                        client.clear_dtc()
                    assert refused.value.response.code == 0x33
    assert made.state()["answers"] + made.state()["refused"] > 0, "polled beside it"
    made.door.close()
    made.close()
    made.ecus[0].rig.close()


def gallia(folder, *arguments):
    done = subprocess.run([*GALLIA, *arguments], capture_output=True, text=True, timeout=600, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr[-3000:]
    return re.sub(r"\x1b\[[0-9;]*m", "", done.stderr + done.stdout)


@pytest.mark.evidence("ISO 13400-2: others")
@pytest.mark.long
def test_gallia_finds_the_entity_its_addresses_services_and_identifiers(wire, tmp_path):
    target = f"doip://127.0.0.1:{wire.port}?protocol_version=3&src_addr={TESTER:#x}&activation_type=0"
    scan = ["--no-dumpcap", "--target", f"{target}&target_addr={GATEWAY:#x}", "--sessions", "1"]
    with wire.running():
        text = gallia(tmp_path, "discover", "doip", "--start", "0xffe", "--stop", "0x1002", "--target", target)
        assert re.findall(r"target address (0x\w+) is valid", text) == [hex(GATEWAY)]
        text = gallia(tmp_path, "scan", "uds", "services", *scan)
        assert re.findall(r"\[result\]:\s+\[0x(\w\w)\]", text) == ["10", "19", "22", "3e", "86"]
        if not FULL:
            return  # each scan takes seconds
        text = gallia(tmp_path, "scan", "uds", "identifiers", *scan, "--start", "0xf180", "--end", "0xf19f")
        assert re.findall(r"0x(\w{4}): ReadDataByIdentifierResponse", text) == ["f186", "f190"]
        assert "Timeouts: 0" in text


@pytest.mark.long
@pytest.mark.full("each scan takes seconds; the others have the same way")
def test_gallia_scans_an_ecu_behind_the_gateway(tmp_path):
    """Reading passes as the ECU has it; all else is refused by the gateway, and never seen by the ECU."""
    made = Routed(tmp_path)
    target = f"doip://127.0.0.1:{made.port}?protocol_version=3&src_addr={TESTER:#x}&activation_type=0"
    with made.running():
        text = gallia(tmp_path, "discover", "doip", "--start", "0xffe", "--stop", "0x1005", "--target", target)
        found = re.findall(r"target address (0x\w+) is valid", text)
        assert found == [hex(each) for each in (GATEWAY, routes.BRAKES, routes.BODY, routes.DOORS)]
        scan = ["--no-dumpcap", "--sessions", "1", "--target"]
        text = gallia(tmp_path, "scan", "uds", "identifiers", *scan, f"{target}&target_addr={routes.BRAKES:#x}",
                      "--start", "0xf180", "--end", "0xf18f")  # fmt: skip
        assert re.findall(r"0x(\w{4}): ReadDataByIdentifierResponse", text) == ["f186"]
        gallia(tmp_path, "scan", "uds", "services", *scan, f"{target}&target_addr={routes.BRAKES:#x}")
    heard = [request for _, can_id, request in made.requests if can_id == 0x7E1]
    assert {request[0] for request in heard} == {0x10, 0x19, 0x22, 0x3E}
    assert all(request[1] & 0x7F == 1 for request in heard if request[0] == 0x10)
    made.door.close()
    made.close()
    made.ecus[0].rig.close()


def spoken(wire):
    """Return a talk that has every message and every code of the server: (by TCP, from the tester, bytes)."""
    talk = []

    def tcp(*datas, turns=8):
        made = wire.connect()
        for data in datas:
            talk.append((True, True, data))
            made.sendall(data)
            got = b""
            for _ in range(turns):
                wire.turn(1)
                try:
                    got += made.recv(1 << 20)
                except BlockingIOError:
                    continue
            if got:
                talk.append((True, False, got))
        return made

    def diagnostic(request, target=GATEWAY, source=TESTER):
        return message(0x8001, struct.pack(">HH", source, target) + request)

    def activate(source, kind=0):
        return message(5, struct.pack(">HBI", source, kind, 0))

    for kind, body in ((1, b""), (2, bytes.fromhex("0123456789AB")), (3, VIN), (0x4001, b""), (0x4003, b""), (9, b"")):
        asked = message(kind, body)
        talk += [(False, True, asked), (False, False, wire.server.identity.answer(asked, 0))]
    one = tcp(
        activate(TESTER), diagnostic(b"\x22\xf1\x90"), diagnostic(b"\x10\x03"), diagnostic(b"\x31\x01\x02\x02"),
        diagnostic(b"\x3e\x00", FUNCTIONAL), diagnostic(b"\x3e\x00", 5), diagnostic(bytes(5000)),
        message(0x7777, b"x"), message(0x8001, length=1 << 20) + bytes(1 << 20), message(7),
    )  # fmt: skip
    wire.turn(5)
    two = tcp(activate(TESTER), turns=2)
    one.recv(1 << 20)
    one.sendall(message(8, struct.pack(">H", TESTER)))
    wire.turn(4)
    talk += [(True, False, message(7)), (True, True, message(8, struct.pack(">H", TESTER)))]
    talk.append((True, False, two.recv(1 << 20)))
    for wrong in (activate(1), activate(TESTER, 9), message(5, bytes(8)), message(5, bytes(7), version=7)):
        tcp(wrong)
    tcp(activate(TESTER + 1), activate(TESTER + 2))
    tcp(diagnostic(b"\x3e\x00"))
    return talk


@pytest.mark.evidence("ISO 13400-2: others")
def test_scapy_and_tshark_read_every_message(wire, tmp_path):
    """No packet is malformed, and all codes that this server has are seen (04 and 07 need TLS, 01 and 03 others)."""
    talk = spoken(wire)
    packets, sequence = [], {True: 1, False: 1}
    said = []
    for by_tcp, asked, data in talk:
        ports = {"sport": 40000, "dport": 13400} if asked else {"sport": 13400, "dport": 40000}
        ends = IP(src="127.0.0.1", dst="127.0.0.1")
        if not by_tcp:
            packets.append(ends / UDP(**ports) / data)
            continue
        for at in range(0, len(data), 60000):
            part = data[at : at + 60000]
            packets.append(ends / TCP(**ports, flags="PA", seq=sequence[asked], ack=sequence[not asked]) / part)
            sequence[asked] += len(part)
        while not asked and data:
            size = 8 + int.from_bytes(data[4:8], "big")
            layer = DoIP(data[:size])
            assert bytes(layer)[: min(size, 40)] == data[: min(size, 40)]
            said.append((layer.payload_type, layer))
            data = data[size:]
    file = tmp_path / "doip.pcap"
    wrpcap(str(file), packets)
    command = [program("tshark"), "-n", "-r", str(file), "-T", "fields", "-e", "doip.type", "-e", "_ws.malformed"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line.split("\t") for line in done.stdout.splitlines()]
    assert not [row for row in rows if row[1]]
    seen = {int(kind, 16) for row in rows for kind in row[0].split(",") if kind}
    assert seen >= {each for each in Kind if each != Kind.NACK}
    denied = {layer.routing_activation_response for kind, layer in said if kind == Kind.ACTIVATED}
    assert denied == {
        Activation.UNKNOWN_SOURCE, Activation.OTHER_SOURCE, Activation.ACTIVE_ELSEWHERE, Activation.UNSUPPORTED_TYPE,
        Activation.DONE,
    }  # fmt: skip
    assert {layer.nack for kind, layer in said if kind == Kind.NACK} == set(HeaderNack) - {HeaderNack.OUT_OF_MEMORY}
    assert {layer.nack_code for kind, layer in said if kind == Kind.DIAGNOSTIC_NACK} == {0x02, 0x03, 0x04}

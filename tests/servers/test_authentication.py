"""Authentication by certificate (0x29): who may, who may not and why; certificates made here by cryptography itself."""

import datetime as dt

import pytest
import udsoncan
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, padding, rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from rig import Rig, write_config
from test_access import SERVERS, by_j1939, by_mode_04
from uds_tester import EXTRA, Asked
from udsoncan.services import Authentication

from gateway.runtime.app import Gateway
from gateway.servers.uds import authentication
from gateway.servers.uds.certificates import Certificates
from gateway.servers.uds.nrc import NegativeError, Nrc

NOW = dt.datetime.fromtimestamp(0, dt.UTC)  # the rig's clock begins there
DAY = dt.timedelta(days=1)
AUTH = (
    'authentication = { roots = ["root.pem"], roles = ["workshop", "development"], revoked = [666], attempts = 255 }\n'
)


def name(common, unit=None):
    parts = [x509.NameAttribute(NameOID.COMMON_NAME, common)]
    if unit is not None:
        parts.append(x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, unit))
    return x509.Name(parts)


#: An extension that only its maker knows.
UNKNOWN = x509.UnrecognizedExtension(x509.ObjectIdentifier("1.3.6.1.4.1.99999.1"), b"\5\0")
#: Key usage of a certificate that signs others, and of one that does not.
SIGNS, SIGNS_NOT = (
    x509.KeyUsage(
        digital_signature=not signs, content_commitment=False, key_encipherment=False, data_encipherment=False,
        key_agreement=False, key_cert_sign=signs, crl_sign=False, encipher_only=False, decipher_only=False,
    )
    for signs in (True, False)
)  # fmt: skip


def issue(
    key, subject, issuer, issuer_key, *, first=NOW - DAY, last=NOW + DAY, serial=7, ca=False, path_length=None, more=(),
    critical=True, constraints=True,
):  # fmt: skip
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(serial)
        .not_valid_before(first)
        .not_valid_after(last)
    )
    if constraints:
        builder = builder.add_extension(x509.BasicConstraints(ca=ca, path_length=path_length), critical=True)
    for extension in more:
        builder = builder.add_extension(extension, critical=critical)
    algorithm = None if isinstance(issuer_key, ed25519.Ed25519PrivateKey) else hashes.SHA256()
    return builder.sign(issuer_key, algorithm).public_bytes(serialization.Encoding.DER)


ROOT_KEY, ROOT = ec.generate_private_key(ec.SECP256R1()), name("root")


def signed(key, data):
    if isinstance(key, ed25519.Ed25519PrivateKey):
        return key.sign(data)
    if isinstance(key, ec.EllipticCurvePrivateKey):
        return key.sign(data, ec.ECDSA(hashes.SHA256()))
    return key.sign(data, padding.PSS(padding.MGF1(hashes.SHA256()), padding.PSS.MAX_LENGTH), hashes.SHA256())


def certificates(folder, **options):
    """Write the root's certificate into a folder."""
    root = x509.load_der_x509_certificate(issue(ROOT_KEY, ROOT, ROOT, ROOT_KEY, **{"ca": True, **options}))
    (folder / "root.pem").write_bytes(root.public_bytes(serialization.Encoding.PEM))


@pytest.fixture
def make(tmp_path):
    rigs = []

    def build(uds=AUTH, more="", root=True, memory=None):
        if root:
            certificates(tmp_path)
        rigs.append(Rig(write_config(tmp_path, extra=EXTRA.format(uds=uds) + more), memory))
        return rigs[-1], Asked(rigs[-1])

    yield build
    for rig in rigs:
        rig.close()


def field(data):
    return (len(data).to_bytes(2, "big") + data).hex()


def show(ask, certificate, challenge=b""):
    """Show a certificate; returns the gateway's challenge, or the whole answer if it is refused."""
    answer = ask("290100" + field(certificate) + field(challenge), patience=200)
    if answer.startswith("7f"):
        return answer
    assert answer.startswith("6901110020")
    assert answer.endswith("0000")
    return bytes.fromhex(answer[10:-4])


def prove(ask, proof):
    return ask("2903" + field(proof) + field(b""), patience=200)


def a_tester(unit="workshop", key=None, **options):
    key = key or ec.generate_private_key(ec.SECP256R1())
    return key, issue(key, name("tester", unit), ROOT, ROOT_KEY, **options)


def log_in(ask, unit="workshop", key=None, challenge=b""):
    key, certificate = a_tester(unit, key)
    ours = show(ask, certificate, challenge)
    return prove(ask, signed(key, ours + challenge))


@pytest.mark.evidence("ISO 14229-1: 0x29 00", "ISO 14229-1: 0x29 01", "ISO 14229-1: 0x29 08")
@pytest.mark.parametrize(
    "key",
    [
        lambda: ec.generate_private_key(ec.SECP256R1()),
        ed25519.Ed25519PrivateKey.generate,
        lambda: rsa.generate_private_key(65537, 2048),
    ],
)
def test_who_proves_his_role_may(make, key):
    _, ask = make()
    assert ask("2908") == "7f297f"
    assert ask("1003")
    assert ask("2908") == "690802", "by certificate (APCE)"
    assert ask("14ffffff") == "7f1434"
    assert ask("8502") == "7f8534"
    assert log_in(ask, key=key()) == "6903120000"
    assert ask("14ffffff") == "54"
    assert ask("8502") == "c502"
    assert ask("2900") == "690010"
    assert ask("14ffffff") == "7f1434", "logged out"


@pytest.mark.evidence("ISO 14229-1: 0x29 01")
def test_udsoncan_asks_and_reads_the_same(make):
    """Requests made, and answers read, by a library that nobody here wrote."""
    _, ask = make()
    assert ask("1003")
    task = Authentication.AuthenticationTask

    def by_udsoncan(number, **fields):
        request = Authentication.make_request(number, **fields).get_payload()
        answer = bytes.fromhex(ask(request.hex(), patience=200))
        response = udsoncan.Response.from_payload(answer)
        assert response.positive
        return Authentication.interpret_response(response).service_data

    assert by_udsoncan(task.authenticationConfiguration).return_value == 0x02
    key, certificate = a_tester()
    shown = by_udsoncan(
        task.verifyCertificateUnidirectional, communication_configuration=0, certificate_client=certificate,
        challenge_client=b"mine",
    )  # fmt: skip
    assert shown.return_value == 0x11
    proof = signed(key, shown.challenge_server + b"mine")
    proven = by_udsoncan(task.proofOfOwnership, proof_of_ownership_client=proof, ephemeral_public_key_client=b"")
    assert proven.return_value == 0x12
    assert ask("14ffffff") == "54"
    assert by_udsoncan(task.deAuthenticate).return_value == 0x10


def test_the_testers_challenge_is_signed_too(make):
    _, ask = make()
    assert ask("1003")
    assert log_in(ask, challenge=b"mine" * 8) == "6903120000"


@pytest.mark.evidence("ISO 14229-1: 0x29 50", "ISO 14229-1: 0x29 56", "ISO 14229-1: 0x29 57")
@pytest.mark.parametrize(
    ("options", "nrc", "why"),
    [
        ({"first": NOW - 3 * DAY, "last": NOW - DAY}, "50", "expired"),
        ({"first": NOW + DAY, "last": NOW + 2 * DAY}, "50", "not yet valid"),
        ({"unit": "kitchen"}, "56", "a role that there is not"),
        ({"unit": None}, "56", "no role"),
        ({"serial": 666}, "57", "revoked"),
        ({"ca": True}, "53", "this one signs others"),
    ],
)
def test_certificates_that_are_not_good(make, options, nrc, why):
    rig, ask = make()
    assert ask("1003")
    _, certificate = a_tester(**options)
    assert show(ask, certificate) == f"7f29{nrc}", why
    assert prove(ask, b"x" * 64) == "7f2924", "there is no challenge"
    rig.wait(1)
    assert [f"{each.outcome:02x}" for each in rig.gateway.memory.interventions()] == [nrc]


@pytest.mark.evidence("ISO 14229-1: 0x29 51", "ISO 14229-1: 0x29 52")
def test_certificates_of_others(make):
    _, ask = make()
    assert ask("1003")
    key, other = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
    assert show(ask, issue(key, name("x", "workshop"), name("other root"), other)) == "7f2952", "another root's"
    assert show(ask, issue(key, name("x", "workshop"), ROOT, other)) == "7f2951", "it only says that it is ours"
    _, good = a_tester()
    assert show(ask, good[:-1] + bytes([good[-1] ^ 1])) == "7f2951"
    assert show(ask, b"nonsense") == "7f2954"
    weak = rsa.generate_private_key(65537, 1024)
    assert show(ask, a_tester(key=weak)[1]) == "7f2953"
    # One that a tester's certificate has signed: it is no root, though a root has signed it.
    between, certificate = a_tester()
    subject = x509.load_der_x509_certificate(certificate).subject
    assert show(ask, issue(key, name("x", "workshop"), subject, between)) == "7f2952"


class Chain:
    """A tester's certificate, and those between it and the root, the nearest first."""

    def __init__(self, *between, tester=None):
        """Issue them from the root down.

        Args:
            between: options of each certificate between, the nearest to the tester first.
            tester: options of the tester's own.
        """
        issuer, issuer_key, made = ROOT, ROOT_KEY, []
        for n, options in reversed(list(enumerate(between))):
            subject = name(f"between {n}")
            usual = {"ca": True, "more": [SIGNS], "serial": 100 + n}
            asked = {**usual, **options}
            key = asked.pop("key", None) or ec.generate_private_key(ec.SECP256R1())
            made.insert(0, issue(key, subject, issuer, issuer_key, **asked))
            issuer, issuer_key = subject, key
        self.key = ec.generate_private_key(ec.SECP256R1())
        own = issue(self.key, name("tester", "workshop"), issuer, issuer_key, **(tester or {}))
        self.parts = [own, *made]

    def log_in(self, ask):
        ours = show(ask, b"".join(self.parts))
        return ours if isinstance(ours, str) else prove(ask, signed(self.key, ours))


@pytest.mark.parametrize(
    "between", [[{}], [{"path_length": 0}, {"path_length": 1}], [{}, {}, {"path_length": 2}]], ids=len
)
def test_others_may_sign_between_tester_and_root(make, between):
    rig, ask = make()
    assert ask("1003")
    assert Chain(*between).log_in(ask) == "6903120000"
    assert ask("14ffffff") == "54"
    rig.wait(1)
    assert rig.gateway.memory.interventions()[-1].role == "workshop"


@pytest.mark.evidence("ISO 14229-1: 0x29 52", "ISO 14229-1: 0x29 53", "ISO 14229-1: 0x29 55")
@pytest.mark.parametrize(
    ("between", "tester", "nrc", "why"),
    [
        ([{"ca": False, "more": [SIGNS_NOT]}], {}, "52", "a tester's certificate signs nothing"),
        ([{"ca": False}], {}, "52", "key usage alone makes no authority"),
        ([{"constraints": False}], {}, "52", "nor does silence"),
        ([{"more": [SIGNS_NOT]}], {}, "52", "an authority whose key is not for certificates"),
        ([{"more": []}], {}, "52", "which does not say what its key is for"),
        ([{"key": rsa.generate_private_key(65537, 1024)}], {}, "52", "an authority's key that is too short"),
        ([{}, {"path_length": 0}], {}, "52", "path length: none may be between it and a tester"),
        ([{}, {}, {"path_length": 1}], {}, "52", "path length: one may"),
        ([{"last": NOW - DAY / 2}], {}, "50", "expired between"),
        ([{"first": NOW + DAY / 2}], {}, "50", "not valid yet between"),
        ([{}], {"last": NOW - DAY / 2}, "50", "expired"),
        ([{}, {"serial": 666}], {}, "57", "revoked between"),
        ([{}], {"serial": 666}, "57", "revoked"),
        ([{}], {"ca": True}, "53", "an authority is no tester"),
        ([{}], {"more": [SIGNS]}, "53", "a key for certificates only"),
        ([{}], {"more": [x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])]}, "53", "a server is no tester"),
        ([{"more": [SIGNS, UNKNOWN]}], {}, "55", "a critical extension that nobody here knows, between"),
        ([{}], {"more": [UNKNOWN]}, "55", "a critical extension that nobody here knows"),
        ([{}, {}, {}, {}], {}, "52", "more than are looked at"),
    ],
)
def test_chains_that_are_not_good(make, between, tester, nrc, why):
    rig, ask = make()
    assert ask("1003")
    assert Chain(*between, tester=tester).log_in(ask) == f"7f29{nrc}", why
    assert ask("14ffffff") == "7f1434"
    rig.wait(1)
    assert [f"{each.outcome:02x}" for each in rig.gateway.memory.interventions()] == [nrc, "34"]


@pytest.mark.evidence("ISO 14229-1: 0x29 54")
def test_chains_with_parts_of_others(make):
    _, ask = make()
    assert ask("1003")
    good, other = Chain({}, {}), Chain({}, {})
    own, first, second = good.parts
    wrong = {
        "one is missing": ([own, second], "52"),
        "the last is missing": ([own, first], "52"),
        "without any": ([own], "52"),
        "in another order": ([own, second, first], "52"),
        "one twice": ([own, first, first, second], "52"),
        "of the same name, but another's key": ([own, other.parts[1], second], "51"),
        "of the same name, but another's key, above": ([own, first, other.parts[2]], "51"),
        "one more that is not of it": ([own, first, second, a_tester()[1]], "52"),
        "bytes behind": ([own, first, second, b"\0"], "54"),
        "cut off": ([own, first, second[:-1]], "54"),
        "of no definite length": ([b"\x30\x80", own], "54"),
        "an authority shown alone": ([first, second], "53"),
    }
    for why, (parts, nrc) in wrong.items():
        good.parts = parts
        assert good.log_in(ask) == f"7f29{nrc}", why
    good.parts = [own, first, second]
    assert good.log_in(ask) == "6903120000"


def test_a_root_may_say_how_far_it_stands(make, tmp_path):
    certificates(tmp_path, path_length=0, more=[SIGNS])
    _, ask = make(root=False)
    assert ask("1003")
    assert Chain({}).log_in(ask) == "7f2952"
    assert Chain().log_in(ask) == "6903120000"


@pytest.mark.parametrize("options", [{"ca": False}, {"more": [SIGNS_NOT]}])
def test_what_signs_no_others_is_no_root(make, tmp_path, options):
    certificates(tmp_path, **options)
    with pytest.raises(Exception, match=r"authentication.roots\[0\].*signs no others"):
        make(root=False)


@pytest.mark.evidence("ISO 14229-1: 0x29 51")
def test_a_forgeable_signature_is_none(make):
    _, ask = make()
    assert ask("1003")
    key = ec.generate_private_key(ec.SECP256R1())
    builder = x509.CertificateBuilder().subject_name(name("x", "workshop")).issuer_name(ROOT).serial_number(7)
    builder = builder.public_key(key.public_key()).not_valid_before(NOW - DAY).not_valid_after(NOW + DAY)
    old = builder.sign(ROOT_KEY, hashes.SHA224()).public_bytes(serialization.Encoding.DER)
    assert show(ask, old) == "7f2951"


@pytest.mark.evidence("ISO 14229-1: 0x29 03", "ISO 14229-1: 0x29 24", "ISO 14229-1: 0x29 58")
def test_a_proof_is_of_this_challenge_and_this_key(make):
    rig, ask = make()
    assert ask("1003")
    key, certificate = a_tester()
    first = show(ask, certificate)
    other = show(ask, certificate)
    assert first != other
    assert prove(ask, signed(key, first)) == "7f2958", "of an earlier challenge: replayed"
    assert prove(ask, signed(key, other)) == "7f2924", "each challenge is good for one try"
    ours = show(ask, certificate)
    assert prove(ask, signed(ec.generate_private_key(ec.SECP256R1()), ours)) == "7f2958"
    assert ask("14ffffff") == "7f1434"
    rig.wait(1)
    kinds = {(each.action, each.outcome) for each in rig.gateway.memory.interventions()}
    assert ("authenticate", 0x58) in kinds


FEW = AUTH.replace("attempts = 255", "attempts = 3, delay_s = 4.0")


def wrong_proof(ask, shown=None):
    """Show a good certificate, and prove it with a signature of something else; returns the last answer."""
    key, certificate = shown or a_tester()
    ours = show(ask, certificate)
    return ours if isinstance(ours, str) else prove(ask, signed(key, b"something else"))


@pytest.fixture
def looks(monkeypatch):
    """Count what costs milliseconds of the loop: chains that are verified, and proofs."""
    counted = []
    verified, is_signed = Certificates.verified, authentication._is_signed
    monkeypatch.setattr(Certificates, "verified", lambda *given: counted.append("01") or verified(*given))
    monkeypatch.setattr(authentication, "_is_signed", lambda *given: counted.append("03") or is_signed(*given))
    return counted


@pytest.mark.evidence("ISO 14229-1: 0x29 36", "ISO 14229-1: 0x29 37")
def test_after_too_many_wrong_proofs_nothing_is_looked_at_until_the_delay_is_over(make, looks):
    rig, ask = make(FEW.replace("4.0", "60.0"))
    assert ask("1003")
    shown = a_tester()
    assert [wrong_proof(ask, shown) for _ in range(3)] == ["7f2958", "7f2958", "7f2936"]
    assert looks == ["01", "03"] * 3
    for _ in range(50):
        assert wrong_proof(ask, shown) == "7f2937"
    assert len(looks) == 6
    assert ask("3e00") == "7e00"
    rig.wait(60_000, step=1000)
    assert ask("1003")
    assert wrong_proof(ask, shown) == "7f2936", "one attempt after each delay"
    assert len(looks) == 8
    rig.wait(60_100, step=1000)
    assert ask("1003")
    assert log_in(ask) == "6903120000"
    assert wrong_proof(ask, shown) == "7f2958", "a right proof forgives"
    rig.wait(1)
    noted = [(each.action, each.outcome) for each in rig.gateway.memory.interventions()]
    assert noted.count(("lockout", 0x36)) == 2


@pytest.mark.evidence("ISO 14229-1: 0x29 37")
@pytest.mark.parametrize("shown", ["bad", "good"])
def test_certificates_without_a_proof_count_too(make, looks, shown):
    """Whoever has heard a good certificate can show it: it costs the same."""
    _, ask = make(FEW.replace("4.0", "60.0"))
    assert ask("1003")
    _, certificate = a_tester(serial=666 if shown == "bad" else 7)
    answers = [show(ask, certificate) for _ in range(30)]
    if shown == "bad":
        assert answers[:3] == ["7f2957", "7f2957", "7f2936"]
    else:
        assert all(isinstance(answer, bytes) for answer in answers[:3])
        assert answers[3] == "7f2936"
    assert set(answers[4:]) == {"7f2937"}
    assert looks == ["01"] * 3


@pytest.mark.evidence("ISO 14229-1: 0x29 count")
def test_wrong_proofs_outlast_restarts_and_reloads(make, tmp_path, looks):
    memory = tmp_path / "m.sqlite"
    rig, ask = make(FEW, memory=memory)
    for answer in ("7f2958", "7f2958", "7f2936"):
        assert ask("1003")
        assert wrong_proof(ask) == answer
        if answer == "7f2958":
            rig.gateway.store.close()  # as kill -9: nothing is ended, nothing written any more
            rig, ask = make(FEW, memory=memory)
    old = rig.gateway
    old.finish(rig.now)
    rig.gateway = Gateway(old.config, None, file=tmp_path / "rig.toml", store=old.store)
    rig.gateway.succeed(old)
    assert ask("1003")
    assert wrong_proof(ask) == "7f2937", "a reload"
    rig.gateway.store.close()
    rig, ask = make(FEW, memory=memory)
    assert ask("1003")
    rig.wait(3500)
    assert ask("1003")
    assert wrong_proof(ask) == "7f2937", "the whole delay again"
    rig.wait(600)
    assert ask("1003")
    assert log_in(ask) == "6903120000"


@pytest.mark.evidence("ISO 14229-1: 0x29 count")
def test_a_proof_is_counted_before_it_is_looked_at(make, tmp_path, monkeypatch):
    """Who cuts the power at the answer has used an attempt up all the same."""
    rig, ask = make(FEW, memory=tmp_path / "m.sqlite")
    seen = []

    def verified(*given):
        seen.append(rig.gateway.store.facts().get("attempts.authentication"))
        raise NegativeError(Nrc.CERTIFICATE_CHAIN)

    monkeypatch.setattr(Certificates, "verified", verified)
    assert ask("1003")
    assert wrong_proof(ask) == "7f2952"
    assert seen == [1]


@pytest.mark.evidence("ISO 14229-1: 0x29 36")
def test_wrong_proofs_count_for_all_addresses_and_challenges_asked_for_before_are_no_way_around(make):
    further = "further = [{ request = 0x7E4, response = 0x7EC }]\n"
    rig, a = make(FEW + further)
    b = Asked(rig, 0x7E4, 0x7EC)
    assert a("1003")
    assert b("1003")
    key, certificate = a_tester()
    kept = show(b, certificate)
    assert wrong_proof(a) == "7f2958"
    assert wrong_proof(a) == "7f2936"
    assert prove(b, signed(key, kept)) == "7f2937"
    assert wrong_proof(b) == "7f2937"


@pytest.mark.evidence("ISO 14229-1: 0x29 21")
def test_one_look_a_turn_whoever_asks(make, looks):
    rig, _ = make(AUTH)
    testers = rig.gateway.local
    answers = []
    _, certificate = a_tester()
    request = bytes.fromhex("290100" + field(certificate) + field(b""))
    for k in range(5):
        testers.ask(1, "somebody", f"t{k}", ("self", b"\x10\x03"), lambda told: None)
        testers.ask(1, "somebody", f"t{k}", ("self", request), lambda told: answers.append(told[-1].hex()))
    testers.on_time(rig.now + 1)
    assert looks == ["01"]
    assert [answer[:6] for answer in answers] == ["690111", *["7f2921"] * 4]


def test_a_session_that_ends_takes_the_role_with_it(make):
    rig, ask = make()
    assert ask("1003")
    assert log_in(ask) == "6903120000"
    rig.wait(5100)
    assert ask("1003")
    assert ask("14ffffff") == "7f1434"
    assert log_in(ask) == "6903120000"
    assert ask("1003")
    assert ask("14ffffff") == "7f1434"


@pytest.mark.evidence("ISO 14229-1: NRC 34")
def test_roles_may_different_things(make):
    rules = (
        '[access]\nclear = { roles = ["workshop", "development"] }\ndtc_setting = { roles = ["development"] }\n'
        'read_data = { roles = ["development"] }\n'
    )
    rig, ask = make(more=rules)
    assert ask("1003")
    assert log_in(ask, "workshop") == "6903120000"
    assert ask("14ffffff") == "54"
    assert ask("8502") == "7f8534"
    assert ask("22f190") == "7f2234"
    assert log_in(ask, "development") == "6903120000"
    assert ask("8502") == "c502"
    assert ask("22f190").startswith("62f190")
    rig.wait(1)
    noted = [(each.action, each.role, each.outcome) for each in rig.gateway.memory.interventions()]
    assert ("clear", "workshop", 0) in noted
    assert ("dtc_setting", "workshop", 0x34) in noted
    assert ("dtc_setting", "development", 0) in noted


def test_a_role_and_a_key_may_both_be_needed(make):
    level = 'security = [{ level = 1, secret = "00" }]\n'
    _, ask = make(AUTH + level, '[access]\nclear = { security = 1, roles = ["workshop"] }\n')
    assert ask("1003")
    assert ask("14ffffff") == "7f1434"
    assert log_in(ask) == "6903120000"
    assert ask("14ffffff") == "7f1433"


def test_other_protocols_do_not_get_around_it(make):
    rig, _ = make(more=SERVERS)
    rig.wait(300)
    rig.fail(0)
    assert by_mode_04(rig) == "7f0422"
    assert by_j1939(rig, 0xFED3) == 2
    assert rig.status(0) == 0x2F


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        ("29", "7f2913"), ("2902", "7f2912"), ("2901", "7f2913"), ("290100", "7f2913"), ("2901000001", "7f2913"),
        ("29010000000000ff", "7f2913"), ("290101000141000142", "7f2931"), ("2903", "7f2913"), ("290300", "7f2913"),
        ("290800", "7f2913"), ("29000000", "7f2913"), ("290300014100", "7f2913"),
    ],
)  # fmt: skip
def test_malformed_requests(make, request_, expected):
    _, ask = make()
    assert ask("1003")
    assert ask(request_) == expected


def test_it_is_not_offered_without_roots(tmp_path):
    rig = Rig(write_config(tmp_path, extra="[output.uds]\n"))
    assert Asked(rig)("2908") == "7f2911"
    rig.close()


def test_what_is_wrong_in_the_configuration(make, tmp_path):
    with pytest.raises(Exception, match=r"authentication.roots\[0\]"):
        make(AUTH.replace("root.pem", "nowhere.pem"))
    (tmp_path / "text.pem").write_text("hello")
    with pytest.raises(Exception, match="no certificate in PEM"):
        make(AUTH.replace("root.pem", "text.pem"))
    with pytest.raises(Exception, match="workshop"):
        make(more='[access]\nclear = { roles = ["workshp"] }\n')
    with pytest.raises(Exception, match=r"output.uds.write.roles\[0\]"):
        make(AUTH + 'write = { roles = ["nobody"] }\n')
    with pytest.raises(Exception, match="never be met"):
        make(more='[access]\nsession = { roles = ["workshop"] }\n')

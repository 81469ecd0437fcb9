"""AES, CMAC and secured payloads beside vectors, cryptography and cantools."""

import random

import numpy as np
import pytest
from amount import examples
from cryptography.hazmat.primitives.ciphers import Cipher
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.ciphers.modes import ECB
from secured import secured, write_key

from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.cmac import Mac, encrypted, key_table, mac_of, rounds_table
from gateway.signals.protection.protection import Protection, ProtectionConst, Tables, fill, protect
from gateway.signals.protection.secoc import SecocCheck

#: RFC 4493, 4: the key, and the message of 64 bytes of which the first ones are taken; NIST SP 800-38B has the same.
RFC_KEY = bytes.fromhex("2b7e151628aed2a6abf7158809cf4f3c")
RFC_MESSAGE = bytes.fromhex(
    "6bc1bee22e409f96e93d7e117393172aae2d8a571e03ac9c9eb76fac45af8e51"
    "30c81c46a35ce411e5fbc1191a0a52eff69f2445df4f9b17ad2b417be66c3710"
)
RFC_TAGS = {
    0: "bb1d6929e95937287fa37d129b756746",
    16: "070a16b46b4d4144f79bdd9dd04a287c",
    40: "dfa66747de9ae63030ca32611497c827",
    64: "51f0bebf7e3b9d92fc49741779363cfe",
}


def prepared(protection):
    tables, rows = Tables(), np.zeros(1, ProtectionConst.dtype)
    fill(rows[0], protection, tables)
    return rows.view(np.recarray)[0], tables.array()


def block(key, data):
    columns = [np.uint64(int.from_bytes(data[k : k + 4], "big")) for k in range(0, 16, 4)]
    return b"".join(int(c).to_bytes(4, "big") for c in encrypted(*columns, key_table(key), rounds_table()))


def test_the_vector_of_fips_197():
    key, data = bytes(range(16)), bytes.fromhex("00112233445566778899aabbccddeeff")
    assert block(key, data).hex() == "69c4e0d86a7b0430d8cdb78070b4c55a"


def test_random_blocks_beside_cryptography():
    rng = random.Random(53)
    for _ in range(examples(500)):
        key, data = rng.randbytes(16), rng.randbytes(16)
        assert block(key, data) == Cipher(AES(key), ECB()).encryptor().update(data)


@pytest.mark.evidence("AUTOSAR E2E: SecOC MAC")
@pytest.mark.parametrize("length", RFC_TAGS)
def test_the_vectors_of_rfc_4493(length):
    field = np.zeros(1, ProtectionConst.dtype)[0]["field"]
    field["length"] = 64
    row, tables = prepared(Protection(Checksum(mac=Mac(RFC_KEY), last=length), field))
    words = np.frombuffer(RFC_MESSAGE, "<u8").copy()
    assert f"{int(mac_of(words, np.uint64(0), row.checksum, tables)):016x}" == RFC_TAGS[length][:16]


def test_payloads_of_any_lengths_are_those_of_cantools_and_cryptography(tmp_path):
    rng, tried = random.Random(4493), 0
    for _ in range(examples(400)):
        key, length = rng.randbytes(16), rng.choice([5, 8, 12, 16, 24, 32, 48, 64])
        bits = rng.randrange(65)
        truncated, mac = rng.randrange(bits + 1), rng.randrange(16, 65)
        tail = (truncated + mac + 7) // 8
        if tail >= length or not bits or not truncated:  # cantools packs no field without bits
            continue
        start = rng.randrange(max((1 << min(bits, 62)) - 8, 1))
        asked = SecocCheck(
            profile=1, key=tmp_path / write_key(tmp_path, key), data_id=rng.randrange(1 << 16), freshness=bits,
            truncated=truncated, mac=mac, start=start,
        )  # fmt: skip
        message = type("Message", (), {"length": length})
        row, tables = prepared(asked.protection(message))
        given = rng.randbytes(length)
        words = np.frombuffer(given.ljust(64, b"\xff"), "<u8").copy()
        protect(words, length, 5, row, tables)
        value = (start + 5) & ((1 << bits) - 1)
        expected = secured(
            given[: length - tail], value, data_id=asked.data_id, length=length, bits=bits, truncated=truncated,
            mac=mac, key=key,
        )  # fmt: skip
        assert words.tobytes()[:length] == expected, (bits, truncated, mac, length)
        tried += 1
    assert tried > 10, "or the test shows nothing"

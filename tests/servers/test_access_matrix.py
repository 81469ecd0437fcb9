"""Every service in every session, locked and unlocked, with and without its conditions: played, and compared with the
table of docs/security.md; and that page's tests are there.

``python tests/servers/test_access_matrix.py`` (with tests/support, tests/servers in PYTHONPATH) prints the table anew.
"""

import tempfile
from pathlib import Path

import pytest
from rig import FUNCTIONAL, Rig, Tester, write_config
from test_access import LEVEL, STANDS, by_j1939, by_mode_04, unlock
from uds_tester import EXTRA, Asked

from gateway.servers.access import FREE, GUARDED
from gateway.servers.uds.services import SERVICES

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/security.md"

#: Requests that are good but for who asks, and when.
ROWS = {
    "10 01": "default session",
    "10 03": "extended session",
    "11 01": "reset",
    "14 FF FF FF": "clear",
    "19 02 FF": "read DTCs",
    "22 F1 90": "read data",
    "27 01": "seed",
    "28 00 01": "communication on",
    "28 03 01": "communication off",
    "2E 01 24 0A 0B": "write",
    "31 01 02 01": "routine: next operation cycle",
    "31 01 02 02": "routine: compact",
    "3E 00": "tester present",
    "85 01": "DTC setting on",
    "85 02": "DTC setting off",
    "86 01 02 08 19 02 08": "response on event",
    "04": "OBD mode 04",
    "DM3": "J1939",
    "DM11": "J1939",
}
#: Session, whether unlocked, whether the vehicle stands.
COLUMNS = [
    ("default", False, False), ("default", False, True), ("extended", False, False), ("extended", False, True),
    ("extended", True, False), ("extended", True, True),
]  # fmt: skip
MORE = "[output.obd]\n[output.j1939]\n" + STANDS


def cell(folder, request, session, unlocked, stands, *, locked_clear=True):
    """Return what a request is answered in a state: yes, or the negative response code."""
    uds = LEVEL if locked_clear else ""
    rig = Rig(write_config(folder, extra=EXTRA.format(uds=uds) + MORE))
    try:
        rig.wait(300)
        ask = Asked(rig)
        if session == "extended":
            assert ask("1003").startswith("5003")
        if unlocked:
            unlock(ask)
        if stands:
            rig.value(1, 0.0)
        if request.startswith("DM"):
            return {0: "yes", 1: "NACK", 2: "denied"}[by_j1939(rig, {"DM3": 0xFECC, "DM11": 0xFED3}[request])]
        answer = by_mode_04(rig) if request == "04" else ask(request.replace(" ", "")).split(" ")[-1]
        return answer[4:6].upper() if answer.startswith("7f") else "yes"
    finally:
        rig.close()


def matrix(folder):
    """Return the table as docs/security.md has it."""
    heads = [f"{s}{', unlocked' if u else ''}, {'stands' if v else 'moves'}" for s, u, v in COLUMNS]
    lines = [f"| request | what | {' | '.join(heads)} |", "|---|---|" + "---|" * len(COLUMNS)]
    for request, what in ROWS.items():
        cells = [cell(folder, request, *column) for column in COLUMNS]
        lines.append(f"| {request} | {what} | {' | '.join(cells)} |")
    return lines


@pytest.mark.long
def test_the_matrix_is_that_of_the_page(tmp_path):
    page = PAGE.read_text().splitlines()
    made = matrix(tmp_path)
    begin = page.index(made[0])
    assert page[begin : begin + len(made)] == made


def test_every_service_is_in_the_matrix():
    """0x29 needs certificates; tests/servers/test_authentication.py has it."""
    shown = {int(request[:2], 16) for request in ROWS if request[0] != "D" and request != "04"}
    assert shown == set(SERVICES) - {0x29}
    assert {*GUARDED.values(), *FREE.values()} - {0x29} <= shown


def test_without_security_others_clear_while_the_vehicle_stands(tmp_path):
    for request, moving in (("04", "22"), ("DM3", "NACK"), ("DM11", "NACK")):
        assert cell(tmp_path, request, "default", False, False, locked_clear=False) == moving
        assert cell(tmp_path, request, "default", False, True, locked_clear=False) == "yes"


def test_a_functional_request_opens_nothing(tmp_path):
    """What is refused to one is refused, or passed over, when all are asked."""
    rig = Rig(write_config(tmp_path, extra=EXTRA.format(uds=LEVEL) + MORE))
    tester = Tester(rig)
    for request in ("1101", "14ffffff", "280301", "2e01240a0b", "31010201", "8502"):
        answers = tester.exchange(bytes.fromhex(request), functional=FUNCTIONAL)
        assert not answers or answers[0][0] == 0x7F, request
    rig.close()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(*matrix(Path(folder)), sep="\n")

"""The example of docs/signals.md, a car of opendbc: taken from the page as it stands, frames by opendbc's packer."""

import math
import re
from pathlib import Path

import pytest
from car import Car as AnyCar

from gateway.bus.frames import empty, put
from gateway_commands.check import check

opendbc, packer = pytest.importorskip("opendbc"), pytest.importorskip("opendbc.can.packer")

PAGE = Path(__file__).parents[2] / "docs" / "signals.md"
SECTION = PAGE.read_text().split("## A car of opendbc in ten lines")[1].split("\n## ")[0]
BLOCKS = re.findall(r"```(?:toml)?\n(.*?)```", SECTION, re.DOTALL)


@pytest.fixture
def config(tmp_path):
    ten, relation, _ = BLOCKS
    text = (ten + relation).replace("socketcan:can0", "virtual:x").replace("opendbc/dbc/", f"{opendbc.DBC_PATH}/")
    path = tmp_path / "gateway.toml"
    path.write_text(text)
    return path


class Car(AnyCar):
    """A car whose messages opendbc packs, one each of them every 20 ms."""

    def __init__(self, config):
        super().__init__(config)
        self.packer, self.ticks = packer.CANPacker("vw_mqb"), 0

    def drive(self, seconds, without=(), change=lambda name, data: data, **values):
        """Drive for so long.

        Args:
            seconds: how long.
            without: messages that are not sent.
            change: a message's name, payload -> what is sent instead.
            values: of signals, instead of those of a healthy drive.
        """
        for _ in range(round(seconds / 0.02)):
            self.ticks += 1
            now = self.ticks * 0.02
            speed, angle = 50 + 20 * math.sin(now / 3), abs(200 * math.sin(now / 2))
            wheels = {f"ESP_{wheel}_Radgeschw_02": speed for wheel in ("HL", "HR", "VL", "VR")}
            sent = {"LWI_01": {"LWI_Lenkradwinkel": angle}, "ESP_21": {"ESP_v_Signal": speed}, "ESP_19": wheels}
            frames = empty(3)
            count = 0
            for name, healthy in sent.items():
                said = {signal: values.get(signal, value) for signal, value in healthy.items()}
                can_id, data, _ = self.packer.make_can_msg(name, 0, said)
                if name not in without:
                    put(frames, count, round(now * 1e9) + count, can_id, change(name, data))
                    count += 1
            self.gateway.feed(frames[:count])
        return self


def test_it_has_ten_lines():
    assert len(BLOCKS[0].strip().splitlines()) == 10


def test_check_says_what_the_page_says(config, capsys):
    assert check(config, schema_wanted=False, json=False) == 0
    said = capsys.readouterr().out.splitlines()
    for line in BLOCKS[2].strip("\n").splitlines():
        assert line in said


def test_a_healthy_drive_is_silent(config):
    car = Car(config).drive(20)
    assert car.failed() == []
    counters = car.gateway.engine.counters()
    assert (counters["decoded"], counters["crc_failed"]) == (3000, 0)


def flipped(name, data):
    return data[:5] + bytes([data[5] ^ 0x10]) + data[6:] if name == "LWI_01" else data


class Repeated:
    """Sends one payload of ESP_21 again and again."""

    def __init__(self):
        self.first = None

    def __call__(self, name, data):
        if name != "ESP_21":
            return data
        self.first = self.first or data
        return self.first


@pytest.mark.parametrize(
    ("fault", "dtc", "broken"),
    [
        ("can.LWI_01.crc", "83", {"change": flipped}),
        ("can.ESP_21.counter", "82", {"change": Repeated()}),
        ("can.ESP_21.timeout", "87", {"without": ("ESP_21",)}),
        ("car.ESP_v_Signal.high", "85", {"ESP_v_Signal": 400.0}),
        ("car.LWI_Lenkradwinkel.high", "85", {"LWI_Lenkradwinkel": 790.0}),
        ("speed.wheels", "64", {"ESP_v_Signal": 120.0}),
    ],
)
def test_faults_are_named(config, fault, dtc, broken):
    car = Car(config).drive(5).drive(2, **broken)
    (told,) = [e for e in car.of("dtc") if e["fault"] == fault and e["status"] & 1][:1]
    assert told["dtc"].endswith(f"-{dtc}")

"""The rest bus of a database of others between processes: bus, virtual ECUs, daemon, and a client of python-can.

cantools decodes what the client got; its monitor, and candump, read the same in the test kernel (vcan/test_restbus.py).
"""

import threading
from collections import Counter

import can
import pytest
import warm
from kernel_can import daemon, wait_for
from processes import GATEWAY, bus
from rest_bus_cars import CARS, REQUEST, RESPONSE, load, write

from gateway.bus.frames import ID_MASK
from gateway.config.load import load_config
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import load_scenario

pytestmark = pytest.mark.system

#: Database -> a fault from 2 s to 3 s, and the one fault of the configuration that sees it.
FAULTS = {
    "vw_mqb": ('kind = "counter"\nmessage = "ESP_21"', "can.ESP_21.counter"),
    "toyota_prius_2010_pt": ('kind = "checksum"\nmessage = "PCM_CRUISE"', "can.PCM_CRUISE.crc"),
    "tesla_model3_party": ('kind = "short"\nmessage = "DI_systemStatus"', "can.DI_systemStatus.length"),
}


class Listener:
    """A client of python-can that notes all that comes, and asks as a tester does until it is answered."""

    def __init__(self, bus):
        self._bus, self._over = bus, threading.Event()
        self.frames, self.answer, self.asking = [], None, False
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self):
        while not self._over.is_set():
            message = self._bus.recv(0.5)
            if message is not None:
                self.frames.append((message.arbitration_id, bytes(message.data)))
                if message.arbitration_id == RESPONSE[0]:
                    self.answer = self.answer or bytes(message.data)
            if self.asking and self.answer is None and len(self.frames) % 200 == 0:
                self._bus.send(can.Message(arbitration_id=REQUEST[0], data=REQUEST[1], is_extended_id=False))

    def count(self):
        """How many frames came of each identifier."""
        return Counter(can_id for can_id, _ in list(self.frames))

    def close(self):
        self._over.set()
        self._thread.join(60)


@pytest.mark.parametrize("car", FAULTS)
def test_a_rest_bus_of_others_on_loopback(car, tmp_path):
    database, (fault, seen_by) = load(car), FAULTS[car]
    more = f'[[fault]]\n{fault}\necu = "restbus"\nfrom_s = 2.0\nto_s = 3.0\n'
    config, scenario, sent, checked = write(tmp_path, car, database, seconds=4.0, more=more)
    _, rising, least = CARS[car]
    assert len(checked) >= least
    with bus(tmp_path) as uri, daemon(config, cwd=tmp_path, bus=uri) as running:
        host, _, port = uri.removeprefix("loopback:").rpartition(":")
        port = int(port.partition("/")[0])
        with can.Bus(interface="socketcand", host=host, port=port, channel="can0") as peer:
            listener = Listener(peer)
            try:
                listener.asking = True
                played = warm.run(
                    [*GATEWAY, "simulate", str(scenario), "--bus", uri],
                    cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False,
                )  # fmt: skip
                assert played.returncode == 0, played.stderr
                # As many as their cycles have in four seconds: the scenario's clock waits where the machine is busy.
                loaded = load_scenario(scenario)
                frames = player_of(loaded, load_config(loaded.config)).batches()
                wanted = Counter(int(can_id) & ID_MASK for _, batch in frames for can_id in batch["can_id"])
                wait_for(lambda: listener.count() >= wanted)
            finally:
                listener.close()
    assert running.code == 0
    events = [event for event in running.events() if event["event"] == "dtc"]
    assert {event["fault"] for event in events if event["status"] & 1} == {seen_by}, "and by no other"
    assert listener.answer is not None
    assert listener.answer[:5] == RESPONSE[1]
    came = listener.count()
    assert {can_id: came[can_id] for can_id in wanted} == dict(wanted)
    named = {message.frame_id: message for message in database.messages if message.name in sent}
    for can_id, data in listener.frames:
        if can_id in named:
            named[can_id].decode(
                data, decode_choices=False, allow_truncated=True
            )  # raises what it cannot; one is short
    for name in checked or sent:
        message = database.get_message_by_name(name)
        cycle_s = (message.cycle_time or 100) / 1e3
        assert came[message.frame_id] == pytest.approx(4.0 / cycle_s, abs=1), name
    if rising is not None:
        name, _, signal = rising.rpartition(".")
        message = database.get_message_by_name(name)
        values = [
            message.decode(data, decode_choices=False)[signal] for k, data in listener.frames if k == message.frame_id
        ]
        assert values == sorted(values)
        assert (values[0], values[-1]) == (pytest.approx(50, abs=2), pytest.approx(100, abs=2))

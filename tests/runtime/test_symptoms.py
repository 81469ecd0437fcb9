"""What explains an entry is stored with it; symptoms of a proven cause are held where that is asked for."""

import random

import pytest
from amount import amount
from shared_signal import config, frames

from gateway.faults import service
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare

HOLD = 'symptoms = "hold"'
SPEED = ["signal can0.Speed.V"]
RULES = ("rules.A", "rules.B", "rules.C")


class Car:
    """A gateway with its memory on the disk, and the car's time."""

    def __init__(self, folder, memory=HOLD, **more):
        self.folder, self.more, self.memory = folder, more, memory
        self.events, self.now_s = [], 0.0
        self.store = None
        self.begin()

    def begin(self):
        self.gateway = Gateway(config(self.folder, memory=self.memory, **self.more), self.folder / "m.sqlite")
        self.gateway.listen(self.events.append)
        self.gateway.start(round(self.now_s * 1e9))

    def drive(self, seconds, pieces=1, **off):
        fed, self.now_s = frames(self.now_s, self.now_s + seconds, **off), self.now_s + seconds
        for k in range(0, len(fed), -(-len(fed) // pieces)):
            self.gateway.feed(fed[k : k - (-len(fed) // pieces)])

    def key_off(self):
        self.gateway.stop(round(self.now_s * 1e9))
        self.gateway.close()

    def kill(self):
        self.gateway.store.close()

    def reload(self, memory=None, **more):
        self.memory, self.more = memory or self.memory, more or self.more
        new = config(self.folder, memory=self.memory, **self.more)
        self.gateway.finish(self.gateway.engine.now_ns)
        successor = Gateway(new, parts=prepare(new), store=self.gateway.store)
        successor.succeed(self.gateway)
        self.gateway = successor

    def status(self):
        return [int(self.gateway.memory.record(fault).status) for fault in RULES]

    def held(self):
        return [self.gateway.memory.record(fault).hold for fault in RULES]

    def told(self, kind="symptoms"):
        return [event for event in self.events if event["event"] == kind]


@pytest.fixture
def car(tmp_path):
    made = []

    def build(**options):
        made.append(Car(tmp_path, **options))
        return made[-1]

    yield build
    for each in made:
        each.gateway.close()


def test_each_entry_has_its_cause_in_the_file(car, tmp_path):
    one = car(memory="")
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    one.drive(7.0)
    assert one.status() == [0x2E, 0x2E, 0x2E], "symptoms are kept: each is confirmed"
    one.key_off()
    for entry in service.list_entries(tmp_path / "m.sqlite"):
        cause = entry["cause"]
        assert (cause["role"], cause["components"], cause["lead"]) == ("symptom", SPEED, "rules.A")
        assert cause["probability"] > 0.9, "its message may have frozen, too"
        assert cause["lead_dtc"] == service.show(tmp_path / "m.sqlite", cause["lead_dtc"])["dtc"]
        assert entry["hold"] == ""
    assert service.verify(tmp_path / "m.sqlite")["whole"]


def test_symptoms_are_held_and_their_lead_is_confirmed(car, tmp_path):
    one = car()
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    assert one.status() == [0x2F, 0x27, 0x27]
    assert one.held() == ["", "held", "held"]
    (told,) = one.told()
    assert (told["state"], told["faults"], told["cause"], told["lead"]) == (
        "held",
        ["rules.B", "rules.C"],
        SPEED,
        "rules.A",
    )
    assert one.gateway.summary(1.0)["counters"]["symptoms_held"] == 2
    one.drive(7.0)
    assert one.status() == [0x2E, 0x26, 0x26], "held in this cycle"
    one.key_off()
    assert {e["fault"]: e["hold"] for e in service.list_entries(tmp_path / "m.sqlite")} == dict(
        zip(RULES, ["", "held", "held"], strict=True)
    )


def test_what_nothing_explains_is_confirmed(car):
    """A's value alone is wrong: rule A fails, and whether A or Speed lies, two rules that pass say."""
    one = car()
    one.drive(5.0)
    one.drive(3.0, A=40)
    assert one.status()[0] == 0x2F
    assert one.held() == ["", "", ""]
    assert not one.told()


def test_two_that_nothing_tells_apart_are_confirmed(car):
    """One rule is left: Speed or A, nobody knows."""
    one = car(rules=("A",))
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    fault = one.gateway.memory.record("rules.A")
    assert (fault.status, fault.hold, fault.cause.role) == (0x2F, "", "open")


def test_a_symptom_is_released_when_another_cause_explains_what_is_left(car):
    """A and B follow Speed: they hold again, and C that alone does not is the one that is wrong, or its message."""
    one = car()
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    assert one.held() == ["", "held", "held"]
    one.drive(35.0, Speed=40, A=40, B=40)  # not proven: released when no slower test is waited for any more
    assert one.status() == [0x2E, 0x26, 0x2F], "released"
    assert [(told["state"], told["faults"]) for told in one.told()[1:]] == [("released", ["rules.C"])]
    assert one.gateway.memory.record("rules.C").cause.ranked[0].components == ("signal can0.C.V",)
    assert one.gateway.summary(1.0)["counters"]["symptoms_released"] == 1


def test_a_cause_stands_for_half_a_minute_while_its_symptoms_heal(car):
    """Of what A and B say no sizes are known: where they hold again, C that still fails could be Speed or C."""
    one = car(holds="{0}.V - Speed.V < 5 and Speed.V - {0}.V < 5")
    one.drive(5.0)
    one.drive(40.0, Speed=40)  # however long it has been there
    assert one.held() == ["", "held", "held"]
    one.drive(28.0, Speed=40, A=40, B=40)
    (group,) = one.told("diagnosis")[-1]["groups"]
    assert (group["failed"], group["cause"]) == (["rules.C"], None)
    cause = one.gateway.memory.record("rules.C").cause
    assert (cause.role, cause.components, one.held()[2]) == ("symptom", tuple(SPEED), "held")
    one.drive(7.0, Speed=40, A=40, B=40)
    assert one.gateway.memory.record("rules.C").cause.role == "open"
    assert one.status()[2] == 0x2F, "released"
    assert [(told["state"], told["faults"]) for told in one.told()[1:]] == [("released", ["rules.C"])]


def test_a_silent_bus_is_confirmed_when_the_diagnosis_has_spoken(car):
    one = car()
    one.drive(5.0)
    one.gateway.advance(60_000_000_000)
    fails, confirmed = (e for e in one.told("dtc") if e["fault"] == "can0.bus_silent")
    assert (fails["status"] & 0x09, confirmed["status"] & 0x09) == (0x01, 0x09)
    assert 5.0e9 < fails["t_ns"] <= confirmed["t_ns"] - 1e8 < 6.0e9


def test_a_second_fault_withdraws_the_cause(car):
    """C is off, too, at first as Speed is, so that its rule holds: nothing is held that the cause does not explain."""
    one = car(checks=())
    one.drive(5.0)
    one.drive(3.0, Speed=40, C=40)
    assert one.status()[2] & 0x2F == 0
    one.drive(8.0, Speed=40, C=-80)
    states = dict(zip(RULES, zip(one.status(), one.held(), strict=True), strict=True))
    for fault, (status, hold) in states.items():
        cause = one.gateway.memory.record(fault).cause
        assert bool(status & 0x08) == (not hold)
        assert hold != "held" or (cause.role == "symptom" and cause.lead != fault)
        assert cause.components != tuple(SPEED)


def test_a_process_that_is_killed_while_a_confirmation_waits_has_it_confirmed_by_the_next(car):
    one = car()
    one.drive(5.0)
    one.drive(0.53, Speed=40)
    assert one.status() == [0x27, 0x27, 0x27]
    assert one.held() == ["waiting"] * 3
    one.kill()
    one.begin()
    assert [status & 0x0C for status in one.status()] == [0x0C] * 3
    assert one.held() == [""] * 3


def test_a_process_that_ends_while_a_confirmation_waits_looks_once_more(car):
    one = car()
    one.drive(5.0)
    one.drive(0.53, Speed=40)
    one.key_off()
    assert [status & 0x08 for status in one.status()] == [0x08, 0, 0]
    assert one.held() == ["", "held", "held"]


def test_what_is_held_stays_so_in_the_next_process_and_goes_with_a_clean_cycle(car):
    one = car()
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    one.key_off()
    one.begin()
    assert one.held() == ["", "held", "held"]
    assert [status & 0x08 for status in one.status()] == [0x08, 0, 0]
    one.drive(3.0, Speed=40)
    assert one.status() == [0x2F, 0x27, 0x27], "it fails again, and is explained again"
    one.drive(7.0)
    one.key_off()
    one.begin()
    one.drive(10.0)
    one.key_off()
    assert one.held() == [""] * 3, "it is not pending any more: there is nothing to hold"
    assert [status & 0x0C for status in one.status()] == [0x08, 0, 0]


def test_after_a_clear_of_the_lead_another_entry_stands_for_the_cause(car):
    one = car()
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    lead = next(d.dtc.value for d in one.gateway.catalogue if d.id == "rules.A")
    assert one.gateway.controls.clear(lead)
    one.drive(0.3, Speed=40)
    assert [status & 0x08 for status in one.status()].count(0x08) == 1
    one.drive(3.0, Speed=40)
    assert [status & 0x08 for status in one.status()].count(0x08) == 1
    assert one.held().count("held") == 2
    assert one.gateway.controls.clear(0xFFFFFF)
    assert one.held() == [""] * 3
    assert all(one.gateway.memory.record(fault).cause is None for fault in RULES)
    one.drive(3.0, Speed=40)
    assert one.status() == [0x2F, 0x27, 0x27]


def test_a_reload_that_keeps_symptoms_confirms_what_was_held(car):
    one = car()
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    one.reload(HOLD)
    one.drive(1.0, Speed=40)
    assert one.held() == ["", "held", "held"]
    one.reload('symptoms = "keep"')
    one.drive(0.1, Speed=40)
    assert one.status() == [0x2F] * 3
    assert one.told()[-1]["state"] == "released"
    one.reload(HOLD)
    one.drive(1.0, Speed=40)
    assert one.status() == [0x2F] * 3, "what is confirmed stays confirmed"


def test_a_reload_without_one_of_the_faults_goes_on_with_the_others(car):
    one = car()
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    one.reload(rules=("A", "B"))
    assert one.gateway.memory.record("rules.C").hold == "", "nobody can explain it any more"
    assert one.gateway.memory.record("rules.C").status & 0x08
    one.drive(3.0, Speed=40)
    assert [status & 0x0D for status in one.status()[:2]] in ([0x0D, 0x05], [0x0D, 0x0D])
    one.drive(7.0)
    one.key_off()


def test_what_is_cleared_and_fails_at_once_has_its_cause_again(car):
    """It fails before the causes are looked at: no diagnosis has changed."""
    one = car()
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    code = next(d.dtc.value for d in one.gateway.catalogue if d.id == "rules.B")
    told = len(one.told("diagnosis"))
    assert one.gateway.controls.clear(code)
    index = [slot.id for slot in one.gateway.engine.faults].index("rules.B")
    one.gateway.engine.report(index, True, 1.0, 0.0, (), one.gateway._verdicts.take)
    for _ in range(200):
        one.gateway.engine.report(index, True, 1.0, 0.0, (), one.gateway._verdicts.take)
    one.drive(3.0, Speed=40)
    assert one.status() == [0x2F, 0x27, 0x27]
    assert one.held()[1] == "held"
    print("diagnoses", told, len(one.told("diagnosis")))


def test_a_new_operation_cycle_asks_anew(car):
    one = car()
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    one.gateway.controls.restart_cycle()
    assert one.status() == [0x6D, 0x65, 0x65]
    one.drive(3.0, Speed=40)
    assert one.status() == [0x2F, 0x27, 0x27]
    assert one.held() == ["", "held", "held"]


def test_no_lamp_stays_dark(car):
    lit = '[fault."rules.B"]\nindicator = true\n'
    one = car(more=lit)
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    assert one.status() == [0x2F, 0xAF, 0x27]


def test_where_the_lead_takes_more_cycles_nothing_is_held(car):
    slow = '[fault."rules.A"]\nconfirm_cycles = 2\n'
    one = car(more=slow)
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    assert one.status() == [0x27, 0x2F, 0x2F]


def test_a_freeze_frame_of_the_confirmation_is_that_of_the_failure(car):
    frozen = '[fault."rules.A"]\nfreeze_frame = ["Speed.V"]\nfreeze_frame_at = "confirmed"\n'
    one = car(more=frozen)
    one.drive(5.0)
    one.drive(3.0, Speed=40)
    (frame,) = one.gateway.memory.entry("rules.A").freeze_frames
    assert frame.content == {"Speed.V": 90.0}
    assert frame.t_ns == one.gateway.memory.entry("rules.A").record.first_ns


@pytest.mark.parametrize("pieces", [7, 150])
def test_it_is_the_same_however_the_frames_come(tmp_path, pieces):
    told = []
    for k in (1, pieces):
        folder = tmp_path / str(k)
        folder.mkdir()
        one = Car(folder)
        for seconds, off in ((5.0, {}), (3.0, {"Speed": 40}), (4.0, {"Speed": 40, "A": 40, "B": 40}), (8.0, {})):
            one.drive(seconds, k, **off)
        one.key_off()
        events = [
            event for event in one.events if not event.get("fault", "").startswith("gateway.")
        ]  # at ends of batches
        told.append((events, [(e.status, e.record.hold, e.record.cause) for e in one.gateway.memory.entries()]))
    assert told[0] == told[1]
    assert [event for event in told[0][0] if event["event"] == "symptoms"]


@pytest.mark.parametrize("seed", range(amount(100, 4, 1)))
def test_held_differs_from_kept_only_in_confirmation(tmp_path, seed):
    """Random faults, clears, key cycles, kills and reloads: the other bits are those of a gateway that keeps them."""
    print("seed", seed)
    rng = random.Random(seed)
    both = []
    for mode in ("keep", "hold"):
        (tmp_path / mode).mkdir()
        both.append(Car(tmp_path / mode, f'symptoms = "{mode}"'))
    codes = [next(d.dtc.value for d in both[0].gateway.catalogue if d.id == fault) for fault in RULES]

    def each(step):
        for one in both:
            step(one)

    def restart(one):
        one.key_off()
        one.begin()

    def kill(one):
        one.kill()
        one.begin()

    held = False
    for _ in range(12):
        off = {name: rng.choice([40, -40]) for name in ("Speed", "A", "B", "C") if rng.random() < 0.3}
        seconds = rng.choice([0.3, 0.7, 2.0, 5.0])
        each(lambda one, s=seconds, o=off: one.drive(s, **o))
        step = rng.choice(["", "", "restart", "kill", "clear", "clear_one", "cycle", "reload"])
        code = rng.choice(codes)
        if step == "restart":
            each(restart)
        elif step == "kill":
            each(kill)
        elif step.startswith("clear"):
            each(lambda one, c=code if step == "clear_one" else 0xFFFFFF: one.gateway.controls.clear(c))
        elif step == "cycle":
            each(lambda one: one.gateway.controls.restart_cycle())
        elif step == "reload":
            each(lambda one: one.reload())
        keep, hold = both[0].status(), both[1].status()
        held |= "held" in both[1].held()
        for kept, got, state in zip(keep, hold, both[1].held(), strict=True):
            assert kept & ~0x08 == got & ~0x08, (step, off, keep, hold)
            assert kept & 0x08 >= got & 0x08
            assert not (state and got & 0x08)
    each(lambda one: one.key_off())
    assert "waiting" not in both[1].held()
    if not held:
        assert both[0].status() == both[1].status()

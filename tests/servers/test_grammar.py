"""Requests of a grammar, right and nearly right, by UDS, OBD and J1939, while 4000 frames/s are monitored.

Beside mutations of whole requests (``test_fuzz.py``): these know the shape of each service, so that most get behind
the first checks. 2 x 10^5 of them with GATEWAY_TESTS=full; GATEWAY_GRAMMAR sets the number. Nothing may crash or grow,
each request that is owed an answer gets it with its own frame (the time of the bus) and within P2 of CPU time, and what
the monitors find is found.
"""

import os
import random

import numpy as np
import pytest
from amount import amount
from grammar import CONFIG, MESSAGES, Grammar, Traffic, is_single
from held import held
from rig import REQUEST, Rig, write_config

TOTAL = int(float(os.environ.get("GATEWAY_GRAMMAR", "0"))) or amount(200_000, 2_000, 400)
P2_S = 0.050


@pytest.mark.long
@pytest.mark.timeout(7200)  # the full size
def test_requests_of_a_grammar_while_frames_are_monitored(tmp_path):
    seed = 80
    print(f"seed {seed}")
    rng = random.Random(seed)
    rig = Rig(write_config(tmp_path, MESSAGES, extra=CONFIG), heard=False)
    traffic, grammar = Traffic(rig, rng, 2 * TOTAL + 1000), Grammar(rng)
    rig.wait(300)
    found = 0

    def play(rounds):
        nonlocal found
        for n in range(rounds):
            traffic.monitored()
            if n % 7 == 0:
                rig.feed(grammar.noise())
                rig.feed(grammar.noise())
            else:
                can_id = rng.choice((REQUEST, REQUEST, REQUEST, 0x7E4))
                traffic.ask(grammar.request(), can_id)
            traffic.settle()
            if n % 100 == 99:
                found += finds(rig, traffic)
                traffic.forget()

    play(TOTAL // 4)
    play(TOTAL // 4)
    before = held()
    play(TOTAL // 2)
    after = held()
    objects, large_bytes = (late - early for late, early in zip(after, before, strict=True))
    slow = np.quantile(traffic.cpu_s[: traffic.asked], (0.5, 0.99, 1.0))
    print(f"{traffic.asked} requests among {traffic.fed} frames, {found} faults found; grown by {objects} objects and")
    print(f"{large_bytes} bytes in the second half; CPU of a request: median, 99 %, most {np.round(slow * 1e3, 2)} ms")
    assert objects < 3_000
    assert large_bytes < 300_000
    assert found == TOTAL // 4 // 100 * 2 + TOTAL // 2 // 100
    assert slow[1] < P2_S
    rig.close()


def finds(rig, traffic):
    """Let all be idle, then see whether a fault is found, told and read; returns 1."""
    rig.wait(6000, step=1000)  # sessions, transfers and what they had switched off are over
    for can_id in (REQUEST, 0x7E4):
        traffic.ask(b"\x86\x06\x02", can_id)  # else what is found next is answered, and that answer waits for a tester
    for _ in range(60):
        traffic.monitored()
    for _ in range(3):
        traffic.monitored(failing=(3,))
    assert rig.status(3) & 0x01, "what the monitors find is found"
    assert traffic.ask(b"\x3e\x00") == [bytes.fromhex("027e00cccccccccc")]
    answer = traffic.ask(b"\x19\x01\x01")
    assert answer[0][:4] == bytes.fromhex("065901ff")
    for _ in range(60):
        traffic.monitored()
    assert not rig.status(3) & 0x01
    return 1


def test_each_request_that_is_owed_an_answer_gets_it_with_its_own_frame(tmp_path):
    rng = random.Random(81)
    rig = Rig(write_config(tmp_path, MESSAGES, extra=CONFIG))
    traffic, grammar = Traffic(rig, rng), Grammar(rng)
    owed = 0
    for _ in range(min(TOTAL, 1500)):
        traffic.monitored()
        request = grammar.request()
        if not is_single(request):
            continue
        answers = traffic.ask(request)
        suppressed = request[0] in (0x10, 0x11, 0x19, 0x27, 0x28, 0x31, 0x3E, 0x85, 0x86) and request[1:2] >= b"\x80"
        if not suppressed:
            assert len(answers) >= 1, request.hex()
            owed += 1
        traffic.settle()
    assert owed > min(TOTAL, 1500) // 3
    rig.close()

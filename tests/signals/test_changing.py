"""A signal that is read and changed in a payload, as cantools reads and writes it."""

import cantools
import numpy as np
import pytest

from gateway.bus.frames import empty, put
from gateway.signals.database import load_database
from gateway.signals.signal_access import ChangedSignal, words_of

SEED = 5902
DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 256 M: 8 A
 SG_ Little : 3|11@1+ (0.5,-20) [0|0] "V" B
 SG_ Big : 23|12@0- (0.25,0) [0|0] "V" B
 SG_ Last : 40|16@1- (1,7) [0|0] "V" B
BO_ 257 Paged: 8 A
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" B
 SG_ Other m0 : 8|16@1+ (1,0) [0|0] "V" B
 SG_ One m1 : 8|12@1+ (0.5,0) [0|0] "V" B
"""
PLACES = (("M", "Little"), ("M", "Big"), ("M", "Last"), ("Paged", "One"))


@pytest.mark.parametrize(("message", "name"), PLACES)
def test_one_signal_is_changed_and_no_other(tmp_path, message, name):
    (tmp_path / "own.dbc").write_text(DBC)
    database, theirs = load_database([tmp_path / "own.dbc"]), cantools.database.load_string(DBC, "dbc")
    rng = np.random.default_rng(SEED)
    changed = ChangedSignal(0, database, message, name)
    random = rng.integers(0, 256, (40, 8), np.uint8)
    random[:, 0] = np.where(message == "Paged", 1, random[:, 0])
    for data, other in zip(random[:20], random[20:], strict=True):
        frames = empty(1)
        put(frames, 0, 0, theirs.get_message_by_name(message).frame_id, data.tobytes())
        before, words = theirs.decode_message(message, data.tobytes()), words_of(frames[0])
        assert changed.value(words, 8) == changed.values(frames)[0] == before[name], SEED
        new = theirs.decode_message(message, other.tobytes())[name]
        changed.put(words, new)
        assert theirs.decode_message(message, words.tobytes()[:8]) == {**before, name: new}, SEED

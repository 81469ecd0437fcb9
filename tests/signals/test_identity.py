"""Names that a database gives twice: exact names beside them, and the identifier that one of two messages has."""

import pytest
from car import HEAD, Car, write

from gateway.bus.frames import EXTENDED, FD, empty, put
from gateway.signals.database import load_database
from gateway.signals.payloads import decode_columns, message_rows
from gateway.signals.signal_access import ChangedSignal, words_of
from gateway.signals.tables import compile_plan
from gateway_commands.check import check
from gateway_fdi.errors import InputError

J1939 = (
    'BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    'BA_DEF_DEF_  "VFrameFormat" "J1939PG";\n'
)
KCD = """<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0">
<Document name="d"/>
<Bus name="Motor"><Message id="0x100" length="8" name="M"><Signal name="Speed" offset="0" length="8"/></Message></Bus>
<Bus name="Body"><Message id="0x100" length="8" name="M"><Signal name="Door" offset="8" length="8"/></Message></Bus>
</NetworkDefinition>
"""


def message(number, name, *signals):
    lines = "".join(f' SG_ {signal}@1+ (1,0) [0|0] "" B\n' for signal in signals)
    return f"BO_ {number} {name}: 8 A\n{lines}"


def database_of(folder, *texts, suffix=".dbc"):
    paths = [folder / f"{k}{suffix}" for k in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(HEAD + text if suffix == ".dbc" else text)
    return load_database(paths)


def said(database, can_id, data, **options):
    """Return what a frame says: the message, and the values of the signals that are there."""
    plan = compile_plan([(0, database)], **options)
    frames = empty(1)
    put(frames, 0, 0, can_id, data, flags=FD * (len(data) > 8))
    row = int(message_rows(frames, plan)[0])
    if row < 0:
        return None, {}
    found, name = decode_columns(frames, plan, row), plan.message_names[row][1]
    places = {ref.signal: place for ref, place in plan.positions.items() if ref.message == name}
    return name, {signal: found.values[place, 0] for signal, place in places.items() if found.there[place, 0]}


def test_a_multiplexer_of_more_than_32_letters_selects_by_its_long_name(tmp_path):
    """cantools 45.1 renames the multiplexer alone: to it the selected signals are never there."""
    short, long = "A_multiplexer_of_more_than_32_le", "A_multiplexer_of_more_than_32_letters"
    other, second = "A_multiplexer_of_more_than_32_l2", "A_multiplexer_of_more_than_32_letters_2"
    text = message(256, "M", f"{short} M : 0|8", "S0 m0 : 8|8") + message(257, "N", f"{other} M : 0|8", "S1 m1 : 8|8")
    text += 'BA_DEF_ SG_ "SystemSignalLongSymbol" STRING ;\nBA_DEF_DEF_ "SystemSignalLongSymbol" "";\n'
    text += f'BA_ "SystemSignalLongSymbol" SG_ 256 {short} "{long}";\n'
    text += f'BA_ "SystemSignalLongSymbol" SG_ 257 {other} "{second}";\n'
    database = database_of(tmp_path, text)
    assert said(database, 256, bytes([0, 17])) == ("M", {long: 0, "S0": 17})
    assert said(database, 257, bytes([1, 18])) == ("N", {second: 1, "S1": 18})


def test_one_group_of_two_sources_is_told_apart_by_the_source_then_by_the_group(tmp_path):
    engine, cluster = 0x18FEF100, 0x18FEF117
    text = message(engine | EXTENDED, "Engine", "Speed : 8|8") + message(cluster | EXTENDED, "Cluster", "Level : 8|8")
    database = database_of(tmp_path, text + J1939)
    assert said(database, engine | EXTENDED, b"\0\1") == ("Engine", {"Speed": 1})
    assert said(database, cluster | EXTENDED, b"\0\2") == ("Cluster", {"Level": 2})
    assert said(database, 0x0CFEF117 | EXTENDED, b"\0\2")[0] == "Cluster", "of another priority"
    assert said(database, 0x18FEF142 | EXTENDED, b"\0\3")[0] == "Engine", "of a source that none names"


def test_a_message_of_any_source_takes_those_that_none_names(tmp_path):
    text = message(0x18FEF100 | EXTENDED, "Engine", "Speed : 8|8") + message(0x18FEF1FE | EXTENDED, "Any", "V : 8|8")
    database = database_of(tmp_path, text + J1939)
    assert said(database, 0x18FEF142 | EXTENDED, b"\0\3")[0] == "Any"
    assert said(database, 0x18FEF100 | EXTENDED, b"\0\3")[0] == "Engine"


def test_of_two_messages_of_one_identifier_the_first_is_decoded_and_it_is_told(tmp_path):
    text = message(256, "M1", "S1 : 0|16") + message(256, "M2", "S2 : 16|16") + message(257, "M3", "S3 : 0|16")
    database = database_of(tmp_path, text)
    assert said(database, 257, bytes([1, 0])) == ("M3", {"S3": 1})
    assert said(database, 256, bytes([1, 0, 2, 0])) == ("M1", {"S1": 1})
    assert database.notes == ["M1 and M2 have the identifier 0x100: frames of it are decoded as M1"]
    ref = [(0, "M2", "S2")]
    plan = compile_plan([(0, database)], [type(next(iter(compile_plan([(0, database)]).positions)))(*ref[0])])
    assert plan.message_names == ((0, "M2"),), "who names the other one gets it"


def test_equal_messages_of_two_files_are_one(tmp_path):
    common = message(256, "Common", "S1 : 0|16")
    database = database_of(tmp_path, common + message(257, "A", "S1 : 0|16"), common + message(258, "B", "S1 : 0|16"))
    assert [each.name for each in database] == ["Common", "A", "B"]
    assert database.notes == []


def test_different_messages_of_one_name_have_it_with_their_identifier(tmp_path):
    database = database_of(tmp_path, message(256, "M", "S : 0|16"), message(257, "M", "S : 8|16"))
    assert said(database, 256, bytes([1, 0])) == ("M_0x100", {"S": 1})
    assert said(database, 257, bytes([0, 1, 0])) == ("M_0x101", {"S": 1})
    with pytest.raises(InputError, match=r"several messages have this name: write M_0x100 \(in .*0.dbc\) or M_0x101"):
        database.message("M")
    assert database.notes == ["several messages have the name M: M_0x100 and M_0x101"]


def test_an_exact_name_is_never_one_that_another_message_has(tmp_path):
    text = message(256, "M", "S : 0|8"), message(257, "M", "T : 0|8") + message(258, "M_0x101", "U : 0|8")
    database = database_of(tmp_path, *text)
    assert said(database, 257, b"\1") == ("M_0x101_", {"T": 1})
    assert said(database, 258, b"\1") == ("M_0x101", {"U": 1})


def test_a_bus_of_a_file_of_several_is_chosen(tmp_path):
    database = database_of(tmp_path, KCD, suffix=".kcd")
    (note,) = [note for note in database.notes if "identifier" in note]
    assert "of the buses Body and Motor: choose one" in note
    (tmp_path / "car.kcd").write_text(KCD)
    assert said(load_database([tmp_path / "car.kcd#Body"]), 256, b"\0\5") == ("M", {"Door": 5})
    with pytest.raises(InputError, match="did you mean Motor"):
        load_database([tmp_path / "car.kcd#Moto"])


@pytest.mark.parametrize("of", ['{ file = "car.kcd", bus = "Body" }', '"car.kcd#Body"'])
def test_a_configuration_chooses_a_bus_of_a_file(tmp_path, of):
    (tmp_path / "car.kcd").write_text(KCD)
    config = tmp_path / "gateway.toml"
    monitor = '[[monitor]]\nname = "m"\ntype = "signal"\nsignal = [{ signal = "M.Door", plausible = [0, 3] }]\n'
    bus = f'[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = [{of}]\nhealth = {{ watched = false }}\n'
    config.write_text(f"[clock]\nwatched = false\n{bus}{monitor}")
    assert Car(config).feed([bytes([0, 9, 0, 0, 0, 0, 0, 0])] * 100).failed() == ["Door.high"]


TWICE = message(256, "M", "Mux M : 0|8", "Temp m0 : 8|8", "Temp m1 : 16|8", "Other m1 : 24|8")


def test_a_name_in_two_branches_is_one_signal_and_each_has_an_exact_name(tmp_path):
    database = database_of(tmp_path, TWICE)
    assert said(database, 256, bytes([0, 0x11, 0x22, 0, 0, 0, 0, 0])) == ("M", {"Mux": 0, "Temp": 0x11})
    assert said(database, 256, bytes([1, 0x12, 0x33, 0, 0, 0, 0, 0])) == ("M", {"Mux": 1, "Temp": 0x33, "Other": 0})
    assert said(database, 256, bytes([1, 0x12])) == ("M", {"Mux": 1}), "that of its branch is beyond the end"
    assert database.notes == ["M has signals of one name in several branches: Temp (Temp_m0 or Temp_m1)"]


@pytest.mark.parametrize(("name", "failed"), [("Temp", True), ("Temp_m1", True), ("Temp_m0", False)])
def test_a_configuration_names_one_of_them_exactly(tmp_path, name, failed):
    monitor = f'[[monitor]]\nname = "m"\ntype = "signal"\nsignal = [{{ signal = "M.{name}", plausible = [0, 50] }}]\n'
    monitor += f'[[monitor]]\nname = "r"\ntype = "rule"\nrule = [{{ name = "r", holds = "M.{name} < 50" }}]\n'
    car = Car(write(tmp_path, TWICE, monitor))
    car.feed([bytes([0, 10, 99, 0, 0, 0, 0, 0])] + [bytes([1, 10, 99, 0, 0, 0, 0, 0])] * 400)
    assert (len(car.failed()) == 2) == failed
    assert bool(car.failed()) == failed


def test_a_value_is_put_where_the_branch_of_the_frame_has_it(tmp_path):
    changed = ChangedSignal(0, database_of(tmp_path, TWICE), "M", "Temp")
    for mux, place in ((0, 1), (1, 2)):
        frames = empty(1)
        put(frames, 0, 0, 256, bytes([mux, 1, 2, 3, 0, 0, 0, 0]))
        words = words_of(frames[0])
        changed.put(words, 77)
        expected = bytearray([mux, 1, 2, 3, 0, 0, 0, 0])
        expected[place] = 77
        assert words.tobytes()[:8] == expected
        assert changed.value(words, 8) == 77


def test_the_raw_value_selects_the_branch(tmp_path):
    """cantools 45.1 chooses by the scaled value, and decodes m11 for raw 2."""
    text = message(256, "M", "Mux M : 0|8", "A m2 : 8|8", "B m11 : 8|8").replace("0|8@1+ (1,0)", "0|8@1+ (0.5,10)")
    database = database_of(tmp_path, text)
    assert said(database, 256, bytes([2, 5])) == ("M", {"Mux": 11, "A": 5})
    assert said(database, 256, bytes([11, 5])) == ("M", {"Mux": 15.5, "B": 5})


def test_an_unknown_multiplexer_value_costs_what_it_selects(tmp_path):
    database = database_of(tmp_path, message(256, "M", "Mux M : 0|8", "Always : 8|8", "S0 m0 : 16|8", "S1 m1 : 16|8"))
    assert said(database, 256, bytes([7, 20, 1])) == ("M", {"Mux": 7, "Always": 20})


def test_a_signal_beyond_its_message_costs_itself_and_check_names_it(tmp_path, capsys):
    path = write(tmp_path, message(256, "M", "Good : 0|8", "Bad : 60|8", "Far : 600|8"), "")
    database = load_database([tmp_path / "car.dbc"])
    assert said(database, 256, bytes([5, 0, 0, 0, 0, 0, 0, 0])) == ("M", {"Good": 5})
    check(path, schema_wanted=False, json=False)
    assert "b: M has 8 bytes; beyond them: Bad, Far" in capsys.readouterr().out

"""DTCs given out automatically: unique, never one in use, and none changes when others come or go."""

import random

import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config.codes import codes_of_messages, network_codes
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.monitors.network_codes import NetworkCodes
from gateway.runtime.app import Gateway
from gateway.signals.database import load_database
from gateway_fdi.errors import InputError

MESSAGES = [f"M{k}" for k in range(700)]  # more than there are pairs


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    file = tmp_path_factory.mktemp("codes") / "many.dbc"
    rows = "".join(f'BO_ {k + 1} {name}: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" B\n' for k, name in enumerate(MESSAGES))
    file.write_text(f'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n{rows}')
    return load_database([file])


def given_out(database, checks, **more):
    """Return the codes of a bus's checks."""
    bus = {"name": "b", "uri": "virtual:x", "codes": "own", "check": checks, "health": {"watched": False}}
    config = Config.model_validate({"bus": [bus], **more})
    return codes_of_messages(config, [database], network_codes(config, ()))


def plain(names):
    return [{"message": name} for name in names]


@settings(max_examples=examples(60), deadline=None)
@given(st.randoms(use_true_random=False), st.integers(0, 300), st.integers(0, 300))
def test_checks_that_come_or_go_change_no_other_code(database, rng, few, many):
    some, others = set(rng.sample(MESSAGES, few)), set(rng.sample(MESSAGES, many))
    one, other = given_out(database, plain(sorted(some))), given_out(database, plain(sorted(others)))
    assert {f"b.{name}" for name in some} == set(one)
    for name in one.keys() & other.keys():
        assert one[name] == other[name]
    both = given_out(database, plain(sorted(some | others)))
    codes = [code for pair in both.values() for code in set(pair)]
    assert len(set(codes)) == len(codes)


def test_lost_and_invalid_go_together_and_the_rest_is_the_manufacturer_s(database):
    found = given_out(database, plain(MESSAGES))
    numbers = [(int(pair.lost[1:], 16), int(pair.invalid[1:], 16)) for pair in found.values()]
    standard = [(lost, invalid) for lost, invalid in numbers if lost < 0x1000]
    assert len(standard) == 512
    assert {lost - 0x100 for lost, _ in standard} == set(range(512))
    assert all(invalid == lost + 0x300 for lost, invalid in standard)
    rest = [pair for pair in numbers if pair not in standard]
    assert len({lost for lost, _ in rest}) == 188
    assert all(0x1000 <= lost == invalid <= 0x2FFF for lost, invalid in rest)


@settings(max_examples=examples(30), deadline=None)
@given(st.randoms(use_true_random=False))
def test_codes_in_use_are_not_given_out_and_move_only_who_had_them(database, rng):
    before = given_out(database, plain(MESSAGES))
    wanted = rng.sample(MESSAGES[:-1], 5)
    explicit = [{"message": "M699", "lost": before[f"b.{wanted[0]}"].lost, "invalid": before[f"b.{wanted[1]}"].invalid}]
    more = {
        "fault": {"b.M1.timeout": {"dtc": f"{before['b.' + wanted[2]].lost}-87"}},
        "monitor": [{"name": "s", "type": "signal", "signal": [{"code": before[f"b.{wanted[3]}"].lost}]}],
    }
    after = given_out(database, [*plain(MESSAGES[:-1]), *explicit], **more)
    taken = {explicit[0]["lost"], explicit[0]["invalid"], *(before[f"b.{wanted[k]}"].lost for k in (2, 3))}
    assert not taken & {code for pair in after.values() for code in pair}
    hit = {name for name, pair in before.items() if taken & set(pair)} | {
        name
        for name, pair in before.items()
        if any(int(code[1:], 16) - int(pair.lost[1:], 16) in (0, 0x300) for code in taken)
    }
    standard = [name for name in after if after[name].lost < "U1"]
    changed = {name for name in standard if before[name] != after[name]}
    assert changed <= hit


def test_a_bus_of_the_old_kind_keeps_its_codes_for_itself(database):
    old = {"name": "a", "uri": "virtual:y", "check": []}
    own = {"name": "b", "uri": "virtual:x", "codes": "own", "check": plain(MESSAGES)}
    config = Config.model_validate({"bus": [old, own]})
    found = codes_of_messages(config, [[], database], network_codes(config, ()))
    assert not {"U0100", "U0401", "U0001", "U0028"} & {code for pair in found.values() for code in pair}


def test_the_same_signal_has_the_same_code_and_two_monitors_share_none():
    rng = random.Random(4)
    names = [f"M{rng.randrange(200)}.S{k}" for k in range(2000)]
    codes = NetworkCodes(["U1000", "U2FFF-12", "P1234"])
    first, second = codes.give("b", names[:1200]), codes.give("b", names[1200:])
    assert len({*first.values(), *second.values()}) == 2000
    assert codes.give("b", names[5:9]) == {name: first[name] for name in names[5:9]}
    assert not {"U1000", "U2FFF"} & {*first.values(), *second.values()}
    with pytest.raises(InputError, match="all 8192 codes from U1000 to U2FFF are in use: give code"):
        codes.give("b", (f"N.{k}" for k in range(7000)))


DBC = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n'
    'BO_ 1 A: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" B\nBO_ 2 B: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" B\n'
    f'BO_ 3 {"L" * 90}: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" B\n'
)


def configuration(folder, keys):
    (folder / "c.dbc").write_text(DBC)
    path = folder / "g.toml"
    path.write_text(f'[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["c.dbc"]\n{keys}')
    return path


def test_many_messages_one_line_each_and_gateway_check_lists_their_codes(tmp_path, capsys):
    import json

    from gateway_commands.check import check

    long = "L" * 90
    path = configuration(
        tmp_path,
        'codes = "own"\ncheck = [\n  { message = "A", timeout_ms = 100 },\n  { message = "B", timeout_ms = 100 },\n'
        f'  {{ message = "{long}" }},\n]\n'
        '[[monitor]]\nname = "m"\ntype = "signal"\nsignal = [{ signal = "A.S", plausible = [0, 9] }]\n',
    )
    assert check(path, schema_wanted=False, json=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert list(told["codes"]) == ["b.A", "b.A.S", "b.B", f"b.{long}"]
    (lost, invalid), (own,) = told["codes"]["b.A"], told["codes"]["b.A.S"]
    dtcs = {fault["fault"]: fault["dtc"] for fault in told["faults"]}
    assert (dtcs["b.A.timeout"], dtcs["b.A.length"]) == (f"{lost}-87", f"{invalid}-81")
    assert dtcs["m.S.low"] == f"{own}-84"
    assert check(path, schema_wanted=False, json=False) == 0
    lines = capsys.readouterr().out.split("codes given out")[1].splitlines()[1:5]
    assert f"  {lost} {invalid}  b.A" in lines
    assert f"  {own}        b.A.S" in lines
    assert all(len(line) <= 80 for line in lines)


def test_two_checks_with_the_same_codes_are_one_line_that_says_what_to_do(tmp_path):
    path = configuration(tmp_path, 'check = [{ message = "A", timeout_ms = 9 }, { message = "B", timeout_ms = 9 }]\n')
    with pytest.raises(Exception, match=r"bus\[0\]\.check\[1\] = 'B': .*U0100 and U0401.*codes = \"own\"") as told:
        Gateway(load_config(path), file=path)
    assert len(str(told.value).splitlines()) == 1

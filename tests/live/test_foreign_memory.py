"""A daemon whose memory's place has another program's database: it starts, tells it, and keeps both."""

import sqlite3

from daemon_rig import World

from gateway.faults import service

CONFIG = """\
[[bus]]
name = "a"
uri = "virtual:a"
database = ["car.dbc"]
[[bus.check]]
message = "M"
timeout_ms = 100.0
"""
DBC = 'VERSION ""\nBU_: E\nBO_ 256 M: 8 E\n SG_ A : 0|8@1+ (1,0) [0|255] "" E\n'


def test_another_programs_database_does_not_keep_a_daemon_from_starting(tmp_path):
    (tmp_path / "car.dbc").write_text(DBC)
    (tmp_path / "g.toml").write_text(CONFIG)
    path = tmp_path / "f.sqlite"
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE song (title TEXT)")
    db.close()
    content = path.read_bytes()
    world = World()
    daemon = world.daemon(tmp_path / "g.toml", path)
    world.play(daemon, world.wait(0.5))
    daemon.close()
    (event,) = world.told("memory")
    assert (event["state"], event["reason"]) == ("foreign", "this is another program's database")
    assert (tmp_path / event["aside"]).read_bytes() == content
    assert ("U3000-42", 1) in world.dtcs()
    assert service.verify(path)["whole"]
    assert "gateway.memory_damaged" in {e["fault"] for e in service.list_entries(path)}

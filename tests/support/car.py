"""A gateway of a small configuration that is fed frames, and tells what it makes of them."""

from gateway.bus.frames import FD, empty, put
from gateway.config.load import load_config
from gateway.runtime.app import Gateway

MS = 1_000_000
HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n'


def write(folder, messages, tables, *, more="", name="car.dbc"):
    """Write a database and a configuration; returns the path of the latter.

    Args:
        folder: for both files.
        messages: of the database, as DBC text.
        tables: TOML after the bus.
        more: further keys of the bus.
        name: of the database.
    """
    (folder / name).write_text(HEAD + messages)
    path = folder / "gateway.toml"
    path.write_text(
        f'[clock]\nwatched = false\n[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["{name}"]\n{more}'
        f"health = {{ watched = false }}\n{tables}\n"
    )
    return path


class Car:
    """A gateway that is fed frames at equal distances."""

    def __init__(self, config, period_ms=10.0, memory=None):
        self.gateway = Gateway(load_config(config), memory, file=config)
        self.events, self.t_ns, self.period_ns = [], 0, round(period_ms * MS)
        self.gateway.listen(self.events.append)
        self.gateway.start(1)

    def feed(self, payloads, can_id=0x100):
        """Feed payloads of one message, one a period."""
        frames = empty(len(payloads))
        for k, data in enumerate(payloads):
            self.t_ns += self.period_ns
            put(frames, k, self.t_ns, can_id, bytes(data), flags=FD if len(data) > 8 else 0)
        self.gateway.feed(frames)
        return self

    def of(self, kind):
        """Return the events of a kind."""
        return [event for event in self.events if event["event"] == kind]

    def failed(self):
        """Return the ids of the faults that were found, without bus or monitor, in order."""
        told = [e for e in self.of("dtc") if e["status"] & 1]
        return list(dict.fromkeys(e["fault"].split(".", 1)[1] for e in told))

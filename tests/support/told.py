"""What a gateway has told, and stored, of its faults."""

from rig import Rig, write_config

from gateway.faults import service
from gateway.faults.dtc import Dtc
from gateway.servers.dtc_frame import message_of
from gateway_fdi.common.resources import shipped

FRAMES = "[output.dtc_frame]\nmin_interval_ms = 0\ncycle_ms = 60000.0\n"
MESSAGE = message_of(shipped("dbc/gateway.dbc"))


def watched_rigs(folder):
    """Yield what makes gateways with a memory on the disk and DTC frames; they are closed at the end."""
    rigs = []

    def build(messages=3, name="m.sqlite", **options):
        options.setdefault("extra", FRAMES)
        rigs.append(Rig(write_config(folder, messages, **options), folder / name, watched=True))
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.close()


def told(rig):
    """DTCs of the DTC frames sent so far, each with whether it fails."""
    return told_of(rig.sent)


def told_of(sent):
    """The same of frames."""
    found = []
    for can_id, data in sent:
        if can_id == MESSAGE.frame_id:
            values = MESSAGE.decode(bytes(data), decode_choices=False)
            found.append((str(Dtc(values["Dtc"])), bool(values["Status"] & 1)))
    return found


def of(rig, kind):
    return [e for e in rig.events if e["event"] == kind]


def stored(rig):
    return {e["fault"]: e for e in service.list_entries(rig.gateway.store.path)}

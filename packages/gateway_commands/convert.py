"""``gateway convert log``: logs of one format into those of another."""

from __future__ import annotations

from pathlib import Path

from gateway.bus.logs import LogReader, open_writer
from gateway.cli.present import print_json, say
from gateway.common.times import zone_of
from gateway_fdi.errors import InputError, InputErrors

#: Buses of a batch (``FRAME["bus"]`` is a byte).
_MOST = 256


def convert_log(source: Path, log: Path, *, zone: str | None = None, json: bool) -> int:
    """Write a log in another format; returns the exit code.

    It is read twice: formats whose channels have names get these, in the order in which they come.

    Raises:
        InputError, InputErrors: a log that is damaged, or whose frames the format cannot hold as they are; what could
            be has been written.
    """
    if log.exists() and source.exists() and log.samefile(source):
        raise InputError("a log is not converted into itself", file=log)
    wrong: list[InputError] = []
    names = channels_in(source)
    reader = LogReader(source, {name: k for k, name in enumerate(names)}, zone_of(zone or "UTC"))
    count = 0
    with open_writer(log, interfaces=dict(enumerate(names))) as writer:
        try:
            for frames in reader:
                if reader.origin_ns:
                    frames["t_ns"] += reader.origin_ns
                writer.write(frames)
                count += len(frames)
        except InputError as error:
            wrong.append(error)
    wrong += [*reader.problems, *writer.problems]
    facts = {"log": str(log), "frames": count, "channels": names, "reasons": [str(error) for error in wrong]}
    if json:
        print_json(facts)
    else:
        print(f"{source}: {count} frames of {', '.join(names) or 'no channel'} -> {log}")
        for text in reader.passed_over.notes():
            say(f"{source}: {text}")
    if wrong:
        raise InputErrors(wrong)
    return 0


def channels_in(source: Path) -> list[str]:
    """Return the names of a log's channels; numbers stay what they are, where they can."""
    reader = LogReader(source)
    try:
        for _ in reader:
            pass
    except InputError:
        pass  # told when it is read again
    seen = list(reader.seen)
    if len(seen) > _MOST:
        raise InputError(f"{len(seen)} channels; {_MOST} is the most that a log is written with", file=source)
    numbers = [int(name) for name in seen if name.isdecimal()]
    if seen and len(numbers) == len(seen) and max(numbers) < _MOST:
        return [str(number) for number in range(max(numbers) + 1)]
    return seen

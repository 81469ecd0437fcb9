"""The whole way: look at healthy logs, derive limits, replay what was held out, widen, put faults into it."""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gateway.bus.frames import ID_MASK
from gateway.config.model import BusConfig, Config
from gateway.config.resolve import answer_buses, load_databases
from gateway.engine.checks.own_health import OWNER
from gateway.signals.database import Database
from gateway_calibration.logs import read_answered
from gateway_fdi.errors import InputError
from gateway_fleet.learn.derive import derive
from gateway_fleet.learn.document import BusAsked, document
from gateway_fleet.learn.limit_relaxation import owner, widened
from gateway_fleet.learn.lines import CHECK, HEALTH, RULE, SIGNAL, Learned, inline
from gateway_fleet.learn.merge import merged
from gateway_fleet.learn.observe import Observation, Observer
from gateway_fleet.learn.proof import Replayed, replayed
from gateway_fleet.learn.state import Kept, Refused, load_state, merge, state_of
from gateway_fleet.learn.tails import FALSE_PER_HOUR
from gateway_fleet.learn.trial import Outcome, Trials, tried
from gateway_fleet.learn.unknown import database_path, database_text
from gateway_fleet.learn.update import add_before, dropped, read_file

#: How often a limit is widened before it is taken out, and how often the configuration is replayed at most.
WIDENED, ROUNDS = 3, 8

#: Alarms of one limit that are accepted, of those that all may have: what leaves its limit often comes in rows.
IN_ROWS = 6.0

#: Told: the task, log or number, how far it is (0 to 1).
Progress = Callable[[str, str, float], None]


@dataclass(frozen=True)
class Asked:
    """Request to learn.

    Attributes:
        name: of the gateway.
        buses: with their databases' paths as given.
        logs: healthy ones.
        out: file of the configuration.
        hold_out: share of each log at its end that is not learned from.
        maps: channels of the logs taken as buses, ``"channel=bus"`` each.
        seed: of the faults that are put in.
        update: the file is there, and another drive is added to it.
        per_hour: false codes of all limits of signals together that are accepted [1/h].
    """

    name: str
    buses: tuple[BusAsked, ...]
    logs: tuple[Path, ...]
    out: Path
    hold_out: float = 0.3
    maps: tuple[str, ...] = ()
    seed: int = 1
    update: bool = False
    per_hour: float = FALSE_PER_HOUR


@dataclass
class Result:
    """Result of learning.

    Attributes:
        learned: lines and notes.
        observation: their source.
        text: of the configuration.
        changes: widened limits, one line each.
        alarms: faults that healthy logs set still, none if all is well.
        conditions: faults of the logs themselves: their clock was set, the bus was off.
        held_s, held_frames: of the part held out.
        trials: results of the faults that were put into it.
        state: kept for another drive.
        databases: name of a bus -> the database of identifiers that no other has, as text.
        kept: lines that a person changed, took out or added; they stay.
        dropped: findings of earlier logs that are not there any more, one line each.
        refused: place and key of what healthy frames broke until it was taken out.
    """

    learned: Learned
    observation: Observation
    text: str
    changes: list[str] = field(default_factory=list)
    alarms: tuple[str, ...] = ()
    conditions: tuple[str, ...] = ()
    held_s: float = 0.0
    held_frames: int = 0
    trials: Trials = field(default_factory=Trials)
    state: dict[str, Any] = field(default_factory=dict)
    databases: dict[str, str] = field(default_factory=dict)
    kept: int = 0
    dropped: list[str] = field(default_factory=list)
    refused: set[Refused] = field(default_factory=set)

    @property
    def outcomes(self) -> list[Outcome]:
        """Results of one fault of each kind and place."""
        return self.trials.outcomes

    def files(self, out: Path) -> dict[Path, str]:
        """Return the texts of the configuration and of its databases, by their files."""
        return {database_path(out, bus): text for bus, text in self.databases.items()} | {out: self.text}


def write(texts: Mapping[Path, str]) -> None:
    """Write files, each whole or not at all.

    Raises:
        InputError: one is there that is no file: a device would be replaced by one.
    """
    for path in texts:
        if path.exists() and not path.is_file():
            raise InputError("is there, and no file", file=path, key="-o")
    for path, text in texts.items():
        beside = path.with_name(f".{path.name}.new")
        beside.write_text(text)
        beside.replace(path)


def observe(asked: Asked, progress: Progress) -> tuple[Observation, tuple[Database, ...]]:
    """Look at the logs; returns the databases of the buses, too.

    Raises:
        InputError, InputErrors: a database or log that is wrong; nothing in the logs that a database has.
    """
    config = Config(
        bus=tuple(
            BusConfig(
                name=bus.name,
                uri=bus.uri,
                match=bus.match,
                dm1=bool(bus.keys.get("dm1")),
                database=tuple(Path(file) for file in bus.files or bus.databases),
            )
            for bus in asked.buses
            if not bus.of_answers
        ),
        ecu=tuple(ecu.params for bus in asked.buses for ecu in bus.ecus),
    )
    answers = answer_buses(config)
    databases = (*load_databases(config), *(bus.database for bus in answers))
    own = [own_database(asked, bus) for bus in asked.buses]
    observer = Observer(config, databases, own)
    for path in asked.logs:
        log = read_answered(config, answers, observer.plan, path, asked.maps)
        observer.read(path, log, asked.hold_out, _by_log(progress, "reading"))
    observation = observer.result()
    _refuse_strangers(asked, observation, {str(path) for path in own})
    return observation, databases


def own_database(asked: Asked, bus: BusAsked) -> Path | None:
    """Return the file of identifiers that no other database has; None: the updated file names none, or answers."""
    if bus.of_answers:
        return None
    path = database_path(asked.out, bus.name)
    given = (Path(file) for file in bus.files or bus.databases)
    return next((file for file in given if file.resolve() == path.resolve()), None if asked.update else path)


def _refuse_strangers(asked: Asked, observation: Observation, own: Set[str]) -> None:
    """Refuse logs of which no database has a frame, and logs without frames."""
    files = [file for bus in asked.buses for file in bus.files or bus.databases if file not in own]
    if any(not seen.unknown for seen in observation.seen.values()) or (observation.seen and not files):
        return
    ids = sorted({can_id for _, can_id in observation.foreign})
    ids += [seen.message.frame_id for seen in observation.seen.values()]
    some = ", ".join(f"0x{can_id & ID_MASK:X}" for can_id in ids[:8]) + ", ..." * (len(ids) > 8)
    of = f"is one of {', '.join(files)}; it has" if files else "can be learned from: it has"
    raise InputError(f"no frame of this log {of} {len(ids)} identifiers: {some}", file=asked.logs[0])


def _own_texts(asked: Asked, databases: Sequence[Database], result: Result) -> dict[str, str]:
    """Return the databases of identifiers that no other has, as text, by their buses."""
    texts = {}
    for k, bus in enumerate(asked.buses):
        path = own_database(asked, bus)
        messages = {message.name: message for message in databases[k] if databases[k].file_of(message.name) == path}
        for (index, name), seen in result.observation.seen.items():
            if index == k and seen.unknown and (bus.name, CHECK, name) in result.learned.lines:
                messages[name] = seen.message
        if messages:
            texts[bus.name] = database_text(list(messages.values()))
    return texts


def _named(asked: Asked, databases: Mapping[str, str]) -> list[BusAsked]:
    """Return the buses, with the databases of identifiers that no other has among theirs."""
    return [
        replace(bus, databases=tuple(dict.fromkeys([*bus.databases, database_path(asked.out, bus.name).name])))
        if bus.name in databases
        else bus
        for bus in asked.buses
    ]


def learn(asked: Asked, progress: Progress) -> Result:
    """Learn a configuration; nothing is written.

    Raises:
        InputError, InputErrors: a database or log that is wrong; nothing in the logs that a database has; a file to be
            updated that is not there or not of gateway learn.
    """
    before = load_state(asked.out) if asked.update else Kept()
    file = read_file(asked.out) if asked.update else None
    observation, databases = observe(asked, progress)
    names = [bus.name for bus in asked.buses]
    merge(observation, before, names)
    progress("deriving", "", 0.0)
    logs = [*before.logs, *logs_text(observation)]
    learned = derive(observation, databases, asked.buses, before.seconds, asked.per_hour)
    result = Result(learned, observation, "")
    result.databases = _own_texts(asked, databases, result)
    kept: set[tuple[str, str, str]] = set()
    if file is None:
        buses = _named(asked, result.databases)
        settle(asked, result, lambda: document(asked.name, buses, learned, logs), progress)
    else:
        kept = add_before(learned, before, file, asked.buses)
        result.kept = len(kept)
        settle(asked, result, lambda: merged(file, learned, before.written, kept, asked.buses), progress)
        result.dropped = dropped(before, learned, kept, set(names))
    seconds = before.seconds + sum(log.seconds for log in observation.logs)
    result.state = state_of(observation, learned, names, seconds, logs, before, kept, result.refused)
    return result


def settle(
    asked: Asked,
    result: Result,
    compose: Callable[[], str],
    progress: Progress,
) -> None:
    """Replay the lines on the logs, widen what alarms until they are silent, and put faults in."""
    before: Counter[tuple[tuple[str, str, str], str]] = Counter()
    proof: Replayed | None = None
    for number in range(ROUNDS):
        result.text = compose()
        said = f"proof {number + 1}"
        with _beside(asked.out, result.text, result.databases) as path:
            proof = replayed(path, result.observation.logs, asked.maps, _by_log(progress, said))
        result.held_s, result.held_frames = proof.seconds, proof.frames
        own = {fault for fault in proof.alarms if of_log(fault, [bus.name for bus in asked.buses])}
        _accept(asked, result, proof)
        result.alarms = tuple(sorted(set(proof.alarms) - own))
        result.conditions = tuple(sorted(own))
        if not _widen(asked, result, proof, before):
            break
    assert proof is not None
    if not result.alarms:
        _try(asked, result, proof, progress)


def _accept(asked: Asked, result: Result, proof: Replayed) -> None:
    """Take out alarms of signals and relations that are no more than was asked for."""
    accepted = asked.per_hour * proof.hours
    for fault in list(proof.alarms) if accepted >= 1.0 else ():
        line = owner(result.learned, fault, asked.buses)
        if line is not None and line[0].table in (SIGNAL, RULE) and proof.alarms[fault].count <= IN_ROWS * accepted:
            del proof.alarms[fault]


def of_log(fault: str, buses: Sequence[str]) -> bool:
    """Return whether a fault is one of the recording (its clock was set, its bus was off), not of a limit."""
    owner_, _, rest = fault.partition(".")
    return owner_ == OWNER or (owner_ in buses and "." not in rest)


def _by_log(progress: Progress, said: str) -> Callable[[Path, int, float], None]:
    return lambda path, _frames, done: progress(said, path.name, done)


def _widen(asked: Asked, result: Result, proof: Replayed, before: Counter[tuple[tuple[str, str, str], str]]) -> bool:
    """Widen what alarmed; returns whether anything was changed."""
    changed = False
    for bus, can_id in sorted(proof.strangers):
        line = result.learned.lines.get((asked.buses[bus].name, HEALTH, HEALTH))
        said = f"{asked.buses[bus].name}: 0x{can_id & ID_MASK:X} came, "
        if line is not None:
            known = sorted({*line.keys["known"], can_id & ID_MASK})
            result.learned.lines[line.place] = replace(line, keys={**line.keys, "known": known})
            changed = True
        said += "in what was held out: known" if line is not None else "and `health`, a person's, does not know it"
        result.changes += [said] if said not in result.changes else []
    for fault, alarm in sorted(proof.alarms.items()):
        owned = owner(result.learned, fault, asked.buses)
        if owned is None:
            continue
        line, kind = owned
        new, said = widened(line, kind, alarm, before[line.place, kind] >= WIDENED)
        before[line.place, kind] += 1
        left = {} if new is None else new.keys
        result.refused |= {(line.place, key) for key in line.keys if key not in left}
        if new is None:
            del result.learned.lines[line.place]
            result.learned.notes.append(f"{line.bus}: {line.name}: {said}")
        else:
            result.learned.lines[line.place] = new
        result.changes.append(f"{fault}: {said}")
        changed = True
    return changed


def _try(asked: Asked, result: Result, proof: Replayed, progress: Progress) -> None:
    result.trials = tried(
        proof,
        result.learned,
        result.observation,
        asked.buses,
        asked.seed,
        lambda done, count: progress("faults", f"{done} of {count}", done / count),
    )


def logs_text(observation: Observation) -> list[str]:
    """Return what was read, for people."""
    said = []
    for log in observation.logs:
        part = "" if log.cut_ns is None else " (the rest was held out)"
        said.append(f"{log.path.name}, {log.seconds:.0f} s, {log.frames} frames{part}")
    return said


@contextmanager
def _beside(out: Path, text: str, databases: Mapping[str, str]) -> Iterator[Path]:
    """Write a text beside a file with its databases, for the time of the block: paths in it are relative to there."""
    out.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=out.parent, prefix=f".{out.stem}-", suffix=".toml")
    path = Path(name)
    others = {bus: database_path(path, bus) for bus in databases}
    try:
        for bus, other in others.items():
            other.write_text(databases[bus])
            text = text.replace(inline(database_path(out, bus).name), inline(other.name))
        with os.fdopen(handle, "w") as file:
            file.write(text)
        yield path
    finally:
        for each in (path, *others.values()):
            each.unlink(missing_ok=True)

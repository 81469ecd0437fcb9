"""``gateway demo`` and ``gateway simulate``: virtual ECUs, alone or with a gateway in this process."""

from __future__ import annotations

import select
import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.bus.base import Bus, send_all
from gateway.bus.frames import Frames, empty
from gateway.bus.logs import LogWriter, open_writer
from gateway.bus.uri import open_bus
from gateway.cli.events import EventPrinter
from gateway.cli.lines import wrapped
from gateway.cli.present import print_json, say
from gateway.cli.run import Ending
from gateway.common.extras import need
from gateway.host import process
from gateway.live.watchdog import steps_watched
from gateway.runtime.app import Gateway
from gateway.servers.dtc_frame import message_of, read_dtc_frame
from gateway_bench.cli.control import Control
from gateway_bench.cli.junit_scenario import of_findings, stopped
from gateway_bench.cli.report import write_scenario
from gateway_bench.cli.story import Story
from gateway_bench.drive import drive
from gateway_bench.scenario_session import opened
from gateway_bench.vecu.expectations import Finding, Judge, refuse_impossible
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import Scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import GatewayError, InputError
from gateway_replay.cli.junit import write_junit
from gateway_serve.cli.run_report import RunReport

if TYPE_CHECKING:
    from gateway_bench.cli.demo_page import DemoPage

INSIDE = "inside"
#: A step that is later than this [s] stops the scenario's clock for as long.
LATE_S = 0.02
#: Findings that are printed one by one, of those that are good and of those that are not.
MOST_FINDINGS = 10
#: Least standstill that is told [s].
TOLD_S = 0.1


def _finding_event(finding: Finding) -> dict[str, Any]:
    return {"event": "expectation", "met": finding.good, "text": finding.text}


def demo(
    scenario_name: Path,
    *,
    speed: float,
    seed: int | None,
    serve: bool = False,
    port: int = 0,
    open_page: bool = True,
    json: bool,
) -> int:
    """Show the whole chain in one process, on a page at ``port`` too (``serve``); returns the exit code."""
    if not serve:
        return _demo(scenario_name, speed=speed, seed=seed, json=json)
    from gateway_bench.cli.demo_page import DemoPage  # noqa: PLC0415 - few want it

    with DemoPage(port, Ending(), open_page=open_page) as shown:
        return _demo(scenario_name, speed=speed or 1.0, seed=seed, json=json, shown=shown)


def _demo(scenario_name: Path, *, speed: float, seed: int | None, json: bool, shown: DemoPage | None = None) -> int:
    scenario, config, player = opened(scenario_name, seed)
    gateway = Gateway(config, None if shown is None else shown.memory, file=scenario.config)
    refuse_impossible([line.dtc for line in scenario.expect], gateway.catalogue, scenario_name)
    story = None if json else Story(scenario, player, gateway)
    printer = EventPrinter(as_json=True) if story is None else story
    gateway.listen(printer)
    if shown is not None:
        shown.begin(gateway, player)
    judge = Judge(scenario)
    if story is not None:
        story.begin(speed)
    begun = time.monotonic()

    def on_frames(frames: Frames) -> None:
        if story is not None:
            story.on_frames(frames)
        if shown is not None:
            shown.on_frames(frames)

    def on_step(t_ns: int) -> None:
        if story is not None:
            story.on_time(t_ns)
        if shown is not None:
            shown.on_step(t_ns)
        if speed:
            time.sleep(max(0.0, begun + t_ns / 1e9 / speed - time.monotonic()))

    try:
        with steps_watched(gateway.engine):
            drive(
                gateway,
                player,
                judge=judge,
                on_frames=on_frames,
                on_report=None if story is None else story.on_report,
                on_step=on_step,
                stop=(lambda: False) if shown is None else shown.stop,
            )
        printer(gateway.summary(time.monotonic() - begun))
        code = _verdict(judge, json=json, check=False)
        if story is not None:
            story.end(judge.findings(), scenario_name)
        if shown is not None:
            shown.stay(f"The scenario {scenario.name} has ended after {scenario.duration_s:g} s.")
    finally:
        if shown is not None:
            shown.end()
        gateway.close()
    return code


def _verdict(judge: Judge, *, json: bool, check: bool) -> int:
    findings = judge.findings()
    told: Counter[bool] = Counter()
    for finding in findings:
        told[finding.good] += 1
        if json:
            print_json(_finding_event(finding))
        elif told[finding.good] <= MOST_FINDINGS:
            print(wrapped(("as expected: " if finding.good else "NOT as expected: ") + finding.text, hang=2))
    for good, count in told.items():
        if not json and count > MOST_FINDINGS:
            print(f"{'' if good else 'NOT '}as expected: {count - MOST_FINDINGS} more (--json has them)")
    return 1 if check and not all(finding.good for finding in findings) else 0


def simulate(
    scenario_name: Path,
    *,
    bus: str | None,
    check: bool,
    wait: float,
    record: Path | None,
    seed: int | None,
    html: Path | None = None,
    json: bool,
    junit: Path | None = None,
    control: Path | None = None,
    priority: int | None = None,
) -> int:
    """Drive a bus with a scenario's ECUs; returns the exit code."""
    if control is not None and bus == INSIDE:
        raise InputError("of a scenario in real time, on a bus", key="--control", value=str(control))
    if html is not None:
        need("serve", "reports", key="--html")
        if bus != INSIDE:
            raise InputError(f"of a gateway in this process: --bus {INSIDE}", key="--html")
    stop = Ending(starting=128 + signal.SIGTERM)
    scenario, config, player = opened(scenario_name, seed, stepwise=control is not None)
    check = check or junit is not None
    junit_file = _JunitFile(junit, scenario, player, [file for file in (record, html) if file is not None])
    say(f"{scenario.name}: {scenario.duration_s} s, seed {player.seed}")
    with ExitStack() as stack:
        writer = None if record is None else stack.enter_context(open_writer(record))
        judge = Judge(scenario)
        if bus == INSIDE:
            gateway = Gateway(config, file=scenario.config)
            stop.ready()
            stack.callback(gateway.close)
            refuse_impossible([line.dtc for line in scenario.expect], gateway.catalogue, scenario_name)
            printer = _printer(gateway, json=json)
            report = None if html is None else RunReport(html, gateway, scenario.config)
            stack.enter_context(steps_watched(gateway.engine, asked=lambda: stop.heard))
            begun = time.monotonic()
            drive(
                gateway,
                player,
                judge=judge,
                on_frames=None if writer is None else writer.write,
                stop=stop,
                fed=None if report is None else report.collector,
            )
            summary = gateway.summary(time.monotonic() - begun)
            printer(summary)
            if stop():
                return _stopped(scenario, stop, junit_file)
            if report is not None:
                write_scenario(report, scenario, player, judge, summary)
            junit_file.write(judge)
            return _verdict(judge, json=json, check=check)
        stop.ready()
        uris = [entry.uri for entry in config.bus] if bus is None else [bus]
        if len(uris) != len(config.bus):
            raise InputError("the scenario has several buses; set them in its configuration", value=bus)
        buses = [stack.enter_context(open_bus(uri, index)) for index, uri in enumerate(uris)]
        stack.callback(player.close)
        tester = _tester(stack, buses, judge, player, control)
        prefer(priority)
        if check:
            tester.wait_for_gateway(wait, stop)
        _play(player, buses, tester, writer, stop, patient=check)
    if stop():
        return _stopped(scenario, stop, junit_file) if check else 0
    junit_file.write(judge)
    return _verdict(judge, json=json, check=check) if check else 0


def _printer(gateway: Gateway, *, json: bool) -> EventPrinter:
    """Return what prints the events of a gateway in this process."""
    printer = EventPrinter(as_json=json)
    printer.definition, printer.ecus = gateway.catalogue.get, gateway.senders
    gateway.listen(printer)
    return printer


def _tester(stack: ExitStack, buses: list[Bus], judge: Judge, player: Player, control: Path | None) -> _Tester:
    """Return who listens, with the control socket if one is asked for.

    Raises:
        InputError: no such socket can be made.
    """
    # A fault that is put in later may have a condition, which wants to hear.
    tester = _Tester(buses, judge, player.hear if player.listens or control is not None else None)
    if control is not None:
        served = Control(control, player, lambda: tester.now_s)
        stack.callback(served.close)
        tester.turn = served.turn
    return tester


def prefer(priority: int | None) -> None:
    """Let the kernel prefer this process (SCHED_RR), 1 to 99; None: as any other.

    Raises:
        InputError: this user may not ask for that.
    """
    if priority is None:
        return
    try:
        process.prefer(priority)
    except OSError as error:
        text = f"{error.strerror}: it wants CAP_SYS_NICE, or a limit rtprio (limits.conf)"
        raise InputError(text, key="--priority", value=priority) from error


class _JunitFile:
    """The JUnit file of a run, if one is asked for.

    Args:
        path: of the file; None: none is.
        scenario: that is played.
        player: of the scenario.
        files: that belong to it: recording, report.
    """

    def __init__(self, path: Path | None, scenario: Scenario, player: Player, files: Sequence[Path]) -> None:
        self._path, self._scenario, self._player, self._files = path, scenario, player, files
        self._begun = time.monotonic()

    def write(self, judge: Judge | None, why: str = "") -> None:
        """Write the verdict; without a judge: why there is none."""
        if self._path is None:
            return
        scenario = self._scenario
        cases = stopped(scenario, why) if judge is None else of_findings(scenario, judge.findings())
        properties: list[tuple[str, object]] = [("seed", self._player.seed)]
        properties += [("requirement", name) for name in scenario.requirement]
        properties += [
            ("injected", f"{fact.kind.replace('_', ' ')} at {fact.t_ns / 1e9:.3f} s, {fact.count}")
            for fact in self._player.truth
        ]
        write_junit(self._path, scenario.name, cases, time.monotonic() - self._begun, properties, self._files)


def _stopped(scenario: Scenario, stop: Ending, report: _JunitFile) -> int:
    """Say that nothing is judged, since a signal came before the end; returns the exit code."""
    text = "stopped by a signal before its end: nothing is judged"
    say(f"{scenario.name}: {text}")
    report.write(None, text)
    return stop.code


class _Tester:
    """Listens to the DTC frames of a gateway elsewhere, and to all others for ECUs that hear.

    Args:
        buses: of the scenario.
        judge: takes the reports.
        hear: takes all frames, stamped by the scenario's clock; None: they are not wanted.
    """

    def __init__(self, buses: list[Bus], judge: Judge, hear: Callable[[Frames], None] | None = None) -> None:
        self._buses, self._hear = buses, hear
        self._judge = judge
        self._database = shipped("dbc/gateway.dbc")
        self._batch = empty(256)
        for bus in buses if hear is None else ():
            bus.set_filters([message_of(self._database).frame_id])
        self.begun: float | None = None
        self.turn: Callable[[], None] = lambda: None  # other work between two steps

    @property
    def now_s(self) -> float:
        """Time of the scenario [s], 0 before its begin."""
        return 0.0 if self.begun is None else time.monotonic() - self.begun

    @property
    def waits_until_s(self) -> float:
        """The last deadline of what has not come yet [s of the scenario]."""
        return self._judge.waits_until_s

    def listen(self, timeout_s: float) -> int:
        """Take frames within this time [s]; returns how many DTC frames."""
        self.turn()
        ready, _, _ = select.select([bus.fileno() for bus in self._buses], [], [], timeout_s)
        found = 0
        for bus in self._buses:
            if bus.fileno() not in ready:
                continue
            count = len(self._batch)
            while count == len(self._batch):
                count = bus.receive(self._batch)
                if self._hear is not None and self.begun is not None:
                    heard = self._batch[:count].copy()
                    heard["t_ns"] = round((time.monotonic() - self.begun) * 1e9)
                    self._hear(heard)
                for frame in self._batch[:count]:
                    found += self._take(frame)
        return found

    def _take(self, frame: Any) -> int:
        report = read_dtc_frame(frame, self._database)
        if report is None:
            return 0
        if report.dtc is not None:
            now = -1.0 if self.begun is None else time.monotonic() - self.begun
            self._judge.report(now, str(report.dtc), report.status, report.occurrence)
        return 1

    def wait_for_gateway(self, wait_s: float, stop: Ending) -> None:
        """Wait until a gateway's DTC frames are there, and take its list as the state to compare with.

        Raises:
            GatewayError: none came.
        """
        say("waiting for a gateway's DTC frame ...")
        limit = time.monotonic() + wait_s
        while not self.listen(0.1):
            if stop():
                return
            if time.monotonic() > limit:
                raise GatewayError(f"no DTC frame (GW_DTC) within {wait_s} s: is gateway run on this bus?")
        while self.listen(0.1):
            pass


def _play(
    player: Player,
    buses: list[Bus],
    tester: _Tester,
    writer: LogWriter | None,
    stop: Callable[[], bool],
    *,
    patient: bool,
) -> None:
    """Send the scenario in real time, listening meanwhile; then half a second more, or to the last deadline.

    A process that gets no turn on a busy machine does not catch up: the frames that are due would leave all at once,
    faster than any ECU sends, fill queues, and shorten faults. The scenario's clock stands still instead.
    """
    tester.begun = time.monotonic()
    stood_s = 0.0
    for until, frames in player.batches(player.step_ns):
        if stop():
            return
        late = time.monotonic() - tester.begun - until / 1e9
        if late > LATE_S:
            tester.begun += late
            stood_s += late
        # A step's frames leave at its end; within a step they follow each other at once.
        # It listens even if it is late: frames are dated when they are heard.
        tester.listen(0.0)
        while (rest := tester.begun + until / 1e9 - time.monotonic()) > 0:
            tester.listen(rest)
        _send(buses, frames)
        if writer is not None:
            writer.write(frames)
    if stood_s > TOLD_S:
        say(f"this machine was busy: the scenario stood still for {stood_s:.1f} s")
    begun, least = tester.begun, time.monotonic() + 0.5
    while not stop():
        limit = max(least, begun + tester.waits_until_s) if patient else least
        if (rest := limit - time.monotonic()) <= 0:
            return
        tester.listen(min(rest, 0.1))


def _send(buses: list[Bus], frames: Frames) -> None:
    for index, bus in enumerate(buses):
        mine = frames[frames["bus"] == index]
        if len(mine):
            send_all(bus, mine)

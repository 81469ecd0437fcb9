"""The packages and plants that each file of tests uses: the one table of the tests' own settings and of scripts.

A file whose packages or plants are not in this checkout is left out (conftest.py, scripts/without). The tests of a
package are those of which it is the highest that they use (scripts/mutate).
"""

import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"
_IMPORT = re.compile(r"^ *(?:from|import) ([\w.]+)", re.MULTILINE)
#: What is imported as the file is.
_AT_ONCE = re.compile(r"^(?:from|import) ([\w.]+)", re.MULTILINE)
PLANTS = ("crank", "pedal", "steering", "linear", "truck", "structural")
_BENCH = "gateway_bench"
#: Beside each other above the core.
_BESIDE = tuple(f"gateway_{name}" for name in ("serve", "checks", "calibration", "logs", "testers", "commands"))
_CORE = ("gateway_ask", "gateway_api", "gateway_replay", "gateway_causes", "gateway", "gateway_fdi")
#: What was one package with the core.
SPLIT = (*_BESIDE, *_CORE[:-1])

#: Package -> those below it. The door of pytest imports nothing, and opens the bench's plugin.
BELOW = {
    "gateway_fdi": (),
    "gateway": ("gateway_fdi",),
    "gateway_causes": _CORE[4:],
    "gateway_replay": _CORE[3:],
    "gateway_api": _CORE[2:],
    "gateway_ask": _CORE[1:],
    **dict.fromkeys(_BESIDE, _CORE),
    _BENCH: (*_BESIDE, *_CORE, "gateway_pytest"),
    "gateway_conformance": (*_BESIDE, *_CORE, "gateway_pytest"),
    "gateway_plants": (_BENCH, *_BESIDE, *_CORE, "gateway_pytest"),
    "gateway_fleet": (_BENCH, *_BESIDE, *_CORE, "gateway_pytest"),
    "gateway_arena": ("gateway_plants", _BENCH, *_BESIDE, *_CORE, "gateway_pytest"),
}
PACKAGES = (*BELOW, "gateway_pytest")
#: Packages that the core does without.
GUESTS = tuple(name for name in PACKAGES if name not in _CORE[4:])

#: Files of tests, helpers, and folders of them that use a plant's shipped files, or a package's commands and types, by
#: name only. What a file imports, itself or by its helpers, has no line here (tests/package/test_uses.py holds the
#: lines).
USES = {
    "fleet": ("gateway_fleet",),
    "docs/test_doc_blocks.py": (*PLANTS, "gateway_fleet", "gateway_arena", "gateway_testers"),
    "docs/test_reader.py": (*PLANTS, _BENCH),
    "docs/test_site.py": (*PLANTS, "gateway_fleet"),
    "docs/test_tutorials.py": ("structural", _BENCH, "gateway_fleet"),
    "docs/test_walks.py": ("crank", _BENCH, "gateway_fleet"),
    "package/test_windows.py": (_BENCH,),
    "pytest_plugin": (_BENCH, "gateway_pytest"),
    "api/test_arrays.py": ("structural",),
    "arena/test_arena.py": ("linear", "structural"),
    "arena/test_benchmarks.py": ("structural",),
    "arena/test_monitor.py": ("structural",),
    "arena/test_recordings.py": ("structural",),
    "api/test_docs.py": ("crank", "pedal", "linear", "structural", _BENCH, "gateway_fleet"),
    "api/test_notebooks.py": ("crank", "pedal", "linear", "structural", "gateway_fleet"),
    "api/test_sessions.py": ("crank", "structural", _BENCH, "gateway_fleet", "gateway_testers"),
    "api/test_surface.py": ("crank", "pedal", "linear"),
    "cli/test_wheel.py": ("crank", "gateway_fleet"),
    "cli/test_measure.py": ("crank", "gateway_testers"),
    "bus/test_bounds.py": ("crank", "gateway_testers"),
    "calibration/test_cusum_tests.py": ("steering", "crank", "gateway_testers", "gateway_fleet"),
    "calibration/test_of_a_fleet.py": ("steering", "gateway_fleet"),
    "calibration/test_sensors.py": ("gateway_fleet",),
    "calibration/test_stopping_rules.py": ("pedal", "steering"),
    "cli/test_bad_files.py": ("crank", "structural", _BENCH, "gateway_fleet", "gateway_arena"),
    "cli/test_check.py": ("steering", "structural"),
    "cli/test_errors.py": (*PLANTS, _BENCH),
    "cli/test_failures.py": ("crank", "structural", "gateway_testers"),
    "cli/test_present.py": ("crank", "pedal", "steering", "linear", "gateway_arena"),
    "cli/test_schema.py": (*PLANTS, _BENCH, "gateway_testers"),
    "cli/test_series.py": ("structural", _BENCH),
    "cli/test_simulate.py": ("pedal",),
    "cli/test_ways_on.py": ("crank", _BENCH),
    "engine/checks/test_communication.py": ("crank",),
    "engine/checks/test_senders.py": ("crank",),
    "engine/test_depends.py": (*PLANTS, _BENCH),
    "fdi/structure/test_c_export.py": ("truck", "structural"),
    "fdi/structure/test_conditioning.py": ("structural",),
    "fdi/structure/test_generator.py": ("truck", "structural"),
    "fdi/structure/test_model_files.py": ("truck",),
    "fdi/structure/test_simulation.py": ("structural",),
    "fdi/structure/test_sufficient.py": ("truck",),
    "fdi/structure/test_table_iv.py": ("truck",),
    "fdi/structure/test_toolbox.py": ("truck",),
    "fleet/test_digest.py": ("structural",),
    "inject/ecus.py": ("linear",),
    "jit/test_shipped.py": (*PLANTS, _BENCH, "gateway_testers"),
    "learn/test_from_answers.py": ("gateway_fleet",),
    "live/test_causes_everywhere.py": ("linear", "gateway_causes"),
    "live/test_pump.py": ("crank", "gateway_testers"),
    "live/test_several_buses.py": ("pedal",),
    "monitors/test_invalid_values.py": ("crank", "pedal", "steering", "linear", "truck", "gateway_testers"),
    "monitors/test_wrong_parameters.py": PLANTS,
    "serve/test_hostile.py": ("crank", _BENCH),
    "serve/test_metrics.py": ("crank", "gateway_testers"),
    "serve/test_processes.py": ("crank", _BENCH),
    "serve/test_prometheus.py": ("crank", _BENCH),
    "serve/test_report.py": ("crank", "gateway_testers", "gateway_causes"),
    "serve/test_watch.py": ("crank", "gateway_testers"),
    "servers/test_odx.py": ("crank",),
    "structural/monitor/test_choice.py": ("truck",),
    "structural/test_structure.py": ("truck",),
    "studies/test_cause.py": ("structural", "pedal", "truck", "linear", "steering", "gateway_causes"),
    "system/test_page.py": ("crank", _BENCH),
    "system/test_pedal.py": ("pedal",),
    "system/test_processes.py": ("crank",),
    "system/test_watchdog.py": (_BENCH,),
    "system/vcan/test_crank_scenarios.py": ("crank", "gateway_arena"),
    "system/vcan/test_linear_scenarios.py": ("linear", "gateway_arena"),
    "system/vcan/test_peers.py": ("crank",),
    "system/vcan/test_pedal_scenarios.py": ("pedal", "gateway_arena"),
    "system/vcan/test_steering_scenarios.py": ("steering", "gateway_arena"),
    "system/vcan/test_truck_scenarios.py": ("truck", "gateway_arena"),
    "system/vcan/test_guest.py": PLANTS,
    "runtime/test_causes.py": ("structural", "pedal", "crank", "truck", "gateway_testers"),
    "docs/test_docs.py": (*PLANTS, _BENCH, "gateway_fleet"),
    "runtime/test_gateway.py": (*PLANTS, "gateway_testers", "gateway_causes"),
    "jit/test_kernels_again.py": PLANTS,
    "config/test_mistakes.py": ("crank", "gateway_testers"),
    "servers/test_own_frames.py": ("crank", "gateway_testers"),
    "common/test_plugins.py": ("crank", _BENCH, "gateway_testers"),
    "runtime/test_reload.py": ("crank", "pedal", "steering", "linear", "truck", "gateway_testers"),
    "config/test_keys.py": (*PLANTS, "gateway_testers", "gateway_checks", _BENCH, "gateway_fleet", "gateway_arena"),
    "package/test_start.py": tuple(name for name in PLANTS if name != "structural"),
    "vecu/test_conditional.py": ("crank", "linear", "gateway_testers"),
    "vecu/test_encode.py": ("pedal", "steering"),
    "vecu/test_every_ecu.py": ("crank", "gateway_testers"),
    "vecu/test_keys.py": (*PLANTS, "gateway_arena"),
    "vecu/test_loop.py": ("linear",),
    "live/test_outside.py": ("gateway_serve",),
    "clients/test_asked.py": ("gateway_checks", "gateway_testers"),
    "live/test_status.py": ("gateway_checks",),
    "serve/test_causes_shown.py": ("gateway_checks", "gateway_commands", "gateway_causes"),
    "serve/test_reading.py": ("gateway_checks",),
    "answers/test_import.py": ("gateway_checks",),
    "clients/test_client.py": ("gateway_checks",),
    "clients/test_protocols.py": ("gateway_checks", "gateway_testers", "gateway_causes"),
    "clients/test_woven_commands.py": ("gateway_checks", "gateway_logs", "gateway_commands"),
    "monitors/test_network_codes.py": ("gateway_checks",),
    "monitors/test_sender_clock.py": ("gateway_checks",),
    "signals/test_identity.py": ("gateway_checks",),
    "signals/test_opendbc_car.py": ("gateway_checks",),
    "common/test_archives.py": ("gateway_testers", "gateway_replay"),
    "config/test_sections.py": ("gateway_testers",),
    "crank/monitor/test_frames.py": ("gateway_testers",),
    "system/test_captures.py": ("gateway_testers",),
    "cli/test_replay.py": ("gateway_logs",),
    "vecu/test_restbus.py": ("gateway_logs",),
    "bus/test_parquet.py": ("gateway_commands",),
    "cli/test_reporter.py": ("gateway_commands",),
    "clients/test_vehicle.py": ("gateway_commands",),
    "crank/test_crank_ecu.py": ("gateway_arena",),
    "learn/test_drives.py": ("gateway_causes",),
    "structural/monitor/test_weighing.py": ("gateway_causes",),
    "studies/test_cause_jobs.py": ("gateway_causes",),
}


@cache
def lacking(name, root=ROOT):
    """Return whether a package ("gateway_bench") or a plant ("crank") is not in a checkout, which is this one."""
    if name == "gateway":
        return not (root / "gateway" / "__init__.py").exists()
    folder = f"packages/{name}" if name.startswith("gateway_") else f"packages/gateway_plants/{name}"
    return not (root / folder).is_dir()


@cache
def helpers(file):
    """Return the files of tests that a file imports, by their names."""
    names = {name.partition(".")[0] for name in _IMPORT.findall(file.read_text())}
    near = [path for name in names for path in TESTS.glob(f"*/{name}.py")]
    return tuple(path for path in near if path != file)


@cache
def imported(file):
    """Return the packages and plants that a file of tests imports, itself or by its helpers."""
    found = set()
    for name in _IMPORT.findall(file.read_text()):
        package, _, rest = name.partition(".")
        found.add(rest.partition(".")[0] if package == "gateway_plants" and rest else package)
    found &= {*PACKAGES, *PLANTS}
    return frozenset(found.union(*map(imported, helpers(file))))


@cache
def uses(file):
    """Return the packages and plants that a file of tests uses; each file in a plant's folder uses it."""
    place = file.relative_to(TESTS)
    named = [name for path in (place, *place.parents) for name in USES.get(path.as_posix(), ())]
    own = {place.parts[0]} & {*PLANTS}
    return imported(file).union(named, own, *map(uses, helpers(file)))


@cache
def needs(name):
    """Return the packages that a package or a plant imports wherever it is imported, itself or by these."""
    folder = ROOT / "packages" / (f"gateway_plants/{name}" if name in PLANTS else name)
    files = [path for path in folder.rglob("*.py") if not path.name.startswith("test_")]
    found = {module.partition(".")[0] for path in files for module in _AT_ONCE.findall(path.read_text())}
    found = found & {*PACKAGES} - {name, "gateway_plants"}
    return frozenset(found.union(*map(needs, found)))


def missing(file):
    """Return which packages and plants that are not in this checkout a file of tests uses, or what it uses needs."""
    if file.suffix != ".py" or not any(map(lacking, (*PLANTS, *PACKAGES))):
        return ()
    return tuple(sorted(filter(lacking, uses(file).union(*map(needs, uses(file))))))


def own_tests(package, used_by=uses):
    """Return the files of a package's own tests: they use it, and use, or import (``used_by=imported``), none above."""
    found = []
    for file in sorted(TESTS.rglob("test_*.py")):
        named, used = ({"gateway_plants" if name in PLANTS else name for name in by(file)} for by in (uses, used_by))
        if package in named and used <= {package, *BELOW[package]}:
            found.append(file)
    return found

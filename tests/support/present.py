"""Which packages and plants are in this checkout: tests of others are left out (scripts/without)."""

import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_IMPORT = re.compile(r"^ *(?:from|import) ([\w.]+)", re.MULTILINE)
_PLANTS = ("crank", "pedal", "steering", "linear", "truck", "structural")
_BENCH = "gateway_bench"

#: Files of tests outside a plant's folder that use shipped files of a plant, or commands of a package, by name.
#: What they import is seen without this table.
_USES = {
    "pedal/test_pedal_ecu.py": _PLANTS,
    "learn/test_time.py": ("crank",),
    "cli/test_wheel.py": ("crank", "gateway_fleet"),
    "cli/test_measure.py": ("crank",),
    "bus/test_bounds.py": ("crank",),
    "calibration/test_cusum_tests.py": ("steering", "crank"),
    "calibration/test_of_a_fleet.py": ("steering", "linear", "gateway_fleet"),
    "calibration/test_stopping_rules.py": ("pedal", "steering"),
    "cli/test_check.py": ("steering", "structural"),
    "cli/test_errors.py": (*_PLANTS, _BENCH),
    "cli/test_failures.py": ("crank", _BENCH),
    "cli/test_present.py": ("crank", "pedal", "steering", "linear"),
    "cli/test_series.py": ("structural", _BENCH),
    "cli/test_simulate.py": ("pedal",),
    "cli/test_structure.py": ("truck",),
    "engine/checks/test_communication.py": ("crank",),
    "engine/test_depends.py": (*_PLANTS, _BENCH),
    "fdi/structure/test_c_export.py": ("truck", "structural"),
    "fdi/structure/test_conditioning.py": ("structural",),
    "fdi/structure/test_generator.py": ("truck", "structural"),
    "fdi/structure/test_model_files.py": ("truck", "structural"),
    "fdi/structure/test_simulation.py": ("structural",),
    "fdi/structure/test_sufficient.py": ("truck", "structural"),
    "fdi/structure/test_table_iv.py": ("truck",),
    "fdi/structure/test_toolbox.py": ("truck",),
    "fdi/structure/test_toolbox_models.py": ("structural",),
    "fleet/test_digest.py": ("structural",),
    "inject/test_inject.py": ("linear", _BENCH),
    "inject/test_injection.py": ("linear", _BENCH),
    "inject/test_soak.py": ("linear", _BENCH),
    "jit/test_shipped.py": (*_PLANTS, _BENCH),
    "live/test_causes_everywhere.py": ("linear",),
    "live/test_several_buses.py": ("pedal",),
    "monitors/test_invalid_values.py": ("crank", "pedal", "steering", "linear", "truck"),
    "monitors/test_wrong_parameters.py": _PLANTS,
    "serve/test_hostile.py": ("crank", _BENCH),
    "serve/test_metrics.py": ("crank",),
    "serve/test_processes.py": ("crank", _BENCH),
    "serve/test_prometheus.py": ("crank", _BENCH),
    "serve/test_report.py": ("crank", _BENCH),
    "serve/test_watch.py": ("crank",),
    "studies/test_cause.py": ("structural", "pedal", "truck"),
    "system/test_captures.py": ("crank",),
    "system/test_daemon.py": (_BENCH,),
    "system/test_page.py": ("crank", _BENCH),
    "system/test_pedal.py": ("pedal", _BENCH),
    "system/test_processes.py": ("crank", _BENCH),
    "system/test_restbus.py": (_BENCH,),
    "system/test_watchdog.py": (_BENCH,),
    "system/vcan/test_guest.py": (*_PLANTS, _BENCH),
    "test_causes.py": ("structural", "pedal", "crank", "truck"),
    "test_docs.py": (*_PLANTS, _BENCH, "gateway_fleet"),
    "test_gateway.py": _PLANTS,
    "test_kernels_again.py": _PLANTS,
    "test_mistakes.py": ("crank",),
    "test_own_frames.py": ("crank",),
    "test_plugins.py": ("crank", _BENCH),
    "test_reload.py": ("crank", "pedal", "steering", "linear", "truck"),
    "test_start.py": (*_PLANTS, _BENCH, "gateway_fleet"),
    "vecu/test_conditional.py": ("crank", "linear"),
    "vecu/test_every_ecu.py": ("crank",),
    "vecu/test_loop.py": ("linear",),
}


@cache
def _lacking(name):
    """Return whether a package ("gateway_bench") or a plant ("crank") is not in this checkout."""
    if name == "gateway":
        return not (ROOT / "gateway" / "__init__.py").exists()
    folder = f"packages/{name}" if name.startswith("gateway_") else f"packages/gateway_plants/{name}"
    return not (ROOT / folder).is_dir()


@cache
def _helper(name):
    """Return the file of a helper of the tests, by the name that a test imports; None: there is none."""
    return next((path for path in (ROOT / "tests").glob(f"*/{name}.py") if not path.name.startswith("test_")), None)


@cache
def missing(file):
    """Return which packages and plants a file of tests uses that are not in this checkout."""
    if file.suffix != ".py" or not any(map(_lacking, (*_PLANTS, *_packages()))):
        return ()
    found = [name for name in _USES.get(file.relative_to(ROOT / "tests").as_posix(), ()) if _lacking(name)]
    for name in _IMPORT.findall(file.read_text()):
        package, _, rest = name.partition(".")
        helper = None if package.startswith("gateway") else _helper(package)
        if helper is not None and helper != file:
            found += missing(helper)
        own = rest.partition(".")[0] if package == "gateway_plants" and rest else package
        if package.startswith("gateway") and _lacking(own):
            found.append(own)
    return tuple(found)


def _packages():
    return ("gateway", _BENCH, "gateway_fleet", "gateway_plants", "gateway_pytest")

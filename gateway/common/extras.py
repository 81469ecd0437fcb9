"""Optional packages: the extras of pyproject.toml install them."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from gateway_fdi.errors import InputError

#: Extra -> the package that its features import.
EXTRAS = {
    "arena": "sklearn",
    "auth": "cryptography",
    "bench": "pytest",
    "car": "fastdigest",
    "fleet": "distributed",
    "fmu": "fmpy",
    "mf4": "asammdf",
    "mqtt": "paho.mqtt",
    "notebook": "ipykernel",
    "odx": "odxtools",
    "parquet": "pyarrow",
    "serve": "bokeh",
    "structure": "sympy",
    "zst": "backports.zstd",
}
#: Extra -> what its features import besides.
_BESIDES = {
    "bench": ("udsoncan",),
    "car": ("cryptography", "paho.mqtt"),
    "fleet": ("cryptography", "duckdb", "fastdigest", "paho.mqtt", "pyarrow"),
    "notebook": ("duckdb", "matplotlib", "pandas", "pyarrow"),
}
#: Package -> what Python itself has of it, from some version on.
_BUILT_IN = {"backports.zstd": "compression.zstd"}
#: Extra -> what people get with it.
PURPOSES = {
    "arena": "methods that learn from data (gateway evaluate arena)",
    "auth": "testers' certificates (UDS 0x29)",
    "bench": "benches in pytest (pytest, udsoncan)",
    "car": "a car of a fleet (gateway fleet join)",
    "fleet": "many logs on many machines, and fleets on the road (gateway fleet)",
    "fmu": 'FMUs as plants (type = "fmu")',
    "mf4": "MF4 logs",
    "mqtt": "brokers (gateway mqtt)",
    "notebook": "the notebooks of examples/notebooks",
    "odx": "layouts of answers from ODX and PDX files (gateway import)",
    "parquet": "tables of signals (gateway decode), series as Parquet (replay --signals)",
    "serve": "the page (gateway serve), reports (--html), metrics",
    "structure": "gateway structure --residual; monitors, and plants, of your own equations",
    "zst": "logs in Zstandard",
}


def installed(extra: str) -> bool:
    """Return whether the packages of an extra are there; does not import them."""
    return not missing(extra)


def missing(extra: str) -> str:
    """Return the first package of an extra that is not there, "" if all are."""
    return next((package for package in (EXTRAS[extra], *_BESIDES.get(extra, ())) if not _there(package)), "")


def _there(package: str) -> bool:
    return _found(package) or (package in _BUILT_IN and _found(_BUILT_IN[package]))


def _found(package: str) -> bool:
    try:
        return find_spec(package) is not None
    except ModuleNotFoundError:  # nor the package that it is in
        return False


def need(extra: str, feature: str, *, file: str | Path | None = None, key: str | None = None) -> None:
    """Refuse what cannot be done without an extra.

    Args:
        extra: one of :data:`EXTRAS`.
        feature: its purpose, as people call it (plural).
        file: that asked for it.
        key: option or key that asked for it.

    Raises:
        InputError: it is not installed; says how to install it.
    """
    if package := missing(extra):
        raise InputError(_install(feature, package, extra), file=file, key=key)


def _install(feature: str, package: str, extra: str) -> str:
    return f"{feature} need {package}: pip install '.[{extra}]' in the checkout"


#: Packages that come with others of an extra.
_WITH = {"dask": "fleet", "prometheus_client": "serve", "starlette": "serve", "uvicorn": "serve"}


def extra_with(module: str) -> str:
    """Return what to do about a module that is not there: the extra that brings it; "": none does."""
    for extra, package in (*EXTRAS.items(), *((extra, each) for extra, of in _BESIDES.items() for each in of)):
        if f"{module}.".startswith(f"{package}.") or package.startswith(f"{module}."):
            return _install(PURPOSES[extra], module, extra)
    top = module.partition(".")[0]
    return _install(PURPOSES[_WITH[top]], module, _WITH[top]) if top in _WITH else ""

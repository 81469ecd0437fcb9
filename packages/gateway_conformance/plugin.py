"""Options of the suite, the fixture ``target``, and which cases are tried; ``gateway_pytest`` registers it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from gateway.bus.frames import ID_MASK
from gateway.isotp.params import IsoTpParams
from gateway.j1939.frame import NULL
from gateway_conformance.doip import DoipTarget
from gateway_conformance.target import MS, TESTER_PRESENT, CanTarget, Target
from gateway_conformance.wires import wire_of
from gateway_fdi.errors import GatewayError

#: Protocol -> the modules of its cases.
MODULES = {
    "isotp": ("test_isotp",), "uds": ("test_uds", "test_dtcs"), "obd": ("test_obd",), "j1939": ("test_j1939",),
    "doip": ("test_doip",),
}  # fmt: skip
#: One of these any server answers, be it with a refusal; one of J1939 alone need not.
PROBES = (TESTER_PRESENT, "01 00", "10 01")
#: Protocols that need a bus, or a network.
_BY_CAN, _BY_IP = ("test_isotp", "test_j1939"), ("test_doip",)


def identifier(text: str) -> int:
    """Read an identifier of up to 29 bits; -1: none."""
    number = int(text, 0)
    if not -1 <= number <= ID_MASK:
        raise ValueError
    return number


def address(text: str) -> int:
    """Read an address of J1939: 0 to 0xFD."""
    number = int(text, 0)
    if not 0 <= number < NULL:
        raise ValueError
    return number


def add_options(parser: pytest.Parser) -> None:
    """Add the suite's options."""
    group = parser.getgroup("gateway_conformance", "conformance of a diagnostic server")
    add = group.addoption
    add("--target", action="append", default=[], metavar="URI",
        help="socketcan:can0, loopback:127.0.0.1:29536, doip://HOST:PORT/ADDRESS?functional=0xE400, or "
        "inside:MODULE:FUNCTION; again: of each target")  # fmt: skip
    add("--request", type=identifier, default=0x7E0, metavar="ID", help="identifier of requests (0x7E0)")
    add("--response", type=identifier, default=0x7E8, metavar="ID", help="identifier of answers (0x7E8)")
    add("--functional", type=identifier, default=0x7DF, metavar="ID", help="of functional requests (0x7DF); -1: none")
    add("--address", type=address, metavar="SA", help="address on J1939; without it J1939 is not tried")
    add("--protocol", nargs="+", choices=sorted(MODULES), metavar="NAME", help="only these: " + ", ".join(MODULES))
    add("--demand", action="append", default=[], metavar="HEX", help="a service (19, 1942) that must be there")
    add(
        "--intervene",
        action="store_true",
        help="also cases that change the server's state: 04, 10 03, 14, 27, 28, 2E, 85",
    )
    add("--slack", type=float, default=50.0, metavar="MS", help="added to the standard's times, for the way there (50)")


def pytest_configure(config: pytest.Config) -> None:
    """Refuse to run without a target."""
    config.addinivalue_line("markers", "intervene: changes the server's state; only with --intervene")
    if not config.getoption("target"):
        raise pytest.UsageError("gateway_conformance needs --target URI, as --target socketcan:can0")


def _fitting(config: pytest.Config, module: str) -> list[str]:
    """Return the targets that the cases of a module can be tried on."""
    chosen = config.getoption("protocol") or list(MODULES)
    wanted = any(module in MODULES[protocol] for protocol in chosen)
    if not wanted or (module == "test_j1939" and config.getoption("address") is None):
        return []
    by_ip = [uri for uri in config.getoption("target") if uri.startswith("doip:")]
    if module in _BY_IP:
        return by_ip
    return [uri for uri in config.getoption("target") if module not in _BY_CAN or uri not in by_ip]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Try each case on each target that it fits."""
    if "target" in metafunc.fixturenames:
        found = _fitting(metafunc.config, metafunc.definition.path.stem)
        metafunc.parametrize("target", found, indirect=True, scope="session")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the protocols that were not asked for; skip cases that change something, unless they may."""
    names = {item.path.stem for item in items if _fitting(config, item.path.stem)}
    left = [item for item in items if item.path.stem not in names]
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item.path.stem in names]
    if not config.getoption("intervene"):
        for item in items:
            if item.get_closest_marker("intervene"):
                item.add_marker(pytest.mark.skip(reason="changes the server's state: --intervene"))


def _opened(uri: str, config: pytest.Config) -> Target:
    slack_ns = round(config.getoption("slack") * MS)
    demanded = [text.upper().removeprefix("0X") for text in config.getoption("demand")]
    if uri.startswith("doip:"):
        return DoipTarget(uri, slack_ns, demanded)
    request, response, functional = (config.getoption(name) for name in ("request", "response", "functional"))
    params = IsoTpParams(request=request, response=response, functional=None if functional < 0 else functional)
    return CanTarget(uri, wire_of(uri), params, config.getoption("address"), slack_ns, demanded)


@pytest.fixture(scope="session")
def target(request: pytest.FixtureRequest) -> Iterator[Target]:
    """Return the server that is tried."""
    try:
        made = _opened(request.param, request.config)
        answers = any(made.ask(probe).came for probe in PROBES)
    except (GatewayError, OSError) as error:
        pytest.exit(f"{request.param}: {error}", returncode=4)
    if not answers and request.config.getoption("address") is None:
        pytest.exit(
            f"{request.param}: no answer to {', '.join(PROBES)}: is there a server, at this address?", returncode=4
        )
    yield made
    made.close()

"""``gateway serve``: the page of a daemon, in a process of its own."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from gateway.cli.present import find_config, say, socket_of
from gateway.common.extras import need
from gateway.config.load import load_config
from gateway.host import process
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)


def serve(
    config_path: Path | None,
    *,
    status: Path | None,
    host: str,
    port: int,
    names: Sequence[str],
    read_token_file: Path | None,
    control_token_file: Path | None,
    certificate: Path | None,
    key: Path | None,
    open_page: bool,
    parent: int | None,
) -> int:
    """Serve until a signal comes; returns the exit code. Arguments as the command has them."""
    need("serve", "pages")
    from gateway_serve.server import ServeSettings, kept_address, open_socket, rights_of, url_of, url_with_token  # noqa: PLC0415 - of an extra
    from gateway_serve.server import serve as work  # noqa: PLC0415

    place = status or socket_of(load_config(find_config(config_path)))
    settings = ServeSettings(
        place, host, port, tuple(names), read_token_file, control_token_file, certificate, key, parent
    )
    if parent is not None:
        give_way()
    rights = rights_of(settings)
    with ExitStack() as stack:
        listener = stack.enter_context(open_socket(settings))
        url = url_of(settings, rights, listener.getsockname()[1])
        own = url_with_token(settings, rights, url)
        if own is None or sys.stderr.isatty():
            say(f"page: {own or url}")
        else:  # a journal or a log, which others may read
            say(f"page: {url} (with the control token: {stack.enter_context(kept_address(settings, own))})")
        if open_page:
            import webbrowser  # noqa: PLC0415 - few want it

            webbrowser.open(own or url)
        work(settings, rights, listener)
    return 0


def give_way() -> None:
    """Have this process give way to a gateway beside it, which has no time to lose.

    With SCHED_IDLE a gateway that something comes for takes its processor at once. With SCHED_BATCH, or by its nice
    value alone, the page would keep it until its slice is over (Linux 6.6 and later protect slices): up to 4 ms.
    """
    try:
        process.give_way()
    except OSError as error:
        log.info("the page runs without SCHED_IDLE", reason=error.strerror)

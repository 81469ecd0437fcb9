"""``gateway request``: ask a running gateway by UDS, or an ECU that it reaches."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

from gateway.cli.present import find_config, print_json, socket_of
from gateway.config.load import load_config
from gateway.servers.uds.nrc import Nrc
from gateway_ask.answers.names import forms_of, known, words_of
from gateway_fdi.errors import GatewayError, InputError

#: How long the answer of a gateway that runs is waited for [s].
PATIENCE_S = 5.0


def request(requests: Sequence[str], config_path: Path | None, *, status: Path | None, ecu: str, json: bool) -> int:
    """Ask, one after the other, in one session; returns the exit code. Arguments as the command has them."""
    place = status or socket_of(load_config(find_config(config_path)))
    for each in requests:
        if not forms_of(each):
            raise InputError(f"hexadecimal digits, as 22F190, or a name: {known()}", key="UDS", value=each)
    found = asyncio.run(_ask(place, ecu, requests))
    answers = [(asked, bytes.fromhex(answer)) for asked, each in zip(requests, found, strict=True) for answer in each]
    if json:
        print_json([{"request": asked, "answers": each} for asked, each in zip(requests, found, strict=True)])
    else:
        for asked, answer in answers:
            print(f"{asked}  {answer.hex().upper()}{_words(asked, answer)}")
    return int(any(answer[0] == 0x7F for _, answer in answers))


def _words(asked: str, answer: bytes) -> str:
    if answer[0] != 0x7F or len(answer) < 3:
        said = words_of(asked, answer)
        return f"  {said}" if said else ""
    known = {int(each): each.name.lower().replace("_", " ") for each in Nrc}
    return f"  refused: {known.get(answer[2], 'code')} (0x{answer[2]:02X})"


async def _ask(place: Path, ecu: str, requests: Sequence[str]) -> list[list[str]]:
    from gateway_serve.link import Refused, StatusLink, absence  # noqa: PLC0415 - few want it

    tried, why = asyncio.Event(), "it does not answer"

    def on_link(connected: bool, reason: str) -> None:
        nonlocal why
        why = reason
        tried.set()

    link = StatusLink(place, lambda message, block: None, on_link)
    work = asyncio.create_task(link.run())
    tester = f"request-{os.getpid()}"
    try:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(tried.wait(), PATIENCE_S)
        if why:
            raise GatewayError(absence(why))

        async def answers(asked: str) -> list[str]:
            """Ask in one form after the other, until one is not refused."""
            found: list[str] = []
            for form in forms_of(asked):
                found = (await link.ask("request", tester=tester, ecu=ecu, uds=form.hex()))["uds"]
                if not any(one[:2].upper() == "7F" for one in found):
                    break
            return found

        return [await answers(each) for each in requests]
    except Refused as error:
        raise GatewayError(str(error)) from error
    finally:
        work.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await work

"""The command line in this process, as a user meets it: exit code, standard output, standard error."""

import json
import sys
from dataclasses import dataclass

import pytest

from gateway.cli import main


@dataclass(frozen=True)
class Ended:
    code: int
    out: str
    err: str

    @property
    def events(self):
        return [json.loads(line) for line in self.out.splitlines()]

    def event(self, kind):
        (found,) = [event for event in self.events if event["event"] == kind]
        return found


def command(capsys, monkeypatch, *arguments):
    """Run ``gateway`` with arguments."""
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", ["gateway", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    code = ended.value.code
    assert "Traceback" not in said.err, said.err
    return Ended(0 if code is None else code, said.out, said.err)

"""Files that failed tests have left, in the JUnit file that pytest wrote: servers look for files in its output."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

from gateway_fdi.common.log import get_logger
from gateway_replay.attachments import attachments

_log = get_logger(__name__)

#: Properties of a test that name files.
FILES = ("recording", "report")


def attach(path: Path) -> None:
    """Put the files that properties of tests name into the tests' output, too.

    Args:
        path: of the JUnit file; one that is not there, or no XML, is left alone.
    """
    try:
        tree = Xml.parse(path)  # noqa: S314 - pytest has just written it
    except (OSError, Xml.ParseError):
        return
    changed = False
    for case in tree.iter("testcase"):
        named = [(p.get("name"), p.get("value")) for p in case.iter("property")]
        files = [Path(value) for name, value in named if name in FILES and value and Path(value).is_file()]
        if not files:
            continue
        output = case.find("system-out")
        if output is None:
            output = Xml.SubElement(case, "system-out")
        output.text = "\n".join(text for text in (output.text or "", attachments(files)) if text)
        changed = True
    if not changed:
        return
    try:
        tree.write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        _log.warning("files of failed tests could not be named", file=str(path), error=error.strerror)

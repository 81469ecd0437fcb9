"""Address of a page that was started without a terminal: what it says, and the file with the control token."""

import re
from pathlib import Path


def address_of(said, folder="."):
    """Return the whole address, with the control token after its # where it is not of a file.

    Args:
        said: the line with "page:".
        folder: in which the page was started.
    """
    found = re.search(r"page: (https?://\S+?:\d+/)(?: \(with the control token: (.+)\))?\n?$", said)
    assert found, said
    return (Path(folder) / found[2]).read_text().strip() if found[2] else found[1]

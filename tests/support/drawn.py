"""Parts of long tests that a commit draws: each commit runs a part, several commits run all of them."""

import random
import subprocess
from pathlib import Path


def drawn(among, count=1):
    """Return some parts in random order; another commit draws others."""
    asked = ["git", "rev-parse", "HEAD"]
    head = subprocess.run(asked, cwd=Path(__file__).parent, capture_output=True, text=True, check=False).stdout
    return random.Random(head).sample(list(among), count)

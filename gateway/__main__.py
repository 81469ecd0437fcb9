"""``python -m gateway``: the command line, where its script is not on the path."""

import sys
from pathlib import Path

if __name__ == "__main__":
    # Python puts the folder in which it was started first: a file there would stand for an installed module.
    if not sys.flags.safe_path and Path(sys.path[0]).resolve() != Path(__file__).resolve().parents[1]:
        del sys.path[0]
    from gateway.cli import main

    main()

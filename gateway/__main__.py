"""The script ``gateway``, and ``python -m gateway`` where it is not on the path."""

import sys


def main() -> None:
    """Run the command line; Ctrl-C while it is imported ends it in one line, as later."""
    try:
        from gateway.cli import main as work  # noqa: PLC0415 - a second's tenth in which Ctrl-C may come

        work()
    except KeyboardInterrupt:
        sys.stderr.write("stopped: nothing more is written; the same command begins again\n")
        sys.exit(130)


if __name__ == "__main__":
    from pathlib import Path

    # Python puts the folder in which it was started first: a file there would stand for an installed module.
    if not sys.flags.safe_path and Path(sys.path[0]).resolve() != Path(__file__).resolve().parents[1]:
        del sys.path[0]
    main()

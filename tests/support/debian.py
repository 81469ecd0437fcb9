"""Programs of Debian's packages that some tests need.

In CI they are installed (.ci/run), or the test fails. Elsewhere the test is skipped, and scripts/test says at its end
which tests were, and how the packages are installed.
"""

import os
import shutil

import pytest

#: File to which scripts/test has each skipped test written: its packages, a tab, its name.
SKIPPED = "GATEWAY_SKIPPED_TESTS"


def program(name, *packages):
    """Return the path of a program; a test that cannot have it is skipped, or fails in CI.

    Args:
        name: of the program; an environment variable ``GATEWAY_NAME`` may hold its path.
        packages: Debian's packages that bring it and what the test needs beside it; default: one of the same name.
    """
    variable = f"GATEWAY_{name.upper().replace('-', '_').replace('.', '_')}"
    found = os.environ.get(variable) or shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin:/sbin")
    if found is not None:
        return found
    packages = " ".join(packages or (name,))
    reason = f"{name} is not installed: apt-get install {packages}"
    if os.environ.get("CI"):
        pytest.fail(reason)
    if os.environ.get(SKIPPED):
        test = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]
        with open(os.environ[SKIPPED], "a") as file:  # noqa: PTH123 - several processes append to it
            file.write(f"{packages}\t{test}\n")
    return pytest.skip(reason)

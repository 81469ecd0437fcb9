"""pytest in a process of its own, without the plugins that are installed beside it and none of these runs uses.

To import them takes 3 s of each start: nbmake builds jsonschema's grammars, schemathesis brings its reports.
"""

import sys

NOT_USED = ("nbmake", "schemathesis", "anyio", "cacheprovider")
PYTEST = [sys.executable, "-m", "pytest", *(part for name in NOT_USED for part in ("-p", f"no:{name}"))]

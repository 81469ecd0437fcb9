"""The words of the protocol of reports (docs/report.md), for both of its sides."""

from __future__ import annotations

#: Results of a test -> whether it failed (None: it could not run), and whether that qualifies without debounce.
RESULTS: dict[str, tuple[bool | None, bool]] = {
    "passed": (False, True),
    "failed": (True, True),
    "prepassed": (False, False),
    "prefailed": (True, False),
    "not_tested": (None, True),
}
#: Why a report is refused -> in words.
REFUSALS = {
    "malformed": "this is no report",
    "unknown_fault": "no reporter of the configuration has this fault",
    "not_allowed": "this user may not report it ([report] users, groups)",
    "rate": "too many reports in a second ([report] events_per_s)",
    "data": "the fault has no such data, or it is no number",
    "internal": "an internal error of the gateway; its log has more",
    "monitoring_off": "monitoring is switched off; no test result counts",
    "not_enabled": "test results of this fault do not count now (operation cycle, enable conditions, root causes)",
}
#: Longest report and longest answer, a packet each [byte].
MOST_BYTES = 4096

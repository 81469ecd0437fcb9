"""The plants: one folder each, with its monitor, mathematics and virtual ECU; see docs/architecture.md."""

"""Virtual ECU that sends any messages of a database, their signals by tables of time and value."""

from gateway_bench.vecu.table.ecu import ECU

__all__ = ["ECU"]

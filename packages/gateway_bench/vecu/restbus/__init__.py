"""Virtual ECU that sends all messages of a database's nodes, each in its cycle: the rest of a bus."""

from gateway_bench.vecu.restbus.ecu import ECU

__all__ = ["ECU"]

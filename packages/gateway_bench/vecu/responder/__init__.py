"""Virtual ECU that answers: UDS requests over ISO-TP, and messages by messages."""

from gateway_bench.vecu.responder.ecu import ECU

__all__ = ["ECU"]

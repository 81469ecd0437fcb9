"""Virtual ECU that answers: UDS requests over ISO-TP, and messages by messages."""

from gateway.vecu.responder.ecu import ECU

__all__ = ["ECU"]

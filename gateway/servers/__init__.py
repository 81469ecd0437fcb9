"""The gateway's servers on the buses: diagnostic servers (UDS, OBD), a J1939 node, the DTC frames."""

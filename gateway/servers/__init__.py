"""What is on the buses on the gateway's behalf: diagnostic servers (UDS, OBD), a J1939 node, the DTC frames."""

"""Testers beside those of UDS on CAN: OBD, J1939 and DoIP servers, and files for testers of other makes (ODX)."""

"""Cases that any diagnostic server can be held to: ISO-TP, UDS, OBD, J1939 and DoIP, as pytest against an address.

``pytest --pyargs gateway_conformance --target URI``. ``plugin`` has the options and the fixture ``target``; ``wires``
brings frames, ``target`` asks by CAN, ``doip`` by DoIP; each ``test_*.py`` is a protocol, each case names its clause.
"""

"""J1939: diagnostic messages (J1939-73) over its transport protocol (J1939-21) and address claim (J1939-81)."""

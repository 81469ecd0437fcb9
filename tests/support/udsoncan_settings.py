"""Settings of udsoncan's client beside other tests: a second (its P2) is too short where processes wait for a turn."""

import udsoncan

#: A client with these waits a minute for an answer, whatever the server says about its times.
PATIENT = {
    **udsoncan.configs.default_client_config,
    "request_timeout": 60,
    "p2_timeout": 60,
    "p2_star_timeout": 60,
    "use_server_timing": False,
}

"""The services, one file each, named by code and name."""

from __future__ import annotations

from gateway.servers.uds.context import Service
from gateway.servers.uds.services import (
    x2e_write_data_by_identifier,
    x3e_tester_present,
    x10_diagnostic_session_control,
    x11_ecu_reset,
    x14_clear_diagnostic_information,
    x19_read_dtc_information,
    x22_read_data_by_identifier,
    x27_security_access,
    x28_communication_control,
    x29_authentication,
    x31_routine_control,
    x85_control_dtc_setting,
    x86_response_on_event,
)

SERVICES: dict[int, Service] = {
    module.SERVICE.sid: module.SERVICE
    for module in (
        x10_diagnostic_session_control,
        x11_ecu_reset,
        x14_clear_diagnostic_information,
        x19_read_dtc_information,
        x22_read_data_by_identifier,
        x27_security_access,
        x28_communication_control,
        x29_authentication,
        x2e_write_data_by_identifier,
        x31_routine_control,
        x3e_tester_present,
        x85_control_dtc_setting,
        x86_response_on_event,
    )
}

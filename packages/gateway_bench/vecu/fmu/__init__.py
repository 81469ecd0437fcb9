"""Virtual ECU whose plant or controller is an FMU: FMI 2 and 3, co-simulation."""

from gateway_bench.vecu.fmu.ecu import ECU

__all__ = ["ECU"]

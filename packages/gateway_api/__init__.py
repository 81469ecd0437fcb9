"""The gateway from Python: open a configuration, replay logs or feed frames, and get arrays back.

::

    import gateway_api as api

    run = api.open("gateway.toml").replay("drive.log", series=True)
    print(run.dtcs, run.series["crank.missed_pulse"].value)

All names in ``__all__`` are stable: from 1.0 on only the first number of the version changes them (docs/api.md). All
other modules of the package are the gateway's own. Mathematics without a bus is in :mod:`gateway_fdi`, and in the
module ``arrays`` of a plant.
"""

from gateway_api.paths import shipped
from gateway_api.run import Event, Run, Series, SeriesSet
from gateway_api.scenarios import Learned, learn, simulate
from gateway_api.session import Session
from gateway_api.setup import Config, Setup, open
from gateway_api.table import Table
from gateway_api.thresholds import Calibrated
from gateway_fdi.errors import GatewayError, InputError, InputErrors

__all__ = [
    "Calibrated",
    "Config",
    "Event",
    "GatewayError",
    "InputError",
    "InputErrors",
    "Learned",
    "Run",
    "Series",
    "SeriesSet",
    "Session",
    "Setup",
    "Table",
    "learn",
    "open",
    "shipped",
    "simulate",
]

"""Configurations with a monitor of models/motor.toml, or of another model on its messages."""

from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway.faults.status import Status
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped

#: What healthy drives give (test_calibration.py), rounded up.
NU = {"e1": 0.065, "e1_2": 0.072, "e5": 0.95, "e5_2": 0.8}
J_OF = {"e1": 50, "e1_2": 80, "e5": 60, "e5_2": 200}


def table(values):
    return "{ " + ", ".join(f"{key} = {value}" for key, value in values.items()) + " }"


def configuration(folder, more="", *, model="motor.toml", nu=NU, signals=None, name="motor"):
    signals = signals or 'u = "Drive.Voltage", i = "Sensors.Current", w = "Sensors.Speed"'
    path = folder / "gateway.toml"
    path.write_text(
        f'[clock]\nwatched = false\n[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["{shipped("dbc/motor.dbc")}"]\n'
        f'health = {{ watched = false }}\n[memory]\npath = "{folder}/faults.sqlite"\n'
        f'[[monitor]]\nname = "{name}"\ntype = "structural"\nmodel = "{model}"\nsignals = {{ {signals} }}\n'
        + (f"nu = {table(nu)}\nthresholds = {table(J_OF)}\n" if nu else "")
        + more
    )
    return path


def named(config, drive):
    """Return the faults whose DTCs a drive sets, in order."""
    gateway = Gateway(load_config(config), None, file=config)
    found = []
    gateway.listen(found.append)
    gateway.start(int(drive[0]["t_ns"]))
    gateway.feed(drive)
    gateway.close()
    return [e["fault"].split(".")[1] for e in found if e["event"] == "dtc" and e["status"] & Status.TEST_FAILED]


def notes(config):
    """What `gateway check` tells of its monitor, and warns of."""
    monitor, params = monitor_of(load_config(config).monitor[0])
    return monitor.notes(params), monitor.warnings(params)

"""What the ECUs of a steering send of a drive: messages at their times, as the shipped database has them."""

import cantools
import numpy as np

from gateway.signals.frame_encoding import frames_of, merged
from gateway_fdi.common.resources import shipped

DBC = shipped("dbc/steering.dbc")
DATABASE = cantools.database.load_file(DBC)


def frames(
    x, machine, *, wheel_delay_ms=5.0, burst_ms=None, wheel_add=None, pinion_add=None, celsius=20.0, voltage=0.0
):
    """Frames of a drive of :func:`steering.drive.drive`.

    Args:
        x: samples, each 1 ms.
        machine: that they are of.
        wheel_delay_ms: age of the steering wheel's angle.
        burst_ms: the motor's frames are held so long and come at once, all currents before all voltages.
        wheel_add: error of the steering wheel's sensor each ms [deg].
        pinion_add: likewise of the pinion's.
        celsius: what the winding's sensor says.
        voltage: offset of the voltage that is told along q [V], shape (n,) or a number.
    """
    n = len(x["sensor"])
    k = np.arange(n)
    t = (k + 1) * 1_000_000
    motor = np.degrees(x["sensor"])
    electrical = np.degrees(machine.pole_pairs * x["sensor"])
    # The pinion follows the motor, not its sensor.
    pinion = np.degrees(x["true"]) / machine.ratio + x["wheel"] + (0.0 if pinion_add is None else pinion_add)
    counter = (k + 1) % 16
    step = 360.0 / 65536
    currents = {
        "I_U": x["i_u"], "I_V": x["i_v"], "Theta_park": np.rint(electrical / step) % 65536 * step,
        "MC_cur": counter, "Valid_cur": np.ones(n),
    }  # fmt: skip
    volts = {
        "U_sd_mean": x["u_d"], "U_sq_mean": x["u_q"] + voltage, "U_dc": np.full(n, 12.0), "MC_vol": counter,
        "T_wdg": np.full(n, celsius),
    }  # fmt: skip
    t_cur, t_vol = t, t + 150_000
    if burst_ms:
        held = (np.ceil((k + 1) / burst_ms) * burst_ms * 1e6).astype(np.int64)
        t_cur, t_vol = held, held
    two, ten = k[1::2], k[9::10]
    angles = {
        "Delta_M": motor[two], "Delta_G": np.rint(pinion[two] / 0.04) * 0.04, "MC_ang": (two // 2 + 1) % 16,
        "Valid_ang": np.ones(len(two)),
    }  # fmt: skip
    old = ten - wheel_delay_ms
    told = np.interp(old, k, x["wheel"] + (0.0 if wheel_add is None else wheel_add))
    wheel = {
        "Delta_S": told, "Delta_S_dot": np.interp(old, k, x["rate"]), "MC_sas": (ten // 10 + 1) % 16,
        "Valid_sas": np.ones(len(ten)),
    }  # fmt: skip
    message = DATABASE.get_message_by_name
    return merged(
        frames_of(message("AFS_MotCur"), currents, t_cur, "CRC_cur"),
        frames_of(message("AFS_MotVol"), volts, t_vol, "CRC_vol"),
        frames_of(message("AFS_Angle"), angles, t[two] + 300_000, "CRC_ang"),
        frames_of(message("SAS_Angle"), wheel, t[ten] + 450_000, "CRC_sas"),
    )

#!/bin/bash
# First process of the test kernel: CAN modules, then the lanes beside each other, then power off.
# The host's files are this kernel's files; GUEST_* comes on the kernel's command line.
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /run
mountpoint -q /dev/shm || { mkdir -p /dev/shm && mount -t tmpfs tmpfs /dev/shm; }

cd "$GUEST_WORK" || exit 1
set -a
. ./environment
set +a

python - <<'PYTHON'
# This machine has no insmod: finit_module is system call 313 on x86-64.
import ctypes
import os
from pathlib import Path

libc = ctypes.CDLL(None, use_errno=True)
(kernel,) = Path("/usr/lib/uml/modules").glob(f"{os.uname().release}/kernel")
for name in (
    "net/can/can",
    "net/can/can-raw",
    "net/can/can-bcm",
    "net/can/can-gw",
    "drivers/net/can/dev/can-dev",
    "drivers/net/can/vcan",
    "net/can/j1939/can-j1939",
    "net/sched/sch_tbf",  # a queue that can be full
):
    with (kernel / f"{name}.ko").open("rb") as module:
        if libc.syscall(313, module.fileno(), b"", 0):
            raise SystemExit(f"{name}: {os.strerror(ctypes.get_errno())}")
PYTHON

# A lane has interfaces, and a view of them in /sys, of its own.
run_lane() {
  mount -t sysfs sysfs /sys
  ip link set lo up
  for interface in vcan0 vcan1 vcan2; do
    ip link add dev "$interface" type vcan
    ip link set "$interface" mtu 72 up
  done
  bash "$1/command" > "$1/output" 2>&1 < /dev/null
  echo $? > "$1/status"
}
export -f run_lane

for lane in lane*/; do
  unshare --net --mount bash -c 'run_lane "$0"' "$PWD/${lane%/}" &
done
wait
sync
busybox poweroff -f

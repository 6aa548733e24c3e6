"""What a tick of a servo bus takes: from bytes and baud rate, and as measured with no other work between."""

import tempfile
import time
from pathlib import Path

import numpy as np

from hapnet.errors import DeviceSilent
from hapnet.ext.robots.bus_arm import BusArm, tick_bytes
from hapnet.ext.robots.bus_emulator import BusEmulator, DynamixelEmulator, FeetechEmulator
from hapnet.ext.robots.dynamixel import Dynamixel
from hapnet.ext.robots.feetech import Feetech
from hapnet.ext.robots.servo_bus import transfer_s
from tests.support.buses import bus, urdf


def main() -> None:
    pairs: tuple[tuple[type[BusArm], type[BusEmulator], tuple[int, ...]], ...] = (
        (Dynamixel, DynamixelEmulator, (57_600, 1_000_000, 4_000_000)), (Feetech, FeetechEmulator, (1_000_000,)),
    )  # fmt: skip
    print("| bus | servos | bytes a tick | bit/s | theory [Hz] | measured [Hz] |")
    with tempfile.TemporaryDirectory() as name:
        for device, kind, bauds in pairs:
            for joints in (3, 6, 7):
                for baud in bauds:
                    arm = str(urdf(Path(name), joints))
                    more = {"torque_constant": 1.0} if device is Feetech else {}
                    model = "HLS" if device is Feetech else ""
                    with bus(kind, period=0.1, arm=arm, baud=baud, model=model, delay=0) as emulator:
                        driver = device(3, emulator.address, arm=arm, baud=baud, **more)
                        took, write_s = [], transfer_s(14 + 3 * joints, baud)
                        for _ in range(100):
                            begun = time.perf_counter()
                            try:
                                driver.read()
                            except DeviceSilent:
                                continue
                            values = dict.fromkeys(emulator.servos, b"\0\0")
                            driver.bus.sync_write(driver.control_table.goal, values)
                            time.sleep(write_s)  # until it is through
                            took.append(time.perf_counter() - begun)
                        driver.close()
                    count = tick_bytes(device.packets(), device.control_table.present[1], joints)
                    theory, found = 1.0 / transfer_s(count, baud), 1.0 / float(np.median(took))
                    print(f"| {device.__name__} | {joints} | {count} | {baud} | {theory:.0f} | {found:.0f} |")

"""Drivers of real devices, and their emulators: one file each. README.md beside this file says how to write one."""

from __future__ import annotations

from hapnet.devices.driver import Driver as Driver
from hapnet.errors import DeviceSilent as DeviceSilent

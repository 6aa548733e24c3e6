"""Drivers of real devices, and their emulators. README.md beside this file explains how to write a driver."""

from __future__ import annotations

from hapnet.devices.driver import Driver as Driver
from hapnet.errors import DeviceSilent as DeviceSilent

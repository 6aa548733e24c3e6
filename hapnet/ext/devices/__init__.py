"""Drivers of haptic devices and input devices, and their emulators."""

"""The side of a user's own device."""

from __future__ import annotations

import dataclasses

from hapnet.assembly.build import Setup, drive, held
from hapnet.assembly.leading import clutch_of, let_lead
from hapnet.assembly.own_parts import closed_if_refused, named_section
from hapnet.assembly.user_device import UserDevice
from hapnet.couplings import held_torque
from hapnet.plant.device import SimulatedDevice
from hapnet.recording.samples import Event
from hapnet.side.device import Clock, DeviceSide, Write
from hapnet.side.endpoint import DeviceControl
from hapnet.side.real_device import RealDeviceSide
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.units import within


def user_device_side(setup: Setup, endpoint: DeviceControl, clock: Clock, write: Write) -> DeviceSide:
    """Make the side of a user's own device, which only a sampled servo can drive."""
    params = setup.params
    device = UserDevice(params.hardware, setup.dof, params.device, setup.units, setup.scene.jaw)
    with closed_if_refused(device):
        declared_by = "device.stiffness_range" if getattr(device.device, "stiffness_range", None) is None else ""
        unit = within(setup.units, "N/m")
        device.declared.check_stiffness("device.stiffness", params.device.stiffness, setup.dof, unit, declared_by)
        device.check_damping("device.damping", params.device.damping)
        device.check_set(params)
        own = device.declares(params.device)
        if setup.coupling.halves and setup.harvest == "measured":
            for warning in held_torque.check(own, setup.harvest, setup.dof):
                write(Event(clock(), "warning", warning, "warning"))
        if device.lacks_torque:
            write(
                Event(clock(), "warning", f"{device.name} has no torque: the tool's force is rendered alone", "warning")
            )
        hold = held(dataclasses.replace(setup, params=dataclasses.replace(params, device=own)))
        with named_section("device"):
            hold((0.0,) * setup.dof, False)
        driven = drive(setup, clock, write)
        if isinstance(device.device, SimulatedDevice):  # the side must get the simulated device itself
            simulating = SampledDeviceSide(endpoint, device.device, hold, driven, device.declared)
            let_lead(setup.params, setup.units, simulating)
            return simulating
        check = device.check(params.device)
        side = RealDeviceSide(endpoint, device, hold, driven, device.declared, device.limiter(params.device), check)
        side.clutch = clutch_of(setup.params, setup.units, device, device.buttons)
        let_lead(setup.params, setup.units, side, has_switch=side.limiter.has_switch)
        return side

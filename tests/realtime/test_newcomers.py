"""A seat with several devices in turn: the verdict knows the accounts of all of them."""

from pathlib import Path

import numpy as np
import pytest

from hapnet.recording.mcap import read_recording
from hapnet.transport.config import free_address
from tests.support.pairs import Running, parameters, running


async def test_the_margin_of_a_seat_is_that_of_all_its_devices(tmp_path: Path) -> None:
    """Two devices with identities of their own; the bound and the work are summed here, from all recordings."""
    address, params = free_address(), parameters(operator="sine")
    world = Running("world", address, params, record=tmp_path / "world.mcap")
    devices, summaries = [], []
    async with running(world):
        for number in range(2):
            device = Running("device", address, params, record=tmp_path / f"device{number}.mcap")
            devices.append(device)
            async with running(device):
                await world.until(lambda n=number: len(world.reported("paired")) == n + 1)
                await device.until(lambda one=device: one.side.control.origin_ns is not None and one.count > 500)
                summaries.append(await device.end())
            await world.until(lambda n=number: len(world.reported("left")) == n + 1)
        summaries.append(await world.end())
    first, second, whole = summaries
    assert first["verdict"]["passive"] is True
    identities = {device.side.wire.session.identity.incarnation for device in devices}
    assert len(identities) == 2
    own = [first["device"], second["device"], whole["world"]]
    assert second["device"]["ledger"]["bound_J"] == 0.0  # it starts empty, and gets what the seat has
    assert second["device"]["credited_nJ"] > 0
    bound = first["device"]["ledger"]["bound_J"] + whole["world"]["ledger"]["bound_J"]
    work = 0.0
    for name in ("device0", "device1", "world"):
        recording = read_recording(tmp_path / f"{name}.mcap")
        samples = recording.world if name == "world" else recording.device
        assert samples is not None
        work += float(samples["work_J"][-1])
    margin = sum(part["ledger"]["margin_J"] for part in own)
    assert bound + work >= margin - 1e-9  # all that came out is within what the halves say
    for summary in (second, whole):
        assert summary["verdict"]["passive"] is True, summary["verdict"]
        assert summary["theorem"]["bound_J"] == pytest.approx(bound, abs=1e-12)
        assert summary["world"]["former"]["count"] == summary["world"]["former"]["whole"] == 1
        assert summary["theorem"]["margin_J"] <= bound + work + 1e-9
    assert whole["theorem"]["margin_J"] == pytest.approx(margin, abs=1e-12)
    up = whole["energy"]["up"]
    assert up["sent_nJ"] == first["device"]["sent_nJ"] + second["device"]["sent_nJ"] >= up["credited_nJ"]
    down = whole["energy"]["down"]
    assert down["credited_nJ"] == first["device"]["credited_nJ"] + second["device"]["credited_nJ"] <= down["sent_nJ"]
    assert np.isfinite(margin)

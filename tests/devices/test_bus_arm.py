"""Arms of servos on a bus: their emulators under the makers' SDKs, and our drivers at them."""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.robots.bus_arm import BusArm, tick_bytes
from hapnet.ext.robots.bus_emulator import BusEmulator, FeetechEmulator
from hapnet.ext.robots.bus_packets import Dynamixel2, FeetechPackets
from hapnet.ext.robots.dynamixel import Dynamixel
from hapnet.ext.robots.feetech import Feetech
from hapnet.plant.operator import Rest, Sine
from tests.conftest import mostly_slow
from tests.support.buses import HAND, bus, urdf
from tests.support.processes import until

NM_A_COUNT = 0.52 / 1.47 * 1e-3  # XL330-M288, e-manual: stall torque over stall current, 1 mA
COUNT_RAD = 2.0 * math.pi / 4096


@contextmanager
def opened(kind: type[BusArm], emulator: BusEmulator, dof: int = 3, **options: Any) -> Iterator[Any]:
    arm = kind(dof, emulator.address, **options)
    arm._budget_s, arm.rate_hz = 1.0, 1.0  # the machine may be busy: the bus watchdog is 2.5 s then
    try:
        yield arm
    finally:
        arm.close()


# The emulators, under the makers' SDKs


def test_dynamixel_under_the_makers_sdk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Addresses and errors are the e-manual's."""
    sdk = pytest.importorskip("dynamixel_sdk")
    monkeypatch.setattr(sdk.port_handler, "LATENCY_TIMER", 100)  # the machine may be busy
    handler = sdk.PacketHandler(2.0)
    with bus() as emulator:
        port = sdk.PortHandler(emulator.address)
        port.setBaudRate(1_000_000)
        assert handler.ping(port, 2)[:2] == (1200, sdk.COMM_SUCCESS)
        assert handler.ping(port, 9)[1] == sdk.COMM_RX_TIMEOUT
        assert handler.write1ByteTxRx(port, 1, 11, 0) == (0, 0)  # current control
        assert handler.write1ByteTxRx(port, 1, 64, 1) == (0, 0)
        assert handler.write1ByteTxRx(port, 1, 11, 3) == (0, 7)  # access: EEPROM while its torque is on
        assert handler.write2ByteTxRx(port, 1, 102, 1751) == (0, 6)  # beyond the current limit
        assert handler.write2ByteTxRx(port, 1, 102, 0xFFFF) == (0, 0)
        reader = sdk.GroupSyncRead(port, handler, 126, 10)
        for servo in (1, 2, 3):
            assert reader.addParam(servo)
        assert reader.txRxPacket() == sdk.COMM_SUCCESS
        assert reader.getData(1, 126, 2) == 0xFFFF  # -1 mA
        home = [0.0, 0.8, 1.5 - math.pi / 2.0]
        for servo, angle in enumerate(home, 1):
            count = reader.getData(servo, 132, 4)
            assert abs((count - 2048) * COUNT_RAD - angle) < 0.1  # its weight hangs in the hand
        writer = sdk.GroupSyncWrite(port, handler, 102, 2)
        assert writer.addParam(1, [200, 0])
        assert writer.txPacket() == sdk.COMM_SUCCESS
        assert handler.read2ByteTxRx(port, 1, 126) == (200, 0, 0)
        assert handler.write1ByteTxRx(port, 1, 98, 1) == (0, 0)
        until(lambda: emulator.handle.released == 1)  # 20 ms without a packet
        assert handler.read1ByteTxRx(port, 1, 98) == (255, 0, 0)
        assert handler.read2ByteTxRx(port, 1, 126) == (0, 0, 0)
        assert handler.write2ByteTxRx(port, 1, 102, 5) == (0, 4)  # data range
        emulator.fail(emulator.servos[1])
        assert handler.read1ByteTxRx(port, 1, 70) == (1 << 5, 0, 0x80)
        assert handler.reboot(port, 1) == (0, 0)
        assert handler.read1ByteTxRx(port, 1, 70) == (0, 0, 0)
        found, result = handler.broadcastPing(port)
        assert (found, result) == ({servo: [1200, 46] for servo in (1, 2, 3)}, sdk.COMM_SUCCESS)
        bulk = sdk.GroupBulkRead(port, handler)
        assert bulk.addParam(1, 0, 2)
        assert bulk.addParam(3, 7, 1)
        assert bulk.txRxPacket() == sdk.COMM_SUCCESS
        assert (bulk.getData(1, 0, 2), bulk.getData(3, 7, 1)) == (1200, 3)
        assert handler.write1ByteTxRx(port, 2, 68, 2) == (0, 0)
        assert handler.write1ByteTxOnly(port, 2, 68, 1) == 0  # from now on writing is not answered
        until(lambda: emulator.servos[2].table[68] == 1)
        assert handler.write1ByteTxRx(port, 2, 65, 1)[0] == sdk.COMM_RX_TIMEOUT
        assert handler.read1ByteTxRx(port, 2, 65) == (1, 0, 0)
        port.closePort()


def test_feetech_under_the_makers_sdk(monkeypatch: pytest.MonkeyPatch) -> None:
    sdk = pytest.importorskip("scservo_sdk")
    monkeypatch.setattr(sdk.port_handler, "LATENCY_TIMER", 100)
    handler = sdk.PacketHandler(0)
    with bus(FeetechEmulator) as emulator:
        port = sdk.PortHandler(emulator.address)
        port.setBaudRate(1_000_000)
        assert handler.ping(port, 1) == (777, 0, 0)  # ST3215
        assert handler.write1ByteTxRx(port, 1, 40, 1) == (0, 0)
        reader = sdk.GroupSyncRead(port, handler, 56, 2)
        for servo in (1, 2, 3):
            assert reader.addParam(servo)
        assert reader.txRxPacket() == sdk.COMM_SUCCESS
        assert abs((reader.getData(2, 56, 2) - 2048) * COUNT_RAD - 0.8) < 0.1
        emulator.fail(emulator.servos[1])
        assert handler.read1ByteTxRx(port, 1, 65) == (32, 0, 32)  # overload
        port.closePort()


# The drivers


def test_bytes_of_a_tick() -> None:
    """SyncRead 14 + n and SyncWrite 14 + 3 n, with 21 n of statuses; Feetech's packets are 6 bytes shorter."""
    for n in (3, 6, 7):
        assert tick_bytes(Dynamixel2(), 10, n) == 28 + 25 * n
        assert tick_bytes(FeetechPackets(), 15, n) == 16 + 25 * n


def test_where_the_tip_is_and_what_a_force_asks_of_the_motors() -> None:
    with bus(hand=Rest(3, HAND, (0.3, 0.0, 0.0))) as emulator, opened(Dynamixel, emulator) as arm:
        x, _ = arm.read()
        q = arm._posture.q
        assert q[0] == pytest.approx(0.3, abs=0.05)

        # the bars 0.134 and 0.1325 m in a plane that the waist turns about z
        def place(waist: float, shoulder: float, elbow: float) -> tuple[float, float, float]:
            fore = shoulder + elbow - 1.5
            out = 0.134 * math.cos(shoulder) + 0.1325 * math.cos(fore)
            return -math.sin(waist) * out, math.cos(waist) * out, 0.134 * math.sin(shoulder) + 0.1325 * math.sin(fore)

        home, here = place(0.0, 0.8, 1.5 - math.pi / 2.0), place(*q)
        assert x == pytest.approx([b - a for a, b in zip(home, here, strict=True)], abs=1e-12)
        arm.begin()
        force = (0.3, -0.2, 0.4)
        assert arm.apply(force) == force
        with_force = commanded(arm, emulator)
        arm.apply((0.0, 0.0, 0.0))
        without = commanded(arm, emulator)
        for k in range(3):  # virtual work
            turned = [angle + (1e-6 if i == k else 0.0) for i, angle in enumerate(q)]
            lever = [(b - a) / 1e-6 for a, b in zip(here, place(*turned), strict=True)]
            expected = sum(f * part for f, part in zip(force, lever, strict=True))
            assert with_force[k] - without[k] == pytest.approx(expected, abs=1.1 * NM_A_COUNT)
        # the forearm's weight: 30 g at 0.04 m
        assert without[2] == pytest.approx(0.03 * 9.81 * 0.04 * math.cos(q[1] + q[2] - 1.5), abs=NM_A_COUNT)


def commanded(arm: BusArm, emulator: Any) -> list[float]:
    """The motors' torques [Nm], after a command has come through."""
    seen = emulator.handle.commands
    until(lambda: emulator.handle.commands > seen or not arm.has_force)
    return [NM_A_COUNT * emulator.drive(servo) for servo in emulator.servos.values()]


@pytest.mark.parametrize("correction", mostly_slow([0.9, 0.05], 1))
def test_the_account_is_the_motors_own(correction: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A percent of the bytes is lost, commands with them, and the motors make half of what they are asked for: `acted`
    counts the work that they did by the emulator's account, and not that of the commands; by small corrections too."""
    monkeypatch.setattr("hapnet.ext.robots.bus_motors._CORRECTION", correction)
    with (
        bus(hand=Sine(3, HAND, 0.2, 1.0), period=2e-3, noise=0.01, seed=3) as emulator,
        opened(Dynamixel, emulator) as arm,
    ):
        arm._budget_s = 0.01
        whole = emulator.drive
        emulator.drive = lambda servo: whole(servo) // 2
        arm.begin()
        before, counted, asked, most, force = None, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)
        begun_J = emulator.handle.work_J
        for k in range(250):
            try:
                x, _ = arm.read()
            except DeviceSilent:
                continue
            if before is not None:
                moved = [b - a for a, b in zip(before, x, strict=True)]
                counted += sum(f * part for f, part in zip(arm.acted(), moved, strict=True))
                asked += sum(f * part for f, part in zip(force, moved, strict=True))
                most = max(most, abs(counted))
            before = x
            force = arm.apply((1.0 * math.sin(0.02 * k), 0.5, -0.8))
        assert arm.bus.answered < arm.bus.asked
        assert most > 0.01
        counted += arm._work.owed_J
        theirs = emulator.handle.work_J - begun_J
        assert counted == pytest.approx(theirs, abs=0.1 * most + 4e-3)


def test_a_servo_that_is_silent_and_one_that_is_overloaded() -> None:
    """The others' torque is off; when the silent one is back, so is the torque."""
    with bus() as emulator, opened(Dynamixel, emulator) as arm:
        arm.read()
        arm.begin()
        arm.apply((0.1, 0.0, 0.0))
        servos = emulator.servos
        until(lambda: servos[3].table[64] == 1)
        servos[2].broken = True
        with pytest.raises(DeviceSilent, match=r"no complete answer of servo 2 \(shoulder\)"):
            arm.read()
        work = arm._work
        work.reading = work.reading._replace(at_s=work.reading.at_s - 10.0)  # for long
        assert arm.apply((0.5, 0.0, 0.0)) == (0.0, 0.0, 0.0)
        until(lambda: servos[1].table[64] == servos[3].table[64] == 0)
        servos[2].broken = False
        arm.read()
        assert arm.apply((0.1, 0.0, 0.0)) == (0.1, 0.0, 0.0)
        until(lambda: all(servo.table[64] == 1 for servo in servos.values()))
        assert arm.braked() == ""
        emulator.fail(servos[3])
        for _ in range(100):
            arm.read()
            if "overload" in arm.braked():
                break
        assert arm.braked() == "servo 3 (elbow) reports overload: the next run restarts it"
        assert arm.apply((0.5, 0.0, 0.0)) == (0.0, 0.0, 0.0)
        until(lambda: not any(servo.table[64] for servo in servos.values()))


def test_a_servo_that_answers_reading_only_is_told_to_answer_all() -> None:
    with bus() as emulator:
        emulator.servos[2].table[68] = 1
        with opened(Dynamixel, emulator) as arm:
            assert len(arm.read()[0]) == 3
            assert emulator.servos[2].table[68] == 2


def test_a_servo_that_shut_down_is_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    with bus() as emulator:
        emulator.fail(emulator.servos[3])
        with opened(Dynamixel, emulator) as arm:
            arm.read()
            arm.begin()
            until(lambda: all(servo.table[64] for servo in emulator.servos.values()))
            assert emulator.servos[3].table[70] == 0
        monkeypatch.setattr(emulator, "make", lambda servo, delay: None)  # what shut it down is still there
        emulator.fail(emulator.servos[3])
        with pytest.raises(HapnetError, match=r"^servo 3 \(elbow\) reports overload, and restarting it does not help$"):
            Dynamixel(3, emulator.address)


def test_limits_of_joints_current_and_temperature() -> None:
    with bus() as emulator, opened(Dynamixel, emulator, current=0.2) as arm:
        arm.read()
        arm.begin()
        assert arm.apply((10.0, 0.0, 0.0))[0] == pytest.approx(0.2 * 0.52 / 1.47 / 0.1857, rel=0.5)
        commanded(arm, emulator)
        assert all(abs(emulator.drive(servo)) <= 200 for servo in emulator.servos.values())
        arm._posture.q = (0.99, *arm._posture.q[1:])
        arm.apply((-0.5, 0.0, 0.0))
        commanded(arm, emulator)
        assert emulator.drive(emulator.servos[1]) == 0
        emulator.servos[2].table[146] = 66
        for _ in range(200):
            arm.read()
            if arm.braked():
                break
        assert arm.braked() == "a servo is close to its temperature limit"


def test_a_damaged_packet_that_passes_its_checksum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 65,536 one does: a place that no servo reaches in a tick is no reading, nor is one fault a fault."""
    with bus() as emulator, opened(Dynamixel, emulator) as arm:
        for _ in range(20):
            arm.read()
        whole = arm.decoded
        with monkeypatch.context() as once:
            once.setattr(arm, "decoded", lambda reply: whole(reply)._replace(counts=whole(reply).counts + 1_000_000))
            with pytest.raises(DeviceSilent, match=r"an impossible answer of servo 1 \(waist\)"):
                arm.read()
            once.setattr(arm, "decoded", lambda reply: whole(reply)._replace(fault="overload"))
            arm.read()
        assert not arm.braked()
        arm.read()
        assert not arm.braked()


def test_slow_buses_have_slow_servos() -> None:
    with bus(baud=57_600) as emulator:
        arm = Dynamixel(3, emulator.address, baud=57_600)
        assert arm.rate_hz == pytest.approx(1.0 / (1.1 * 103 * 10 / 57_600 + 1e-3))
        assert arm.watchdog_s == 0.06  # of three periods, in steps of 20 ms
        arm.close()


def test_feetech_leads_without_force_and_hls_has_one() -> None:
    with bus(FeetechEmulator) as emulator, opened(Feetech, emulator) as arm:
        assert (arm.has_force, arm.force_limit) == (False, 1e-6)
        arm.read()
        arm.begin()
        assert arm.apply((1.0, 1.0, 1.0)) == (0.0, 0.0, 0.0)
        assert arm.acted() is None
    with bus(FeetechEmulator, model="HLS") as emulator:
        with pytest.raises(HapnetError, match="an HLS: torque_constant="):
            Feetech(3, emulator.address)
        with opened(Feetech, emulator, torque_constant=1.0) as arm:
            arm.read()
            arm.begin()
            assert arm.apply((-1.0, 0.0, 0.0)) == (-1.0, 0.0, 0.0)
            seen = emulator.handle.commands
            until(lambda: emulator.handle.commands >= seen and emulator.drive(emulator.servos[1]))
            reach = 0.134 * math.cos(0.8) + 0.1325 * math.sin(0.8)
            assert 6.5e-3 * emulator.drive(emulator.servos[1]) == pytest.approx(reach, abs=0.03)
            arm.apply((-100.0, 0.0, 0.0))
            until(lambda: emulator.drive(emulator.servos[1]) == 300)  # the current that the servo itself allows


LEROBOT = {
    name: {"id": servo, "drive_mode": 0, "homing_offset": -10 * servo, "range_min": low, "range_max": low + 2000}
    for name, servo, low in (("waist", 4, 1000), ("shoulder", 5, 1100), ("elbow", 6, 900), ("gripper", 7, 0))
}


def test_calibration_files(tmp_path: Path) -> None:
    """LeRobot's degrees are counted from the middle of the range; ours says where 0 is, and which way it turns."""
    theirs, ours = tmp_path / "leader.json", tmp_path / "ours.json"
    theirs.write_text(json.dumps(LEROBOT), "utf-8")
    ours.write_text(json.dumps({
        "waist": {"id": 4, "zero": 1900, "reversed": True}, "shoulder": {"id": 5, "zero": 2100},
        "elbow": {"id": 6, "zero": 1900},
    }), "utf-8")  # fmt: skip
    with bus(calibration=str(theirs)) as emulator:
        with opened(Dynamixel, emulator, 3, calibration=str(theirs), axes="joints") as arm:
            assert arm.units == "rad"
            arm.read()
            middles = [2000, 2100, 1900]
            counts = [servo.get(132, 4) for servo in emulator.servos.values()]
            assert arm._posture.q == pytest.approx(
                [(count - middle) * COUNT_RAD for count, middle in zip(counts, middles, strict=True)], abs=3e-3
            )
            assert arm._motors[0].joint.upper == pytest.approx(1000 * COUNT_RAD)
        with opened(Dynamixel, emulator, 3, calibration=str(ours)) as arm:
            arm.read()
            count = emulator.servos[4].get(132, 4)
            assert arm._posture.q[0] == pytest.approx(-(count - 1900) * COUNT_RAD, abs=3e-3)
        emulator.servos[5].put(20, 7, 4)
        says = r"homing offset of servo 5 \(shoulder\) is 7, and that in the calibration file -50"
        with pytest.raises(HapnetError, match=says):
            Dynamixel(3, emulator.address, calibration=str(theirs))
    ours.write_text(json.dumps({"waist": {"id": 1, "zero": 0}}), "utf-8")
    with pytest.raises(InvalidParameter, match="joints waist, shoulder, elbow"):
        Dynamixel(3, "/dev/null", calibration=str(ours))


def test_what_is_refused() -> None:
    for kind, options, says in (
        (Dynamixel, {"port": ""}, "the bus's serial port"),
        (Dynamixel, {"port": "x", "axes": "joints", "dof": 2}, "3, the joints of omni"),
        (Feetech, {"port": "x", "arm": "/none.urdf"}, "a URDF file that can be read"),
        (Dynamixel, {"port": "x", "torque_constant": -1.0}, "torque_constant"),
        (Dynamixel, {"port": "x", "current": -1.0}, "current"),
    ):
        with pytest.raises(InvalidParameter, match=says):
            kind(**{"dof": 3, **options})
    with bus(model="XL430-W250") as emulator, opened(Dynamixel, emulator) as arm:
        assert not arm.has_force  # it has no current control
        arm.close()
        emulator.servos[2].broken = True
        with pytest.raises(HapnetError, match="no answer of servo 2 at"):
            Dynamixel(3, emulator.address)


# A jaw


@pytest.mark.parametrize("lever", [0.08, -0.08])
def test_the_last_joint_is_a_jaw(lever: float, tmp_path: Path) -> None:
    """It is closed at its stop, -1 or 2 rad, and its motor gets the lever's torque and the weight's."""
    arm_file = str(urdf(tmp_path, 4))
    hand = Rest(4, HAND, (0.0, 0.2, 0.1, 0.5))
    with (
        bus(hand=hand, arm=arm_file, tip="l4") as emulator,
        opened(Dynamixel, emulator, 4, arm=arm_file, tip="l4", jaw=lever) as arm,
    ):
        assert arm.jaw
        x, _ = arm.read()
        q = arm._posture.q
        assert x[3] == pytest.approx(0.08 * (q[3] + 1.0 if lever > 0.0 else 2.0 - q[3]), abs=1e-12)
        arm.begin()
        arm.apply((0.0, 0.0, 0.0, 0.0))
        without = commanded(arm, emulator)
        assert arm.apply((0.0, 0.0, 0.0, -1.5)) == (0.0, 0.0, 0.0, -1.5)
        more = [a - b for a, b in zip(commanded(arm, emulator), without, strict=True)]
        assert more == pytest.approx([0.0, 0.0, 0.0, -1.5 * lever], abs=1.5 * NM_A_COUNT)
        # an arm beyond its motors' limits does not loosen the grip
        given = arm.apply((500.0, 500.0, 500.0, -1.5))
        assert given[3] == -1.5
        assert given[0] == given[1] == given[2] < 100.0


def test_a_jaw_joint_by_joint_is_an_angle_from_its_stop(tmp_path: Path) -> None:
    arm_file = str(urdf(tmp_path, 3))
    with (
        bus(hand=Rest(3, HAND, (0.1, 0.2, 0.5)), arm=arm_file, tip="l3") as emulator,
        opened(Dynamixel, emulator, 3, arm=arm_file, tip="l3", jaw=0.1, axes="joints") as arm,
    ):
        x, _ = arm.read()
        q = arm._posture.q
        assert (arm.units, arm.jaw) == ("rad", True)
        assert x == pytest.approx((q[0] - 0.5, q[1] - 0.5, q[2] + 1.0)), "home is the middle of the range"


def test_a_jaw_of_servos_without_current_control_leads_without_force(tmp_path: Path) -> None:
    """As that of SO-101, with its ST3215."""
    arm_file = str(urdf(tmp_path, 2))
    with (
        bus(FeetechEmulator, Rest(2, HAND, (0.1, 0.5)), arm=arm_file, tip="l2") as emulator,
        opened(Feetech, emulator, 2, arm=arm_file, tip="l2", jaw=0.1, axes="y") as arm,
    ):
        assert arm.read()[0][1] == pytest.approx(0.1 * (arm._posture.q[1] + 1.0))
        assert arm.force_limit == 1e-6
        arm.begin()
        assert arm.apply((1.0, -1.0)) == (0.0, 0.0)


def test_a_jaw_that_opens_by_metres_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidParameter, match="jaw is 80"):
        Dynamixel(4, "/dev/null", jaw=80.0)

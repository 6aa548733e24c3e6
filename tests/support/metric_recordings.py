"""Recordings made by hand, for metrics whose values are known."""

from hapnet.checks import Array
from hapnet.plant.worlds.walls import Wall
from hapnet.recording.samples import DeviceSample, MemoryRecorder, Recording, WorldSample

SECOND = 1_000_000_000


def device(time_s: float, position: tuple[float, ...], force: tuple[float, ...]) -> DeviceSample:
    return DeviceSample(int(time_s * SECOND), position, position, position, force, None, *[0.0] * 7)


def world(time_s: float, position: tuple[float, ...], penetration_m: float) -> WorldSample:
    p = position
    return WorldSample(int(time_s * SECOND), 1.0, p, p, p, p, p, p, penetration_m, *[0.0] * 6)


def recording(*samples: DeviceSample | WorldSample) -> Recording:
    recorder = MemoryRecorder({"origin_ns": 0})
    for sample in samples:
        recorder.write(sample)
    return recorder.recording()


WALL = Wall((1.0,), 0.02, 3000.0)
SURFACE = Wall((1.0,), 0.0, 3000.0)
RATE_HZ = 1000.0


def sampled(
    x: Array, force: Array, proxy: Array | None = None, inside: Array | None = None, origin_ns: int = 0
) -> Recording:
    """A run at 1 kHz; positions (N, n) [m], the force on the device (N, n) [N], a world step of 10 ms."""
    recorder = MemoryRecorder({"origin_ns": origin_ns, "device_origin_ns": origin_ns})
    for k in range(len(x)):
        at_ns = origin_ns + k * 1_000_000
        recorder.write(device(at_ns / SECOND, tuple(x[k]), tuple(force[k])))
        if k % 10 == 0:
            place = x[k] if proxy is None else proxy[k]
            depth = -1.0 if inside is None else float(inside[k])
            recorder.write(world(at_ns / SECOND, tuple(place), depth)._replace(step_s=0.01))
    return recorder.recording()


TICK_S = 2.0**-6
"""Exact in binary, so that what is just as long as a limit can be had."""


def exact(depth: Array, resistance: Array, step_s: float = 0.0) -> Recording:
    """A run sampled every `TICK_S`: depths in `SURFACE` [m], exactly, and the force outwards [N]."""
    recorder = MemoryRecorder({"origin_ns": 0, "device_origin_ns": 0})
    for k, (p, force) in enumerate(zip(depth.tolist(), resistance.tolist(), strict=True)):
        at_ns = k * 15_625_000
        recorder.write(device(0.0, (p + SURFACE.offset,), (-force,))._replace(time_ns=at_ns))
        recorder.write(world(0.0, (p,), p)._replace(time_ns=at_ns, step_s=step_s))
    return recorder.recording()

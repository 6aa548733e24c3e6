"""A side's coupling, spring, ledger and stages, to and from the kernel."""

from __future__ import annotations

from hapnet.control.pspm import SetPositionModulator
from hapnet.control.set_position_coupling import Arrived, SetPositionCoupling
from hapnet.control.smoothing import SmoothingFilter, VelocityPredictor
from hapnet.control.zoh import ZeroOrderHold
from hapnet.kernel import set_position_coupling, smoothing
from hapnet.simulation.compiled.mirror import optional, read, value, vector, write


def read_stages(record: smoothing.Stages, source: SetPositionCoupling) -> None:
    silence = source.silence
    read(record, silence, "after elapsed")
    record.releases = int(silence.policy == "release")
    for stage in source.stages.stages:
        if isinstance(stage, SmoothingFilter):
            record.smoothing_s = stage.time_constant
            optional(record, "state", "has_state", value(stage, "state"))
        elif isinstance(stage, VelocityPredictor):
            record.horizon_s, record.longest_s, record.age = stage.horizon, stage.longest, value(stage, "age")
            last = value(stage, "last")
            optional(record, "last_s", "has_last", None if last is None else last[0])
            optional(record, "last", "has_last", None if last is None else last[1])
            optional(record, "velocity", "has_velocity", value(stage, "velocity"))


def read_coupling(record: set_position_coupling.Coupling, source: SetPositionCoupling) -> None:
    modulator = source.modulator
    names = "set_position target has_sample account longest_step energy_min deficit_max discarded updates modulated"
    read(record, source, names, received="received", credit="credit")
    optional(record, "sent_s", "fresh", value(source, "sent_s"))
    read(record, modulator, "energy deficit")
    if isinstance(modulator, SetPositionModulator):
        record.passive = 1
        read(record, modulator, "ceiling reserve held_m drag_N harvested_only lends")
    record.shares = int(value(source, "shares"))
    record.level = -1.0 if source.level is None else source.level
    record.peer_level = -1.0 if source.peer_level is None else source.peer_level


def write_coupling(record: set_position_coupling.Coupling, target: SetPositionCoupling) -> None:
    n, modulator = target.spring.dof, target.modulator
    assert isinstance(modulator, SetPositionModulator | ZeroOrderHold)
    modulator.set_position = vector(record, "set_position", n)
    write(record, modulator, "energy deficit")
    write(record, target, "account energy_min deficit_max discarded updates modulated")
    target.target = vector(record, "target", n)
    target.restore(Arrived(vector(record, "received", n), float(record.credit), bool(record.has_sample)))

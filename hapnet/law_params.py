"""The parameters of the other laws, to which PSPM is compared: sections of `hapnet.params.Params`."""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.param_values import NOT_NEGATIVE as _NOT_NEGATIVE
from hapnet.param_values import POSITIVE as _POSITIVE
from hapnet.param_values import Range
from hapnet.param_values import parameter as _p

_PREDICT = "the world predicts the device where delay and lag are at most this, unless the feel is paper [s]; 0: never"


@dataclass(frozen=True)
class PopcParams:
    """Passivity observer and controller at the device's port (Hannaford, Ryu 2002)."""

    velocity_floor: float = _p(0.002, "the controller cannot damp below this speed [m/s]", Range(0.0, at_most=1.0))
    damping_cap: float = _p(0.0, "the most damping that it may inject [Ns/m]; 0: by a rule", _NOT_NEGATIVE)
    predict_s: float = _p(0.06, _PREDICT, _NOT_NEGATIVE)


@dataclass(frozen=True)
class TdpaParams:
    """Two-port time-domain passivity (Ryu, Artigas, Preusche 2010), with drift compensation."""

    stiffness: float = _p(
        0.0, "stiffness of the virtual coupling at the world [N/m]; 0: device.stiffness", _NOT_NEGATIVE
    )
    damping: float = _p(0.0, "damping of that coupling [Ns/m]; 0: by a rule", _NOT_NEGATIVE)
    velocity_floor: float = _p(
        0.002, "the device's controller cannot damp below this speed [m/s]", Range(0.0, at_most=1.0)
    )
    force_floor: float = _p(0.05, "the world's controller cannot yield below this force [N]", _POSITIVE)
    damping_cap: float = _p(0.0, "the most damping at the device [Ns/m]; 0: by a rule", _NOT_NEGATIVE)
    speed_limit: float = _p(0.25, "greatest speed of the world's set-position [m/s]", Range(0.0, at_most=100.0))
    debt_limit_J: float = _p(0.02, "a side that owes this much energy gives out no more [J]", _POSITIVE)
    predict: bool = _p(False, "the world predicts the device by the delay, unless the feel is paper")
    recovery_s: float = _p(
        0.02,
        "time constant of the drift compensation, as far as there is energy [s]; 0: none, as first published",
        _NOT_NEGATIVE,
    )


@dataclass(frozen=True)
class EbaParams:
    """Energy bounding (Kim, Ryu 2004)."""

    damping: float = _p(0.0, "lower bound of the device's own damping [Ns/m]; 0: device.own_damping", _NOT_NEGATIVE)
    predict_s: float = _p(0.06, _PREDICT, _NOT_NEGATIVE)


@dataclass(frozen=True)
class WaveParams:
    """Wave variables (Niemeyer, Slotine 2004), and digital waves (Berestesky, Chopra, Spong 2004)."""

    impedance: float = _p(0.0, "wave impedance b [Ns/m]; 0: by a rule", _NOT_NEGATIVE)
    stiffness: float = _p(0.0, "stiffness of the virtual coupling at the world [N/m]; 0: by a rule", _NOT_NEGATIVE)
    damping: float = _p(0.0, "damping of that coupling [Ns/m]; 0: by a rule", _NOT_NEGATIVE)
    smoothing_s: float = _p(0.005, "time constant of the filter of the device's incoming waves [s]; 0: none",
                            _NOT_NEGATIVE)  # fmt: skip
    recovery_s: float = _p(0.1, "time constant for making up lost displacement by wave integrals, as far as there is "
                           "energy [s]; 0: never", _NOT_NEGATIVE)  # fmt: skip
    missing: str = _p("zero", "replaces a wave that has not come; hold (the last wave) is not passive",
                      ("zero", "hold"))  # fmt: skip


@dataclass(frozen=True)
class PdParams:
    """PD over a constant delay (Lee, Spong 2006)."""

    damping: float = _p(0.0, "K_d, which dissipates what the delay generates [Ns/m]; 0: by a rule", _NOT_NEGATIVE)
    coordination: float = _p(0.0, "K_v, on the difference of the velocities [Ns/m]", _NOT_NEGATIVE)
    extra_damping: float = _p(0.0, "P_e, on each side's own velocity [Ns/m]", _NOT_NEGATIVE)

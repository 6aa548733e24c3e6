"""The sections of `hapnet.params.Params`, except the laws' own: every parameter's default, unit and meaning.

This is the only place for these defaults; other modules take them from here. They are those of the paper's Section 4;
digits that its printing lost are reconstructed (marked "rec.").
"""

from __future__ import annotations

from dataclasses import dataclass, field

from hapnet.param_values import NOT_NEGATIVE as _NOT_NEGATIVE, POSITIVE as _POSITIVE, Range, Section, parameter as _p

Matrix = float | tuple[float, ...] | tuple[tuple[float, ...], ...]
"""A scalar, one number for each axis, or the rows of a matrix."""


@dataclass(frozen=True)
class DeviceParams(Section):
    """The haptic device and its side of the coupling.

    More than twenty attributes: one for each key of `[device]`.
    """

    servo: str = _p("auto", "auto: continuous in virtual time with the paper's rendering, else sampled",
                    ("auto", "continuous", "sampled"))  # fmt: skip
    servo_hz: float = _p(1000.0, "servo rate [Hz]", Range(at_least=10.0, at_most=20_000.0))
    watchdog_s: float = _p(
        0.02, "a servo that is later than this renders no force until it is on time again [s]; 0: off", _NOT_NEGATIVE
    )
    pspm_period_s: float = _p(
        0.005,
        "positions are sent this often; with the paper's rendering PSPM runs as often, and on new data [s]",
        _POSITIVE,
    )
    stiffness: Matrix = _p(
        0.0,
        "K [N/m]: a number, one per axis, or a matrix; 0: by what the device renders (paper: 100, rec.)",
        _NOT_NEGATIVE,
    )
    damping: Matrix = _p(0.1, "B [Ns/m]: a number, or one per axis", _POSITIVE)
    ceiling_J: float = _p(0.1, "the reservoir's ceiling [J]", _NOT_NEGATIVE)
    shuffle: str = _p(
        "needed", "what is sent: harvested surplus, and what the other side needs more; harvested; all (the paper's)",
        ("needed", "harvested", "all"),
    )  # fmt: skip
    harvest: str = _p("auto", "auto: range with the continuous servo, measured with the sampled one",
                      ("auto", "range", "measured"))  # fmt: skip
    force_limit_N: float = _p(3.3, "maximum force of the actuators [N]; 0: no limit", _NOT_NEGATIVE)
    spring_share: float = _p(0.9, "share of the force limit at which the spring saturates; the rest is the damper's",
                             Range(above=0.0, at_most=1.0))  # fmt: skip
    step_limit_N: float = _p(
        0.5, "largest step of the force [N], per tick if it is held, otherwise per update; 0: no limit", _NOT_NEGATIVE
    )
    smoothing_s: float = _p(0.0, "time constant of the smoothing filter before PSPM [s]; 0: none", _NOT_NEGATIVE)
    predict_s: float = _p(0.0, "horizon of the velocity predictor before PSPM [s]; 0: none", _NOT_NEGATIVE)
    on_silence: str = _p(
        "hold", "the set-position when nothing arrives: hold it, or release the spring", ("hold", "release")
    )
    silence_after_s: float = _p(0.5, "after this time without a new message the peer is silent [s]", _POSITIVE)
    greatest_speed: float = _p(
        1.0, "maximum speed of the handle [m/s]: it bounds the energy that a held torque can give out", _POSITIVE
    )
    mass: float = _p(0.045, "apparent mass of the simulated device [kg]", _POSITIVE)
    own_damping: float = _p(0.3, "own damping of the simulated device [Ns/m]", _NOT_NEGATIVE)
    trusted_damping: float = _p(
        0.0, "lower bound of the device's own damping, for measured harvest only [Ns/m]", _NOT_NEGATIVE
    )
    resolution_m: float = _p(
        0.0, "encoder resolution, sampled servo only [m]; 0: exact", Range(at_least=0.0, at_most=0.01)
    )
    workspace_m: Matrix = _p(
        2.0,
        "reach of the device from its origin, in both directions: a number, or one per axis [m]",
        Range(0.0, 1e-3, 10.0),
    )
    stiffness_range: Matrix = _p((1.0, 1e5), "smallest and largest stiffness that the device renders [N/m]")
    substeps: int = _p(4, "integration substeps of the simulated device per tick", Range(at_least=1, at_most=1000))
    force_ramp_s: float = _p(
        1.0, "a real device's force grows over this time: at the start, after silence, after its dead-man switch [s]",
        _NOT_NEGATIVE,
    )  # fmt: skip
    self_test_N: float = _p(
        0.3, "a real device's handle is pushed to and fro by this for 0.4 s at the start: do its positions follow? [N]",
        _NOT_NEGATIVE,
    )  # fmt: skip
    known_mass_kg: Matrix = _p(
        0.0, "apparent mass of its handle as found before, or one per axis [kg]; 0: not known", _NOT_NEGATIVE
    )
    dead_man: str = _p(
        "auto", "the button that must be held: auto (the one that the device declares), none, or its number from 0"
    )
    enable: str = _p("auto", "when it leads: hold (only while its dead-man switch, else its first button, is held; or "
                     "spans of time in which it is held, as in 0-2, 3-6.5 [s]); auto: hold, if it has a dead-man "
                     "switch and leads a robot")  # fmt: skip
    clutch: str = _p("", "when the device moves alone, without force, and is coupled again from where it then is: "
                     "spans as in 2-3, 5-6.5 [s], or a button as in button 1; empty: never")  # fmt: skip


@dataclass(frozen=True)
class OperatorParams(Section):
    """The simulated hand: its impedance and its motion."""

    mass: float = _p(0.554, "mass of hand and arm [kg]", _NOT_NEGATIVE)
    damping: float = _p(6.45, "damping of hand and arm [Ns/m]", _NOT_NEGATIVE)
    stiffness: float = _p(135.0, "stiffness of hand and arm [N/m]", _NOT_NEGATIVE)
    amplitude_m: float = _p(0.03, "amplitude of the sine [m]", _NOT_NEGATIVE)
    frequency_hz: float = _p(0.5, "frequency of the sine [Hz]", _NOT_NEGATIVE)
    start_periods: float = _p(
        0.5, "the sine grows from rest over so many of its periods (minimum jerk); 0: full from the start",
        Range(at_least=0.0, at_most=100.0),
    )  # fmt: skip
    tremor_m: float = _p(0.0, "amplitude of its tremor, 8 to 12 Hz [m]", Range(at_least=0.0, at_most=0.01))
    turn_rad: float = _p(
        0.3, "of a pose: amplitude of each component of the hand's rotation [rad]", Range(at_least=0.0, at_most=3.0)
    )
    turn_hz: float = _p(0.25, "of a pose: frequency of the first of them [Hz]", Range(at_least=0.0, at_most=20.0))
    end_hold_s: float = _p(
        0.0,
        "the hand comes to rest and holds still for so long at the end of the run [s]; 0, or a short run: never",
        _NOT_NEGATIVE,
    )
    start_m: float = _p(0.0, "where the press begins, along the wall's normal [m]")
    goal_m: float = _p(0.04, "where the press aims, along the wall's normal [m]")
    reach_s: float = _p(1.0, "duration of the press's motion in, and of its motion out [s]", _POSITIVE)
    hold_s: float = _p(1.5, "how long the press is held [s]", _NOT_NEGATIVE)
    wait_s: float = _p(0.5, "pause between presses [s]", _NOT_NEGATIVE)
    press_depth_m: float = _p(0.008, "depth at which a recorded pen aims at full pressure [m]", _NOT_NEGATIVE)
    hover_m: float = _p(0.006, "height of a recorded pen when it is lifted [m]", _NOT_NEGATIVE)


@dataclass(frozen=True)
class WallParams(Section):
    """The walls of the scene."""

    stiffness: float = _p(3000.0, "K_w [N/m] (rec.)", _POSITIVE)
    damping: float = _p(10.0, "B_w [Ns/m] (rec.)", _NOT_NEGATIVE)
    position_m: float = _p(0.02, "position of the wall in scene wall, on the first axis [m]")
    half_width_m: float = _p(0.03, "half the inner width of the box in scene box [m]", _POSITIVE)
    timeline: str = _p("", "changes of the wall in scene moving, such as at 2s: shift 3mm; at 4s: gone; at 6s: back")


@dataclass(frozen=True)
class WorldParams(Section):
    """The virtual world and its side of the coupling."""

    mass: Matrix = _p(0.02, "virtual mass [kg] (rec.)", _POSITIVE)
    stiffness: Matrix = _p(500.0, "K' [N/m] (rec.); K'/K scales the force that is felt", _POSITIVE)
    damping: Matrix = _p(14.0, "B' [Ns/m]", _POSITIVE)
    ceiling_J: float = _p(0.05, "the reservoir's ceiling [J]", _NOT_NEGATIVE)
    shuffle: str = _p("needed", "what is sent, as device.shuffle", ("needed", "harvested", "all"))
    step_min_s: float = _p(0.010, "minimum integration step T_k [s] (rec.)", _POSITIVE)
    step_max_s: float = _p(
        0.050, "maximum integration step T_k [s]; steps are uniform between the two (rec.)", _POSITIVE
    )
    step_limit_N: float = _p(
        25.0, "largest step of the virtual coupling's force per update [N]; 0: no limit", _NOT_NEGATIVE
    )
    smoothing_s: float = _p(0.0, "time constant of the smoothing filter before PSPM [s]; 0: none", _NOT_NEGATIVE)
    predict_s: float = _p(0.0, "horizon of the velocity predictor before PSPM [s]; 0: none", _NOT_NEGATIVE)
    on_silence: str = _p(
        "hold", "the set-position when nothing arrives: hold it, or release the spring", ("hold", "release")
    )
    silence_after_s: float = _p(0.5, "after this time without a new message the peer is silent [s]", _POSITIVE)
    wall: WallParams = field(default_factory=WallParams)


@dataclass(frozen=True)
class FollowerParams(Section):
    """A robot in the virtual mass's place. All but the two scales is in its own units; its spring, damper and reservoir
    are those of `world`."""

    robot: str = _p(
        "none",
        "what follows the device, in place of the scene's virtual mass: simulated, or a driver (`hapnet devices`, "
        "module:Class); none: the virtual mass does",
    )
    servo: str = _p(
        "auto", "auto: sampled (a force that is held) where the coupling has set-positions, else continuous",
        ("auto", "continuous", "sampled"),
    )  # fmt: skip
    servo_hz: float = _p(1000.0, "rate of its servo [Hz]", Range(at_least=10.0, at_most=20_000.0))
    mass: float = _p(0.045, "its apparent mass, if simulated [kg]", _POSITIVE)
    own_damping: float = _p(0.3, "its own damping, if simulated [Ns/m]", _NOT_NEGATIVE)
    resolution_m: float = _p(
        0.0, "encoder resolution, sampled servo only [m]; 0: exact", Range(at_least=0.0, at_most=10.0)
    )
    force_limit_N: float = _p(10.0, "maximum force of its actuators [N]; 0: no limit", _NOT_NEGATIVE)
    step_limit_N: float = _p(0.5, "largest step of its force per tick [N]; 0: no limit", _NOT_NEGATIVE)
    greatest_speed: float = _p(
        1.0, "maximum speed: it bounds the energy that a held force can give out [m/s]", _POSITIVE
    )
    motion_scale: float = _p(
        1.0,
        "the robot moves so many times as far as the device; no angle of a tool is scaled",
        Range(at_least=1e-3, at_most=1e3),
    )
    force_scale: float = _p(
        1.0, "the device renders so many times the robot's force; the theorem then bounds the sum of the device's work "
        "and force_scale/motion_scale times the robot's", Range(at_least=1e-3, at_most=1e3)
    )  # fmt: skip
    start: str = _p(
        "here", "here: wherever both stand when they are paired is the same place; origin: both have the same origin",
        ("here", "origin"),
    )  # fmt: skip
    feedback: str = _p(
        "position", "the device's spring is tied to where the robot is (position), renders the force on the robot "
        "(force), or the planes near it, which the scene knows (planes)", ("position", "force", "planes")
    )  # fmt: skip
    on_stop: str = _p(
        "freeze", "the robot when its leader lets go, is stopped or is silent: it holds its set-position (freeze), or "
        "renders no force (release)", ("freeze", "release"),
    )  # fmt: skip
    fixtures: bool = _p(False, "a driver's motors render the scene's planes at the robot: virtual fixtures")


@dataclass(frozen=True)
class ContactModelParams(Section):
    """The local contact model at the device, and the world's prediction of the device. `hapnet tune` found the values,
    except those that do not show in its cases: `fade_s`, `shift_s`, `reach_m`.

    hapnet/couplings/rendering.py says which rule each of them enters.
    """

    damping_ratio: float = _p(0.32, "of the device's mass on K; damping is added up to it", _NOT_NEGATIVE)
    lead: float = _p(0.92, "share of all that drag that is cancelled in free motion", Range(at_least=0.0, at_most=1.0))
    lead_s: float = _p(0.012, "time constant of the velocity that cancels it [s]", _POSITIVE)
    fade_s: float = _p(0.005, "time constant with which a change of planes takes effect [s]", _POSITIVE)
    shift_s: float = _p(0.05, "time constant with which planes move to where the proxy touches them [s]", _POSITIVE)
    window_s: float = _p(0.036, "the world predicts the device from the positions of so long a time [s]", _POSITIVE)
    longest_s: float = _p(0.135, "maximum time to predict [s]", _POSITIVE)
    curve_s: float = _p(0.075, "maximum time for which an acceleration is predicted to last [s]", _NOT_NEGATIVE)
    reach_m: float = _p(
        0.05, "planes are sent within this distance plus the device's travel in a round trip [m]", _NOT_NEGATIVE
    )
    remembers: bool = _p(True, "planes that are no longer sent stay known until the world says that they are gone")
    stop_s: float = _p(
        0.015,
        "behind a plane, the predicted motion dies away with this time constant [s]; 0: it does not",
        _NOT_NEGATIVE,
    )
    yields_below: float = _p(0.8, "the lead yields below this level of the world's reservoir; 0: never",
                             Range(at_least=0.0, at_most=1.0))  # fmt: skip


@dataclass(frozen=True)
class LinkParams(Section):
    """The emulated link, in tc-netem's syntax. Each side shapes what it sends."""

    up: str = _p("delay 40ms 10ms loss 2%", "link from the device to the world")
    down: str = _p("delay 40ms 10ms loss 2%", "link from the world to the device")
    up_timeline: str = _p("", "changes of the uplink, in time from pairing, such as at 5s: down; at 9s: up")
    down_timeline: str = _p("", "changes of the downlink, likewise")
    path_s: float = _p(
        0.0, "round trip of the real network, for couplings that are tuned to a delay [s]", _NOT_NEGATIVE
    )


@dataclass(frozen=True)
class WireParams(Section):
    """The protocol's timing and admission."""

    hello_period_s: float = _p(
        0.1, "time between two hellos until the peer has answered [s]", Range(at_least=0.001, at_most=10.0)
    )
    energy_spacing_s: float = _p(
        0.010, "minimum time between two messages with new energy [s]", Range(at_least=0.001, at_most=10.0)
    )
    admission_W: float = _p(
        5.0, "the most shuffled power that is credited in the long run [W]", Range(at_least=1e-9, at_most=1e9)
    )
    admission_burst_J: float = _p(
        0.5, "the most shuffled energy that is credited at once [J]", Range(at_least=1e-9, at_most=1e9)
    )
    accept_stale: bool = _p(False, "also use set-positions that arrive after newer ones")
    deadband: float = _p(
        0.0,
        "perceptual deadband (Weber): a change of the force below this fraction is not sent; 0: all is sent",
        Range(at_least=0.0, at_most=1.0),
    )

"""The sections of `hapnet.params.Params`, except the laws' own: every parameter's default, unit and meaning.

These defaults are defined only here. They are the values of the paper's Section 4; digits that were lost in print are
reconstructed (marked "rec.").
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
        "period of sent positions [s]; with the paper's rendering PSPM runs with this period too, and on new data",
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
        "needed", "energy to send: harvested surplus, and any that the other side needs more; harvested; all (paper)",
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
        1.0, "maximum speed of the handle [m/s]: it bounds the energy that a held torque can output", _POSITIVE
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
        1.0, "a real device's force grows over this time [s]: at the start, after silence, after its dead-man switch",
        _NOT_NEGATIVE,
    )  # fmt: skip
    self_test_N: float = _p(
        0.3, "a real device's handle is pushed to and fro with this force for 0.4 s at the start, to test it [N]",
        _NOT_NEGATIVE,
    )  # fmt: skip
    known_mass_kg: Matrix = _p(
        0.0, "apparent mass of the handle from an earlier measurement, or one per axis [kg]; 0: unknown", _NOT_NEGATIVE
    )
    dead_man: str = _p(
        "auto", "the button that must be held: auto (as the device declares), none, or its number from 0"
    )
    enable: str = _p("auto", "when the device leads: hold (only while its dead-man switch, else its first button, is "
                     "held; or spans in which it is held, as in 0-2, 3-6.5 [s]); auto: hold, if it has a dead-man "
                     "switch and leads a robot")  # fmt: skip
    clutch: str = _p("", "when the device moves freely, without force, to be coupled again at its new position: "
                     "spans as in 2-3, 5-6.5 [s], or a button as in button 1; empty: never")  # fmt: skip

    @property
    def spring_limit_N(self) -> float:
        """The force at which the spring saturates [N]; 0: it does not."""
        return self.force_limit_N * self.spring_share


@dataclass(frozen=True)
class OperatorParams(Section):
    """The simulated hand: its impedance and its motion."""

    mass: float = _p(0.554, "mass of hand and arm [kg]", _NOT_NEGATIVE)
    damping: float = _p(6.45, "damping of hand and arm [Ns/m]", _NOT_NEGATIVE)
    stiffness: float = _p(135.0, "stiffness of hand and arm [N/m]", _NOT_NEGATIVE)
    amplitude_m: float = _p(0.03, "amplitude of the sine [m]", _NOT_NEGATIVE)
    frequency_hz: float = _p(0.5, "frequency of the sine [Hz]", _NOT_NEGATIVE)
    start_periods: float = _p(
        0.5, "number of periods in which the sine grows from rest (minimum jerk); 0: full from the start",
        Range(at_least=0.0, at_most=100.0),
    )  # fmt: skip
    tremor_m: float = _p(0.0, "amplitude of its tremor, 8 to 12 Hz [m]", Range(at_least=0.0, at_most=0.01))
    turn_rad: float = _p(
        0.3, "for a pose: amplitude of each component of the hand's rotation [rad]", Range(at_least=0.0, at_most=3.0)
    )
    turn_hz: float = _p(0.25, "for a pose: frequency of the first component [Hz]", Range(at_least=0.0, at_most=20.0))
    end_hold_s: float = _p(
        0.0,
        "at the end of the run the hand rests for this time [s]; 0, or in a short run: never",
        _NOT_NEGATIVE,
    )
    start_m: float = _p(0.0, "start of the press, along the wall's normal [m]")
    goal_m: float = _p(0.04, "target of the press, along the wall's normal [m]")
    reach_s: float = _p(1.0, "duration of the press's motion in, and of its motion out [s]", _POSITIVE)
    hold_s: float = _p(1.5, "duration for which the press is held [s]", _NOT_NEGATIVE)
    wait_s: float = _p(0.5, "pause between presses [s]", _NOT_NEGATIVE)
    press_depth_m: float = _p(0.008, "target depth of a recorded pen at full pressure [m]", _NOT_NEGATIVE)
    hover_m: float = _p(0.006, "height of a recorded pen when it is lifted [m]", _NOT_NEGATIVE)
    columns: str = _p("", "columns of a CSV file, if they have other names, such as time_ms=stamp x_mm=px")


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
    shuffle: str = _p("needed", "energy to send, as device.shuffle", ("needed", "harvested", "all"))
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
    reservoir: str = _p(
        "separate", "of several hands: a reservoir for each (separate), or one for a trusted group (pooled)",
        ("separate", "pooled"),
    )  # fmt: skip
    seat_refill_s: float = _p(
        5.0, "of several hands: a seat without a device for so long is filled again, out of what the world has "
        "dissipated [s]; 0: never", _NOT_NEGATIVE,
    )  # fmt: skip
    wall: WallParams = field(default_factory=WallParams)


@dataclass(frozen=True)
class FollowerParams(Section):
    """A robot in the virtual mass's place. Except for the two scales, all values are in the robot's own units; spring,
    damper and reservoir are in `world`."""

    robot: str = _p(
        "none",
        "a robot that follows the device, in the virtual mass's place: simulated, or a driver (`hapnet devices`, "
        "module:Class); none: the virtual mass follows",
    )
    servo: str = _p(
        "auto", "auto: sampled (a held force) if the coupling has set-positions, else continuous",
        ("auto", "continuous", "sampled"),
    )  # fmt: skip
    servo_hz: float = _p(1000.0, "rate of its servo [Hz]", Range(at_least=10.0, at_most=20_000.0))
    mass: float = _p(0.045, "its apparent mass, if simulated [kg]", _POSITIVE)
    own_damping: float = _p(0.3, "its own damping, if simulated [Ns/m]", _NOT_NEGATIVE)
    friction_N: float = _p(0.0, "its own Coulomb friction, if simulated [N]", _NOT_NEGATIVE)
    position_servo: bool = _p(
        False, "a simulated robot has a position servo: world.stiffness and world.damping act within each tick"
    )
    resolution_m: float = _p(
        0.0, "encoder resolution, sampled servo only [m]; 0: exact", Range(at_least=0.0, at_most=10.0)
    )
    force_limit_N: float = _p(10.0, "maximum force of its actuators [N]; 0: no limit", _NOT_NEGATIVE)
    step_limit_N: float = _p(0.5, "largest step of its force per tick [N]; 0: no limit", _NOT_NEGATIVE)
    greatest_speed: float = _p(1.0, "maximum speed: it bounds the energy that a held force can output [m/s]", _POSITIVE)
    motion_scale: float = _p(
        1.0,
        "the robot's motion divided by the device's; angles of a tool are not scaled",
        Range(at_least=1e-3, at_most=1e3),
    )
    force_scale: float = _p(
        1.0, "the device's force divided by the robot's; the theorem then bounds the sum of the device's work "
        "and force_scale/motion_scale times the robot's", Range(at_least=1e-3, at_most=1e3)
    )  # fmt: skip
    start: str = _p(
        "here", "here: the positions of both at pairing are the same place; origin: both have the same origin",
        ("here", "origin"),
    )  # fmt: skip
    feedback: str = _p(
        "position", "the device's spring is tied to the robot's position (position), renders the force on the robot "
        "(force), or the scene's planes near it (planes)", ("position", "force", "planes")
    )  # fmt: skip
    on_stop: str = _p(
        "freeze", "when the leader releases it, is stopped or is silent, the robot holds its set-position (freeze) or "
        "renders no force (release)", ("freeze", "release"),
    )  # fmt: skip
    fixtures: bool = _p(False, "a driver's motors render the scene's planes at the robot: virtual fixtures")


@dataclass(frozen=True)
class ContactModelParams(Section):
    """The local contact model at the device, and the world's prediction of the device. `hapnet tune` found the values,
    except for `fade_s`, `shift_s` and `reach_m`, which do not matter in its cases, and `delayed_stiffness`.

    hapnet/couplings/rendering.py lists the rules that use them.
    """

    damping_ratio: float = _p(0.32, "damping ratio of the device on K, up to which damping is added", _NOT_NEGATIVE)
    lead: float = _p(0.92, "share of all damping that is cancelled in free motion", Range(at_least=0.0, at_most=1.0))
    lead_s: float = _p(0.012, "time constant of the filtered velocity that cancels damping [s]", _POSITIVE)
    fade_s: float = _p(0.005, "time constant with which a change of planes takes effect [s]", _POSITIVE)
    shift_s: float = _p(0.05, "time constant with which planes move to the proxy's place of contact [s]", _POSITIVE)
    window_s: float = _p(0.036, "time span of the positions from which the world predicts the device [s]", _POSITIVE)
    longest_s: float = _p(0.135, "longest prediction [s]", _POSITIVE)
    curve_s: float = _p(0.075, "longest time for which the prediction keeps an acceleration [s]", _NOT_NEGATIVE)
    reach_m: float = _p(
        0.05, "planes are sent within this distance plus the device's travel in a round trip [m]", _NOT_NEGATIVE
    )
    remembers: bool = _p(True, "planes that are no longer sent are kept until the world reports that they are gone")
    stop_s: float = _p(
        0.015,
        "time constant with which the predicted motion dies away behind a plane [s]; 0: it does not",
        _NOT_NEGATIVE,
    )
    delayed_stiffness: float = _p(
        100.0, "largest stiffness with which a world that cannot send planes is felt, through its delayed proxy [N/m]",
        _POSITIVE,
    )  # fmt: skip
    yields_below: float = _p(0.8, "the lead shrinks below this level of the world's reservoir; 0: never",
                             Range(at_least=0.0, at_most=1.0))  # fmt: skip


@dataclass(frozen=True)
class LinkParams(Section):
    """The emulated link, in tc-netem's syntax. Each side shapes what it sends."""

    up: str = _p("delay 40ms 10ms loss 2%", "link from the device to the world")
    down: str = _p("delay 40ms 10ms loss 2%", "link from the world to the device")
    up_timeline: str = _p("", "changes of the uplink, in time from pairing, such as at 5s: down; at 9s: up")
    down_timeline: str = _p("", "changes of the downlink, in the same form")
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
        "perceptual deadband (Weber): a change of the force below this fraction is not sent; 0: every change is sent",
        Range(at_least=0.0, at_most=1.0),
    )

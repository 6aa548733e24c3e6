"""Edges of links, energy and timing, by name: what a hand-written twin of the protocol gets wrong first."""

LIVELY = {"operator": "sine", "operator_model.frequency_hz": 1.5, "device.damping": 2.0}
"""A hand that shakes: both sides harvest more than they keep."""

ONE_AXIS: dict[str, dict[str, object]] = {
    "default": {},
    "no delay": {"link.up": "", "link.down": ""},
    "bursts and reordering": {
        "link.up": "delay 20ms reorder 20% 30% gap 3 loss 5% 40%",
        "link.down": "delay 15ms 15ms distribution pareto loss gemodel 5% 20%",
    },
    "states, correlated delays": {
        "link.up": "delay 30ms 20ms 60% distribution normal loss state 3% 30% 10% 50% 1%",
        "link.down": "delay 50ms 5ms 30% reorder 10%",
    },
    "heavy jitter": {
        **LIVELY,
        "duration_s": 3.0,
        "link.up": "delay 200ms 150ms distribution normal loss 20%",
        "link.down": "delay 150ms 100ms loss gemodel 5% 10%",
    },
    "small reservoirs": {
        **LIVELY, "device.ceiling_J": 5e-4, "world.ceiling_J": 2e-4, "link.up": "delay 60ms 20ms loss 10%",
    },
    "everything shuffled": {**LIVELY, "device.shuffle": "all", "world.shuffle": "all", "link.down": "delay 3ms 2ms"},
    "admission": {**LIVELY, "wire.admission_W": 0.02, "wire.admission_burst_J": 0.001},
    "saturated": {
        **LIVELY, "device.force_limit_N": 4.0, "device.spring_share": 0.2, "world.step_limit_N": 5.0,
        "link.down": "delay 100ms",
    },
    "damper limited": {
        **LIVELY, "device.damping": 20.0, "device.stiffness": 400.0, "device.force_limit_N": 0.8,
        "duration_s": 0.8, "link.up": "delay 20ms",
    },
    "no limits": {"device.force_limit_N": 0.0, "device.step_limit_N": 0.0, "world.step_limit_N": 0.0, "scene": "free"},
    "zoh": {"coupling": "zoh", "link.up": "delay 80ms 20ms", "link.down": "delay 80ms 20ms"},
    "other rates": {**LIVELY, "device.servo_hz": 700.0, "device.substeps": 3, "world.step_min_s": 0.001},
    "many under way when it is loaded, not in their order": {
        **LIVELY, "duration_s": 0.4, "link.up": "delay 200ms 150ms loss 20%", "link.down": "delay 200us loss 10%",
        "device.pspm_period_s": 0.001,
    },
    "energy that is never answered": {
        **LIVELY, "duration_s": 0.7, "wire.hello_period_s": 0.003,
        "link.up": "delay 1ms loss 80%", "link.down": "delay 1ms loss 80%",
    },
    "steps within a tick": {
        "duration_s": 0.595, "device.servo_hz": 100.0, "world.step_min_s": 2e-4, "world.step_max_s": 2e-3,
    },
    "4g": {"link.up": "4g", "link.down": "4g"},
    "lossy-wifi": {**LIVELY, "link.up": "lossy-wifi", "link.down": "wifi"},
    "geo and lan": {**LIVELY, "link.up": "geo", "link.down": "lan"},
    "a slow line, reordering": {
        **LIVELY,
        "link.up": "delay 8ms 8ms reorder 5% rate 2mbit 20 48 5",
        "link.down": "delay 30ms loss 3% rate 1mbit",
    },
    "resends, in order and not": {
        **LIVELY,
        "link.up": "delay 20ms 3ms loss gemodel 10% 30% resend 3 8ms rate 2mbit",
        "link.down": "delay 15ms 5ms loss 20% 10% resend 2 7ms unordered",
    },
    "resends on one way": {"link.up": "5g", "link.down": "delay 20ms reorder 10% loss 5%"},
    "box": {**LIVELY, "scene": "box", "dof": 1, "world.wall.half_width_m": 0.01, "operator_model.amplitude_m": 0.05},
    "smoothing": {"device.smoothing_s": 0.005, "world.predict_s": 0.02},
    "released on silence": {"world.on_silence": "release", "link.up": "delay 5ms loss gemodel 2% 1%"},
    "stale samples": {"wire.accept_stale": True, "link.up": "delay 9ms 9ms"},
    "a full queue": {"link.down": "delay 100ms limit 3"},
    "resends that overtake": {"link.up": "delay 5ms loss 20% resend 2 7ms reorder 10%"},
}  # fmt: skip

SEVERAL_AXES: dict[str, dict[str, object]] = {
    "box": {**LIVELY, "scene": "box"},
    "paper, coupled axes": {
        **LIVELY,
        "scene": "paper",
        "device.stiffness": [[100.0, 20.0, 0.0], [20.0, 80.0, 5.0], [0.0, 5.0, 120.0]],
    },
    "uneven, saturated, short of energy": {
        "scene": "free",
        "dof": 2,
        "operator": "sine",
        "device.stiffness": [[100.0, 30.0], [30.0, 60.0]],
        "world.stiffness": [[500.0, 100.0], [100.0, 300.0]],
        "world.mass": [[0.02, 0.005], [0.005, 0.03]],
        "device.ceiling_J": 5e-4,
        "world.ceiling_J": 5e-4,
        "device.force_limit_N": 0.8,
        "link.down": "delay 80ms 30ms loss 5%",
    },
    "uneven, damper limited": {
        **LIVELY,
        "scene": "free",
        "dof": 2,
        "duration_s": 0.6,
        "device.stiffness": [[400.0, 100.0], [100.0, 300.0]],
        "device.damping": [20.0, 3.0],
        "device.force_limit_N": 0.8,
        "link.up": "delay 20ms",
    },
    "uneven, decoupled": {"scene": "box", "dof": 2, **LIVELY, "device.stiffness": [100.0, 60.0]},
}

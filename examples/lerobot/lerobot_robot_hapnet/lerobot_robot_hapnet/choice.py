"""The configuration of a device inside another one's."""

from __future__ import annotations

from typing import Any

import draccus


def config_of(kind: Any, name: str, options: dict[str, Any]) -> Any:
    """LeRobot's configuration from a device's options, with its ``type`` among them.

    kind : RobotConfig or TeleoperatorConfig. name : of the option.

    Raises ValueError: there is no such device, or one of its options is missing or not known.
    """
    try:
        return draccus.decode(kind, options)
    except (draccus.utils.DecodingError, TypeError, KeyError, ValueError) as error:
        known = ", ".join(one for one in kind.get_known_choices() if not one.startswith("hapnet"))
        allowed = f"type, one of {known}, with its options, as in '{{type: so101_follower, port: /dev/ttyACM0}}'"
        raise ValueError(f"{name}: {options} ({error}); allowed: {allowed}") from error

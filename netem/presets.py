"""Named link profiles. Every figure is for one direction: two such links in series make a round trip."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

PRESETS: Mapping[str, str] = MappingProxyType(
    {
        "ideal": "",
        # Switched gigabit Ethernet, a few hops: 12 us to serialise 1500 bytes at each (IEEE 802.3), and some queueing.
        "lan": "delay 100us 20us distribution normal rate 1gbit",
        # One 802.11 hop: a few ms with a long upper tail from contention and retries. Typical figures, not a
        # measurement.
        "wifi": "delay 3ms 1500us 25% distribution pareto loss 0.1% rate 100mbit",
        # The same far from its access point or beside a heavy download; bursts of five losses on average, after Gilbert
        # (1960) and Elliott (1963). Typical figures, not a measurement.
        "lossy-wifi": "delay 10ms 8ms 25% distribution pareto loss gemodel 1% 20% rate 20mbit",
        # LTE: half of a round trip of about 50 ms to a near server. Typical figures, not a measurement.
        "4g": "delay 25ms 8ms 25% distribution normal loss 0.2% rate 20mbit",
        # 5G below 6 GHz: half of a round trip of about 20 ms; the air interface's own millisecond is rare in practice
        # (Fezeu et al., PAM 2023).
        "5g": "delay 10ms 3ms 25% distribution normal loss 0.1% rate 100mbit",
        # Half of the 37 to 40 ms round trips, and the 1 mbit/s uplink, of Verizon's DSL tiers in the FCC's Measuring
        # Broadband America 2016.
        "dsl": "delay 18ms 3ms 25% distribution normal loss 0.1% rate 1mbit",
        # Across one continent, New York to Los Angeles: 3,940 km at the speed of light in fibre (5 us/km) times the
        # ratio of 1.3 to 2.1 of real routes (Bozkurt et al., PAM 2017) is 26 to 41 ms.
        "wan-continental": "delay 32ms 2ms 25% distribution normal loss 0.05% rate 100mbit",
        # Europe to Australia or the far east of Asia: by the same rule, 12,000 km at a ratio of 2 is 120 ms.
        "wan-intercontinental": "delay 120ms 5ms 25% distribution normal loss 0.2% rate 50mbit",
        # Starlink: half of a median round trip of 50 ms, quartiles 40 and 60 ms: Michel et al., "A First Look at
        # Starlink Performance" (IMC 2022). Losses come in bursts; their rate is chosen.
        "leo": "delay 25ms 6ms 50% distribution normal loss gemodel 0.1% 20% rate 10mbit",
        # Geostationary: up and down 35,786 km at the speed of light is 239 ms below the satellite and up to 278 ms at
        # the horizon; ITU-T G.114 counts 260 ms. Access adds some jitter.
        "geo": "delay 270ms 10ms 25% distribution normal loss 0.1% rate 2mbit",
        # The upper end of what haptics work tests, seconds of round trip with long bursts of loss (a quarter is lost).
        # Chosen, not measured.
        "worst": "delay 500ms 100ms 25% distribution paretonormal loss gemodel 5% 15% rate 1mbit",
    }
)

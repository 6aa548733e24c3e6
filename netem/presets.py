"""Named link profiles. Every figure is for one direction: two such links in series make a round trip.

If a profile resends, its loss is that of a single try, and the comment gives the remaining loss. The correlation of its
losses is chosen to give that share, because a fade or a collision lasts longer than a resend. All other losses and
delays are those that remain after the real link's own resends, if it has any.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

ALIASES: Mapping[str, str] = MappingProxyType(
    {"continental": "wan-continental", "intercontinental": "wan-intercontinental"}
)
"""Further names of profiles."""

PRESETS: Mapping[str, str] = MappingProxyType(
    {
        "ideal": "",
        # Switched gigabit Ethernet, a few hops: 12 us to serialise 1500 bytes at each (IEEE 802.3), and some queueing.
        "lan": "delay 100us 20us distribution normal rate 1gbit",
        # One 802.11 hop: a median of 3 ms, as on the campus of Sui et al., "Characterizing and Improving WiFi Latency
        # in Large-Scale Operational Networks" (MobiSys 2016), with the tail of a good place. IEEE 802.11 tries a frame
        # seven times (dot11ShortRetryLimit) and delivers in order. 10 % of the tries fail, the error rate for which the
        # standard states receiver sensitivities. The retry after 0.5 ms, the loss that stays (0.1 %) and the rate are
        # chosen.
        "wifi": "delay 3500us 1500us 25% distribution pareto loss 10% 40% resend 6 500us rate 100mbit",
        # Such a hop over the whole campus: a median of 3 ms and a 90th percentile of 20 ms. Losses come in bursts of
        # five on average, after Gilbert (1960) and Elliott (1963); the bursts' rate is chosen.
        "lossy-wifi": "delay 7500us 14ms 25% distribution pareto loss gemodel 1% 20% rate 20mbit",
        # LTE: half of the median round trip of 70 ms, and the median uplink, of Huang et al., "A Close Examination of
        # Performance and Power Characteristics of 4G LTE Networks" (MobiSys 2012). HARQ: a resend 8 ms later (eight
        # subframes, 3GPP TS 36.321, FDD), four tries in all, of which link adaptation lets 10 % fail (3GPP TS 36.213,
        # 7.2.3); RLC delivers in order. The additional jitter and the loss that stays (0.2 %) are chosen.
        "4g": "delay 35ms 3ms 25% distribution normal loss 10% 20% resend 3 8ms rate 6mbit",
        # 5G below 6 GHz: half of a round trip of about 20 ms; the air interface's own millisecond is rare in practice
        # (Fezeu et al., PAM 2023). HARQ as above, but the network sets its times (3GPP TS 38.213): here the answer
        # comes four slots of 0.5 ms after the data, and the resend four slots after that. PDCP delivers in order. The
        # additional jitter and the loss that stays (0.1 %) are chosen.
        "5g": "delay 10ms 1ms 25% distribution normal loss 10% 13% resend 3 4ms rate 100mbit",
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
        # The longest delay with which force feedback was tested: half of the 7 s round trip to a satellite's arm,
        # Imaida et al., "Ground-Space Bilateral Teleoperation of ETS-VII Robot Arm by Direct Bilateral Coupling under
        # 7-s Time Delay Condition" (IEEE T-RA 20(3), 2004). Jitter, loss (a quarter, in long bursts) and rate are
        # chosen.
        "worst": "delay 3500ms 100ms 25% distribution paretonormal loss gemodel 5% 15% rate 1mbit limit 10000",
    }
)

"""Which link is good enough? Position error and passivity over netem's profiles, with and without PSPM."""

from __future__ import annotations

from hapnet import Params, simulate

LINKS = ("ideal", "lan", "4g", "wan-intercontinental", "worst")


def main(duration_s: float = 10.0) -> None:
    print(f"{'link':<22}{'coupling':<10}{'free rms [mm]':>14}{'force [N]':>11}{'margin [mJ]':>13}")
    for link in LINKS:
        for coupling in ("pspm", "zoh"):
            words = {"link.up": link, "link.down": link, "coupling": coupling, "duration_s": duration_s}
            summary = simulate(Params().set(words), seed=1).summary
            motion, margin = summary["motion"], summary["theorem"]["margin_J"]
            error, force = 1e3 * motion["free_rms_m"], motion["peak_force_N"]
            print(f"{link:<22}{coupling:<10}{error:>14.2f}{force:>11.2f}{1e3 * margin:>13.2f}")


if __name__ == "__main__":
    main()

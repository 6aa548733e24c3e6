import random
from fractions import Fraction

from hapnet.transport.entities import RateLimiter


def test_the_gate_lets_a_burst_through_and_then_the_rate() -> None:
    """Against a plain token bucket that fills at each nanosecond asked."""
    limiter, rng = RateLimiter(1000, 50), random.Random(3)
    tokens, last, passed, refused = Fraction(50), 0, 0, 0
    now = 10**9
    last = now
    for _ in range(20_000):
        now += rng.choice([0, 1_000, 200_000, 900_000, 1_100_000, 80_000_000 * (rng.random() < 0.002)])
        tokens = min(Fraction(50), tokens + Fraction(now - last, 10**6))
        last = now
        if tokens >= 1:
            tokens -= 1
            passed += 1
            assert limiter.admit(now)
        else:
            refused += 1
            assert not limiter.admit(now)
    assert limiter.refused == refused > 5000
    assert passed > 5000

"""Which numbers of a stream count, from the protocol's page (check 6): a plain recount, kept apart from the code."""

MS = 1_000_000


class Numbers:
    """One pair's. `take` says "new", "late" or "doubtful"."""

    def __init__(self) -> None:
        self.newest = -1
        self.stamp_ns = self.at_ns = 0
        self.mean_ns = self.seen = 0
        self.windows: list[tuple[int, int]] = []  # (begin, least) of spans of 10 s
        self.doubtful: list[tuple[int, int, int]] = []  # number, stamp, arrival: a run of those
        self.before: int | None = None  # a run ended there that may come back
        self.proofs = 0

    def take(self, now_ns: int, number: int, stamp_ns: int) -> str:
        if self.newest < 0:
            self._delays_anew(now_ns, now_ns - stamp_ns)
            self.newest, self.stamp_ns, self.at_ns = number, stamp_ns, now_ns
            return "new"
        reach = self.newest + 2000 + (now_ns - self.at_ns) // 50_000
        if number > self.newest and stamp_ns >= self.stamp_ns and number <= reach:
            self._new(now_ns, number, stamp_ns)
            return "new"
        late = number <= self.newest and stamp_ns <= self.stamp_ns
        if late and (self.proofs >= 20 or (self.before is not None and number <= self.before)):
            return "late"
        if self.doubtful:
            last, stamp, at_ns = self.doubtful[-1]
            if not (last < number <= last + 2000 + (now_ns - at_ns) // 50_000 and stamp < stamp_ns):
                self.doubtful.clear()
        self.doubtful.append((number, stamp_ns, now_ns))
        run = len(self.doubtful) >= 2
        if late and self.before is None:
            run = len(self.doubtful) >= 10 and now_ns - self.doubtful[0][2] >= 100 * MS
        if not run:
            return "late" if late else "doubtful"
        self.before = self.newest if number > self.newest else None
        self.doubtful, self.proofs = [], 0
        self.newest, self.stamp_ns, self.at_ns = number, stamp_ns, now_ns
        return "new"

    def _delays_anew(self, now_ns: int, delay_ns: int) -> None:
        self.mean_ns, self.seen, self.windows = delay_ns, 1, [(now_ns, delay_ns)]

    def _new(self, now_ns: int, number: int, stamp_ns: int) -> None:
        delay_ns = now_ns - stamp_ns
        self.doubtful = []
        min_ns = min(minimum for _, minimum in self.windows)
        self.proofs += 1
        if self.before is not None:
            if self.proofs == 20:
                self.before = None
                self._delays_anew(now_ns, delay_ns)
        elif self.seen >= 32 and delay_ns < min_ns - 2 * (self.mean_ns - min_ns) - 60 * MS:
            self.before, self.proofs = self.newest, 0
        else:
            self.seen += 1
            self.mean_ns += (delay_ns - self.mean_ns) // min(self.seen, 64)
            began_ns, minimum = self.windows[-1]
            if now_ns >= began_ns + 10_000 * MS:
                self.windows = [self.windows[-1], (now_ns, delay_ns)]
            else:
                self.windows[-1] = began_ns, min(minimum, delay_ns)
        self.newest, self.stamp_ns, self.at_ns = number, stamp_ns, now_ns

"""Virtual time: both sides and both links in one process, for one run or many at once; and replays of recordings."""

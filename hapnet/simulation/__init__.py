"""Virtual time: both sides and both links in one process, one run or many at once; and replays of recordings."""

"""What a live node used and gave, in that order, on the disk: written here, replayed by ``ship_replay``."""

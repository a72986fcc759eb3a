"""Health of a node's inputs: statistics, duplicate publishers, steps of the time base."""

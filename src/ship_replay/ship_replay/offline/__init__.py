"""Adapters of the suite's nodes fed from a bag, in process: replays, and black boxes verified to the last bit."""

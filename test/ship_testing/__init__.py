"""What tests of several packages share: scenes, voyages, hand-made bags, runs of adapters, nodes to talk to."""

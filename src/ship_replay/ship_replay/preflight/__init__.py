"""What is said before the voyage: where a suite file contradicts itself, a bag, or what the bag shows."""

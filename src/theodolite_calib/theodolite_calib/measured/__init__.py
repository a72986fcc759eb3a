"""What is measured: samples, watched as they come, and brought together at the middle of an exposure."""

"""The ship's true motion and the devices that measure attitude: INS, attitude references, star sensors that solve."""

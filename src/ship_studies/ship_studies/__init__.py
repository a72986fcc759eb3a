"""Studies ashore: layout of star sensors, design of the theodolite, axis fit, installation, INS noise, campaigns."""

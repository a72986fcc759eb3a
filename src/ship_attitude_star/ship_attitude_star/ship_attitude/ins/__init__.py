"""INS samples of the ship attitude: checks, batches, and attitudes corrected by the filter."""

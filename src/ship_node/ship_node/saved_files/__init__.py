"""Files that an adapter reads and writes, and documents that a node saves for its next start."""
